"""Cost of recording and of reading a recording, beside the mcap package in the same run.

    python tests/benchmarks/bench_recording.py

Processor time, the best of several rounds. Writing: the loop's side for a period of three axes (8 messages,
hand-over included), the recorder process' side for a message, and ``Writer.add_message`` of mcap for the same
messages in chunks of the same size. Reading: the signals of one axis, from the file to numpy arrays, and the
same with the decoded messages of mcap and mcap-ros2-support; decompression alone is the lower limit.
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

import numpy as np
import zstandard
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from support.recorded_runs import CENTRED, RUN_HEADER, record_periods, record_run

from hil.recording import open_recording, pipe
from hil.recording.handover import BATCH, BLOCK_HEADER, MESSAGE_HEADER, index_messages
from hil.recording.mcap_writer import CHUNK_BYTES, McapWriter
from hil.recording.recorder import Recorder

PERIODS = 5000
MESSAGES = 8 * PERIODS
ROUNDS = 5
READ_PERIODS = 27_000
"""Number of periods in the recording that is read, five minutes."""


def seconds_of(work: Callable[[], object], rounds: int = ROUNDS) -> float:
    """Return the smallest processor time of this process over the rounds."""
    spent = []
    for _ in range(rounds):
        began = time.process_time()
        work()
        spent.append(time.process_time() - began)
    return min(spent)


def loop_side(directory: Path) -> tuple[float, list[bytes]]:
    """Return the seconds for PERIODS, without those that the caller itself spends, and the batches.

    The recorder process is a real one.
    """
    batches: list[bytes] = []
    original = pipe.RecorderPipe.send

    def send_and_note(self: pipe.RecorderPipe, block: bytearray, kind: bytes) -> None:
        if kind == BATCH:
            batches.append(bytes(block[BLOCK_HEADER.size :]))
        original(self, block, kind)

    with mock.patch.object(pipe.RecorderPipe, "send", send_and_note):
        recorder = Recorder(directory / "noted.mcap", RUN_HEADER, lossless=True)
        record_periods(recorder, PERIODS)
        recorder.close({})
    recorder = Recorder(directory / "timed.mcap", RUN_HEADER, lossless=False)
    overhead = seconds_of(lambda: record_periods(_NoRecorder(), PERIODS, lambda t: CENTRED))
    starts = itertools.count(0, PERIODS)
    total = seconds_of(lambda: record_periods(recorder, PERIODS, lambda t: CENTRED, first=next(starts)))
    report = recorder.close({})
    assert report.failure is None
    return total - overhead, batches


def recorder_side(batches: list[bytes]) -> float:
    """Return the seconds for all messages, from batches to the bytes of a whole file."""

    def write() -> None:
        with Path("/dev/null").open("wb", buffering=0) as stream:
            writer = McapWriter(stream.write, RUN_HEADER)
            for batch in batches:
                writer.add_batch(batch)
            writer.finish({})
            assert writer.message_count == MESSAGES

    return seconds_of(write)


def mcap_writer(batches: list[bytes]) -> float:
    """Return the seconds for the same messages through mcap's Writer."""
    messages = [message for batch in batches for message in messages_of(batch)]

    def write() -> None:
        with Path("/dev/null").open("wb", buffering=0) as stream:
            writer = Writer(stream, chunk_size=CHUNK_BYTES)
            writer.start("ros2")
            schema = writer.register_schema("any", "ros2msg", b"")
            for topic in range(11):
                writer.register_channel(f"/{topic}", "cdr", schema)
            for channel, log_time, payload, publish_time, sequence in messages:
                writer.add_message(channel, log_time, payload, publish_time, sequence)
            writer.finish()

    return seconds_of(write)


def messages_of(batch: bytes) -> list[tuple[int, int, bytes, int, int]]:
    """Return channel, log time, payload, publish time and sequence of each message of a batch."""
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


class _NoRecorder(Recorder):
    """Stand-in for a recorder that does nothing."""

    def __init__(self) -> None: ...
    def _do_nothing(self, *_arguments: object) -> None: ...

    deadline_called = frame_sent = frame_received = cycle = hand_over = _do_nothing


def read_with_hil(path: Path) -> np.ndarray:
    """Return the positions of the vertical axis."""
    return open_recording(path).axis("vertical").position


def read_with_mcap(path: Path) -> np.ndarray:
    """Return the same positions through mcap's reader and the decoder of mcap-ros2-support."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return np.array([m.position for *_, m in reader.iter_decoded_messages(["/axis/vertical"])])


def decompress(chunks: list[Chunk]) -> None:
    """Decompress all chunks."""
    for chunk in chunks:
        zstandard.decompress(chunk.data, chunk.uncompressed_size)


def per_message(seconds: float, messages: int) -> str:
    """Return time for a message, and messages a second, as text."""
    return f"{1e6 * seconds / messages:8.2f} µs a message, {messages / seconds:9,.0f} messages/s"


def bench_writing(directory: Path) -> None:
    """Print the figures of writing."""
    loop_s, batches = loop_side(directory)
    ours_s, theirs_s = recorder_side(batches), mcap_writer(batches)
    print(f"loop's side      {1e6 * loop_s / PERIODS:8.2f} µs a period of three axes (8 messages)")
    print(f"recorder process {per_message(ours_s, MESSAGES)}")
    print(f"mcap's Writer    {per_message(theirs_s, MESSAGES)}")
    print(f"ratio            {theirs_s / ours_s:8.2f} times as many messages a second as mcap's Writer")


def bench_reading(directory: Path) -> None:
    """Print the figures of reading."""
    path = directory / "read.mcap"
    record_run(path, READ_PERIODS)
    with path.open("rb") as stream:
        chunks = [r for r in StreamReader(stream, emit_chunks=True).records if isinstance(r, Chunk)]
    assert np.array_equal(read_with_hil(path), read_with_mcap(path))
    ours_s = seconds_of(lambda: read_with_hil(path))
    theirs_s = seconds_of(lambda: read_with_mcap(path), rounds=1)
    decompress_s = seconds_of(lambda: decompress(chunks))
    print(f"one axis of {READ_PERIODS} periods, from the file to arrays:")
    print(f"hil              {1e3 * ours_s:8.1f} ms, {ours_s / decompress_s:.1f} times decompression alone")
    print(f"mcap, decoded    {1e3 * theirs_s:8.1f} ms")
    print(f"ratio            {theirs_s / ours_s:8.1f} times faster than mcap's decoded messages")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        bench_writing(Path(name))
        bench_reading(Path(name))
