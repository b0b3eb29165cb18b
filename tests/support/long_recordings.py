"""Long recordings within a short time: some periods are recorded, then repeated with shifted times."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from hil.recording import schemas
from hil.recording.handover import BATCH, BLOCK_HEADER, MESSAGE_HEADER, index_messages
from hil.recording.mcap_writer import McapWriter
from hil.recording.recorder import Recorder
from support.constants import PERIOD_NS
from support.recorded_runs import RUN_HEADER, TENTH_STEP, Signals, in_memory, record_periods

REPEATED_PERIODS = 500
"""Number of periods that are recorded, and repeated."""
_BATCH_PERIODS = 50
"""Number of periods in a batch, so that chunks have the size that the recorder gives them."""
_SEQUENCE = (11, "<u4", 1)
"""Offset in a message record, type, and unit of the sequence number; a unit of PERIOD_NS is a time."""
_TIMES = ((15, "<u8"), (23, "<u8"))
"""Log time and publish time."""


def record_long_run(path: Path, periods: int, signals: Signals = TENTH_STEP) -> int:
    """Write a complete recording of at least ``periods`` periods under control; return their number."""
    records = _recorded(path, signals)
    rounds = -(-periods // REPEATED_PERIODS)
    with path.open("wb") as file:
        writer = McapWriter(file.write, RUN_HEADER)
        for batch in _repeated(records, rounds):
            writer.add_batch(batch)
        writer.finish({"ending": {"reason": "completed"}})
    return rounds * REPEATED_PERIODS


def _recorded(path: Path, signals: Signals) -> bytes:
    """Return the message records of the periods that are repeated."""
    batches: list[bytes] = []
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    send = type(recorder._pipe).send

    def note(pipe: object, block: bytearray, kind: bytes) -> None:
        if kind == BATCH:
            batches.append(bytes(block[BLOCK_HEADER.size :]))
        send(pipe, block, kind)  # type: ignore[arg-type]

    with mock.patch.object(type(recorder._pipe), "send", note):
        record_periods(recorder, REPEATED_PERIODS, signals)
        recorder.close({})
    return b"".join(batches)


def _repeated(records: bytes, rounds: int) -> Iterator[bytes]:
    """Yield the records once for each round, with sequence numbers and times that go on."""
    index = {channel: np.array(pairs[1::2]) for channel, pairs in index_messages(records).items()}
    count = sum(map(len, index.values()))
    borders = [*index[schemas.DEADLINES][::_BATCH_PERIODS].tolist(), len(records)]
    for number in range(rounds):
        shifted = np.frombuffer(records, np.uint8).copy()
        shift_ns = number * REPEATED_PERIODS * PERIOD_NS
        for channel, places in index.items():
            _add(shifted, places, *_SEQUENCE[:2], number * count)
            for offset, kind in _TIMES:
                _add(shifted, places, offset, kind, shift_ns)
            for offset, kind, unit in _payload_fields(channel):
                _add(shifted, places, offset, kind, shift_ns if unit else number * REPEATED_PERIODS)
            if channel >= schemas.FIRST_AXIS:
                _shift_stamp(shifted, places, shift_ns)
        whole = shifted.tobytes()
        for begin, end in pairwise(borders):
            yield whole[begin:end]


def _payload_fields(channel: int) -> list[tuple[int, str, bool]]:
    """Return offset, type and whether it is a time, of the fields of a payload that go on."""
    if channel == schemas.DEADLINES:
        layout = schemas.layout_of(schemas.DEADLINE.definition, "")
    elif channel == schemas.CYCLES:
        layout = schemas.layout_of(schemas.CYCLE.definition, "")
    else:
        return []
    return [
        (MESSAGE_HEADER.size + field.offset, "<i8", field.name != "number")
        for field in layout.fields
        if field.code == "q"
    ]


def _shift_stamp(records: NDArray[np.uint8], places: NDArray[np.int64], shift_ns: int) -> None:
    """Shift the stamp of an axis' message, which has seconds and nanoseconds."""
    start = MESSAGE_HEADER.size + 4
    seconds, nanoseconds = (_field(records, places, start + offset, "<u4") for offset in (0, 4))
    total = seconds.astype(np.int64) * 1_000_000_000 + nanoseconds + shift_ns
    for offset, values in ((0, total // 1_000_000_000), (4, total % 1_000_000_000)):
        records[_bytes(places, start + offset, 4)] = values.astype("<u4").view(np.uint8).reshape(-1, 4)


def _add(records: NDArray[np.uint8], places: NDArray[np.int64], offset: int, kind: str, by: int) -> None:
    values = _field(records, places, offset, kind) + np.array(by, kind)
    size = np.dtype(kind).itemsize
    records[_bytes(places, offset, size)] = values.astype(kind).view(np.uint8).reshape(-1, size)


def _field(
    records: NDArray[np.uint8], places: NDArray[np.int64], offset: int, kind: str
) -> NDArray[np.int64]:
    return np.ascontiguousarray(records[_bytes(places, offset, np.dtype(kind).itemsize)]).view(kind)[:, 0]


def _bytes(places: NDArray[np.int64], offset: int, size: int) -> NDArray[np.int64]:
    return places[:, None] + offset + np.arange(size)
