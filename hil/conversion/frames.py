"""The CAN frames of a recording in both directions, in the order in which they were on the bus."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.conversion.signals import Selection, parts
from hil.core.frames import Frame
from hil.recording.reader import Recording
from hil.recording.tables import FrameTable

BLOCK_FRAMES = 65_536
"""Number of frames that are converted at a time."""

_IDENTIFIER_BITS = 32


class BusFrame(NamedTuple):
    """A frame with its instant and its direction."""

    epoch_ns: int
    """Instant at which the gateway was given the frame, or had sent it, in ns since 1970."""
    frame: Frame
    is_received: bool
    """True for a frame that the gateway received, False for one that it sent."""


def bus_frames(recording: Recording, selection: Selection) -> Iterator[BusFrame]:
    """Yield the frames that were received and sent in the selected time.

    Frames of one instant, which simulated time has, keep their order in each direction. Between the
    directions, the smaller identifier comes first, as in arbitration: SYNC, the sample, the command. Frames
    that the link refused are left out.
    """
    for rows in frame_rows(recording, selection):
        for start in range(0, len(rows), BLOCK_FRAMES):
            yield from _converted(rows[start : start + BLOCK_FRAMES])


def _converted(rows: npt.NDArray[Any]) -> Iterator[BusFrame]:
    columns = (rows[name].tolist() for name in rows.dtype.names or () if name != "data")
    for data, *values in zip(rows["data"].tolist(), *columns, strict=True):
        epoch_ns, identifier, is_extended, is_remote, is_error, length, is_received = values
        frame = Frame(identifier, bytes(data[:length]), is_extended, is_remote, is_error)
        yield BusFrame(epoch_ns, frame, is_received)


_ROW = np.dtype(
    [
        ("epoch_ns", "<i8"),
        ("id", "<u4"),
        ("is_extended", "?"),
        ("is_remote", "?"),
        ("is_error", "?"),
        ("length", "u1"),
        ("is_received", "?"),
        ("data", "u1", (8,)),
    ]
)


def frame_rows(recording: Recording, selection: Selection) -> Iterator[npt.NDArray[Any]]:
    """Yield the frames of :func:`bus_frames` as structured arrays."""
    for part in parts(recording, selection):
        sent = _rows(part.frames("sent"), False, recording.epoch_offset_ns)
        received = _rows(part.frames("received"), True, recording.epoch_offset_ns)
        rows = np.concatenate((sent, received))
        priority = np.concatenate((_largest_so_far(sent), _largest_so_far(received)))
        yield rows[np.lexsort((priority, rows["epoch_ns"]))]


def _rows(table: FrameTable, is_received: bool, epoch_offset_ns: int) -> npt.NDArray[Any]:
    rows = np.empty(len(table), _ROW)
    rows["epoch_ns"] = table.time_ns + epoch_offset_ns
    rows["is_received"] = is_received
    for name in ("id", "is_extended", "is_remote", "is_error", "length", "data"):
        rows[name] = table[name]
    return rows


def _largest_so_far(rows: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """Return for each frame the largest identifier among those of its instant up to it.

    Sorting by it merges two directions without changing the order within one of them.
    """
    instants = np.cumsum(np.diff(rows["epoch_ns"], prepend=rows["epoch_ns"][:1]) != 0)
    largest = np.maximum.accumulate((instants << _IDENTIFIER_BITS) + rows["id"].astype(np.int64))
    return np.asarray(largest & ((1 << _IDENTIFIER_BITS) - 1))
