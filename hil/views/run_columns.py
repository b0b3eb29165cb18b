"""The columns of a run that figures are made of, read window by window so that long runs fit into memory.

Three axes of a run of ten hours take 110 MB, one axis at a time. The full tables would take 1 GB.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np

from hil.core.wire.codec import SYNC
from hil.recording.reader import Recording
from hil.recording.schemas import AXIS_TOPIC, CYCLE_TOPIC
from hil.recording.tables import BoolArray, ByteArray, FloatArray, IntArray, TimingTable

WINDOW_S = 300.0
"""Length of the ranges of time that are read at once."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Base: columns of equal length, one row for each period."""

    time_s: FloatArray
    """Time in seconds from the first recorded period."""

    def __len__(self) -> int:
        return len(self.time_s)

    def __getitem__(self, key: slice) -> Self:
        """Return a range of rows."""
        return replace(self, **{name: getattr(self, name)[key] for name in _names(type(self))})


@dataclass(frozen=True, eq=False)
class AxisColumns(Columns):
    """The signals of one axis that step and tracking figures need."""

    setpoint: FloatArray
    position: FloatArray
    error: FloatArray
    command_v: FloatArray
    running: BoolArray
    unit: str

    @property
    def time_ns(self) -> IntArray:
        """Sampling instants in ns from the first recorded period, which ``time_s`` gives without a loss."""
        return np.round(self.time_s * 1e9).astype(np.int64)


@dataclass(frozen=True, eq=False)
class TimingColumns(Columns):
    """The timing of the loop, as in :class:`hil.recording.tables.TimingTable`."""

    number: IntArray
    lateness_ns: IntArray
    """Time from the deadline to the call of the core."""
    state: ByteArray
    fresh: BoolArray
    running: BoolArray
    response_ns: IntArray
    """Time from SYNC to the command, both as taken by the link; -1 without a good sample or a SYNC."""


def axis_columns(recording: Recording, name: str) -> AxisColumns:
    """Read the signals of an axis. Raises RecordingError without that axis."""
    unit = recording.axes.get(name, "")
    filler = _Filler(AxisColumns, recording.counts.get(AXIS_TOPIC + name, 0))
    for window in recording.windows(WINDOW_S):
        filler.add(window.axis(name))
    if filler.is_empty:
        filler.add(recording.axis(name))
    return AxisColumns(unit=unit, **filler.columns())


def timing_columns(recording: Recording) -> TimingColumns:
    """Read the timing of the loop. Raises RecordingError when it is not recorded."""
    filler = _Filler(TimingColumns, recording.counts.get(CYCLE_TOPIC, 0))
    last_sync = np.empty(0, np.int64)
    for window in recording.windows(WINDOW_S):
        timing = window.timing()
        sync_ns = np.concatenate([last_sync, window.frames("sent", SYNC).time_ns])
        filler.add(timing, **_durations(timing, sync_ns))
        last_sync = sync_ns[-1:]
    if filler.is_empty:
        filler.add(recording.timing(), **_durations(recording.timing(), last_sync))
    return TimingColumns(**filler.columns())


def _durations(timing: TimingTable, sync_ns: IntArray) -> dict[str, IntArray]:
    lateness_ns = np.asarray(timing.wake_ns - timing.deadline_ns, np.int64)
    return {"lateness_ns": lateness_ns, "response_ns": _response_ns(timing, sync_ns)}


def _response_ns(timing: TimingTable, sync_ns: IntArray) -> IntArray:
    """Return the times from the last SYNC before each sample to the period's command; -1 without them."""
    last = np.searchsorted(sync_ns, timing.receive_ns, side="right") - 1
    known = timing.fresh & (last >= 0)
    response = np.full(len(timing), -1, np.int64)
    response[known] = timing.sent_ns[known] - sync_ns[last[known]]
    return response


class _Filler:
    """Copies columns of consecutive windows into arrays of a known length."""

    def __init__(self, kind: type[Columns], length: int) -> None:
        self._names = _names(kind)
        self._length, self._filled = length, 0
        self._columns: dict[str, np.ndarray[Any, Any]] = {}

    @property
    def is_empty(self) -> bool:
        """True before the first window."""
        return not self._columns

    def add(self, table: Any, **further: np.ndarray[Any, Any]) -> None:
        """Append the rows of a table, and of ``further`` columns that it does not have."""
        for name in self._names:
            values = further[name] if name in further else getattr(table, name)
            column = self._columns.setdefault(name, np.empty(self._length, values.dtype))
            column[self._filled : self._filled + len(values)] = values
        self._filled += len(table)

    def columns(self) -> dict[str, np.ndarray[Any, Any]]:
        """Return the columns, cut to the rows that were added."""
        return {name: column[: self._filled] for name, column in self._columns.items()}


def _names(kind: type[Columns]) -> list[str]:
    return [field.name for field in fields(kind) if field.name != "unit"]
