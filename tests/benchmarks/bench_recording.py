"""What recording costs, against mcap's own writer in the same run.

    python tests/benchmarks/bench_recording.py

Processor time, best of several rounds: of the loop's side for a period of three axes (8 messages, hand-over
included), of the recorder process' side for a message, and of mcap's ``Writer.add_message`` for the same
messages in chunks of the same size.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).parents[1]))

from mcap.writer import Writer
from support.recorded_runs import CENTRED, RUN_HEADER, record_periods

from hil.recording import pipe
from hil.recording.handover import BATCH, BLOCK_HEADER, MESSAGE_HEADER, index_messages
from hil.recording.mcap_writer import CHUNK_BYTES, McapWriter
from hil.recording.recorder import Recorder

PERIODS = 5000
MESSAGES = 8 * PERIODS
ROUNDS = 5


def seconds_of(work: Callable[[], object]) -> float:
    """Least processor time of this process over the rounds."""
    spent = []
    for _ in range(ROUNDS):
        began = time.process_time()
        work()
        spent.append(time.process_time() - began)
    return min(spent)


def loop_side(directory: Path) -> tuple[float, list[bytes]]:
    """Seconds for PERIODS, with a real recorder process and without what the caller spends; the batches."""
    batches: list[bytes] = []
    original = pipe.RecorderPipe.send

    def noting(self: pipe.RecorderPipe, block: bytearray, kind: bytes) -> None:
        if kind == BATCH:
            batches.append(bytes(block[BLOCK_HEADER.size :]))
        original(self, block, kind)

    with mock.patch.object(pipe.RecorderPipe, "send", noting):
        recorder = Recorder(directory / "noted.mcap", RUN_HEADER, lossless=True)
        record_periods(recorder, PERIODS)
        recorder.close({})
    recorder = Recorder(directory / "timed.mcap", RUN_HEADER, lossless=False)
    overhead = seconds_of(lambda: record_periods(_Nobody(), PERIODS, lambda t: CENTRED))
    starts = itertools.count(0, PERIODS)
    total = seconds_of(lambda: record_periods(recorder, PERIODS, lambda t: CENTRED, first=next(starts)))
    report = recorder.close({})
    assert report.failure is None
    return total - overhead, batches


def recorder_side(batches: list[bytes]) -> float:
    """Seconds for all messages, from batches to the bytes of a whole file."""

    def write() -> None:
        with Path("/dev/null").open("wb", buffering=0) as stream:
            writer = McapWriter(stream.write, RUN_HEADER)
            for batch in batches:
                writer.add_batch(batch)
            writer.finish({})
            assert writer.message_count == MESSAGES

    return seconds_of(write)


def mcap_writer(batches: list[bytes]) -> float:
    """Seconds for the same messages through mcap's Writer."""
    messages = [message for batch in batches for message in messages_of(batch)]

    def write() -> None:
        with Path("/dev/null").open("wb", buffering=0) as stream:
            writer = Writer(stream, chunk_size=CHUNK_BYTES)
            writer.start("ros2")
            schema = writer.register_schema("any", "ros2msg", b"")
            for topic in range(9):
                writer.register_channel(f"/{topic}", "cdr", schema)
            for channel, log_time, payload, publish_time, sequence in messages:
                writer.add_message(channel, log_time, payload, publish_time, sequence)
            writer.finish()

    return seconds_of(write)


def messages_of(batch: bytes) -> list[tuple[int, int, bytes, int, int]]:
    found = []
    for channel, pairs in index_messages(batch).items():
        for offset in pairs[1::2]:
            prefix, sequence, log_time, publish_time = MESSAGE_HEADER.unpack_from(batch, offset)
            end = offset + 9 + int.from_bytes(prefix[1:9], "little")
            payload = batch[offset + MESSAGE_HEADER.size : end]
            found.append((sequence, channel, log_time, payload, publish_time))
    return [
        (channel, log, payload, publish, sequence)
        for sequence, channel, log, payload, publish in sorted(found)
    ]


class _Nobody(Recorder):
    """Is called as a recorder is, and does nothing."""

    def __init__(self) -> None: ...
    def _nothing(self, *_arguments: object) -> None: ...

    deadline_called = frame_sent = frame_received = cycle = hand_over = _nothing


def rate(seconds: float, messages: int) -> str:
    return f"{1e6 * seconds / messages:8.2f} µs a message, {messages / seconds:9,.0f} messages/s"


def main() -> None:
    """Print the figures."""
    with tempfile.TemporaryDirectory() as directory:
        loop_s, batches = loop_side(Path(directory))
    ours_s, theirs_s = recorder_side(batches), mcap_writer(batches)
    print(f"loop's side      {1e6 * loop_s / PERIODS:8.2f} µs a period of three axes (8 messages)")
    print(f"recorder process {rate(ours_s, MESSAGES)}")
    print(f"mcap's Writer    {rate(theirs_s, MESSAGES)}")
    print(f"ratio            {theirs_s / ours_s:8.2f} times as many messages a second as mcap's Writer")


if __name__ == "__main__":
    main()
