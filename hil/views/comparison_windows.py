"""Two recordings side by side, window by window, in periods that belong together.

Instants are those of the deadlines, counted from the deadline of the event on which the runs are aligned. The
deadlines of a run lie on a grid. Therefore a late wake-up, also that of the event, moves no pair to the
neighbouring period. Memory is that of one window, whatever the length of the runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.recording.reader import Recording
from hil.recording.schemas import AXIS_TOPIC
from hil.recording.tables import AxisTable, BoolArray, IntArray, TimingTable

WINDOW_S = 300.0
"""Length of the ranges of time that are read at once."""
MAX_SHIFT = 20
"""Largest number of periods by which the event of an imported log is moved."""
_SHIFT_MARGIN_S, _SHIFT_SPAN_S = 5.0, 60.0
_MARGIN_PERIODS = 2
"""Periods that are read of the second run before and after those of a window of the first."""


class Event(StrEnum):
    """Event on which two runs are aligned."""

    RUNNING = "first period under control"
    SETPOINT = "first change of a setpoint"
    BEGIN = "first recorded period"


class Instant(NamedTuple):
    """A period of a run."""

    deadline_ns: int
    time_s: float
    """Sampling instant in seconds from the first recorded period."""


class Control(NamedTuple):
    """The part of a run that was under control."""

    first: Instant
    last: Instant

    @property
    def duration_s(self) -> float:
        """Time in seconds from the first to the last period under control."""
        return (self.last.deadline_ns - self.first.deadline_ns) * 1e-9


class Pairs(NamedTuple):
    """Periods of two runs that belong together, of one window and one axis."""

    since_s: npt.NDArray[np.float64]
    """Deadlines of the first run in seconds from the event, shape (n,)."""
    first: AxisTable
    second: AxisTable


def control_of(recording: Recording) -> Control | None:
    """Return the part that was under control; None if no period was."""
    first: Instant | None = None
    last: Instant | None = None
    for window in recording.windows(WINDOW_S):
        timing = window.timing()
        rows = np.flatnonzero(timing.running)
        if len(rows):
            first = first or _instant(timing, int(rows[0]))
            last = _instant(timing, int(rows[-1]))
    return None if first is None or last is None else Control(first, last)


def event_of(recording: Recording, event: Event) -> Instant | None:
    """Return the period of an event; None if the run does not have it."""
    if event is Event.RUNNING:
        control = control_of(recording)
        return None if control is None else control.first
    if event is Event.SETPOINT:
        found = [_first_change(recording, name) for name in recording.axes]
        return min((instant for instant in found if instant is not None), default=None)
    for window in recording.windows(WINDOW_S):
        timing = window.timing()
        if len(timing):
            return _instant(timing, 0)
    return None


def best_shift(
    first: Recording, second: Recording, axes: Sequence[str], events: tuple[Instant, Instant]
) -> tuple[int, Instant]:
    """Return by how many periods the second run's event is best moved, and the period that is then its event.

    The positions in the first minute from the event on are closest then. The start of control in an imported
    bus log is an estimate: it is the first command that opens a valve.
    """
    costs: dict[int, float] = {}
    moved: dict[int, Instant] = {}
    for axis in axes:
        parts = [
            _matched(run.between(event.time_s - _SHIFT_MARGIN_S, event.time_s + _SHIFT_SPAN_S), axis)
            for run, event in zip((first, second), events, strict=True)
        ]
        begins = [
            int(np.searchsorted(timing.deadline_ns, event.deadline_ns))
            for (timing, _), event in zip(parts, events, strict=True)
        ]
        for shift in sorted(range(-MAX_SHIFT, MAX_SHIFT + 1), key=abs):
            begin = begins[1] + shift
            if not 0 <= begin < len(parts[1][0]):
                continue
            one, other = parts[0][1].position[begins[0] :], parts[1][1].position[begin:]
            length = min(len(one), len(other))
            costs[shift] = costs.get(shift, 0.0) + float(np.nanmean((one[:length] - other[:length]) ** 2))
            moved[shift] = _instant(parts[1][0], begin)
    if not costs:
        return 0, events[1]
    shift = min(costs, key=costs.__getitem__)
    return shift, moved[shift]


def _first_change(recording: Recording, axis: str) -> Instant | None:
    """Return the first period in which a setpoint changes while the controller acts."""
    setpoint, running = np.empty(0), np.empty(0, np.bool_)
    for window in recording.windows(WINDOW_S):
        timing, table = _matched(window, axis)
        carried = len(setpoint)
        setpoint = np.concatenate((setpoint, table.setpoint))
        running = np.concatenate((running, table.running))
        is_change = (np.diff(setpoint) != 0.0) & running[1:] & running[:-1]
        rows = np.flatnonzero(is_change)
        if len(rows):
            return _instant(timing, int(rows[0]) + 1 - carried)
        setpoint, running = setpoint[-1:], running[-1:]
    return None


def pairs_of(
    first: Recording, second: Recording, axis: str, events: tuple[Instant, Instant], all_periods: bool
) -> Iterator[Pairs]:
    """Yield the periods of an axis that belong together, in ascending time.

    A period of the first run belongs to the nearest period of the second one, at most half a period away.
    Periods in which only one of the runs was under control are left out, and with ``all_periods`` False those
    in which none was.
    """
    for window in first.windows(WINDOW_S):
        timing, table = _matched(window, axis)
        if len(timing) == 0:
            continue
        since_ns = timing.deadline_ns - events[0].deadline_ns
        period_s = _period_ns(timing) * 1e-9
        begin_s, end_s = (events[1].time_s + float(since_ns[row]) * 1e-9 for row in (0, -1))
        margin_s = _MARGIN_PERIODS * period_s
        other_timing, other = _matched(second.between(begin_s - margin_s, end_s + margin_s), axis)
        rows, others = _nearest(
            since_ns, other_timing.deadline_ns - events[1].deadline_ns, _period_ns(other_timing)
        )
        is_alike = _is_alike(table.running[rows], other.running[others], all_periods)
        rows, others = rows[is_alike], others[is_alike]
        if len(rows):
            yield Pairs(np.asarray(since_ns[rows] * 1e-9, np.float64), table[rows], other[others])


def _is_alike(one: BoolArray, other: BoolArray, all_periods: bool) -> BoolArray:
    return one == other if all_periods else one & other


def _matched(window: Recording, axis: str) -> tuple[TimingTable, AxisTable]:
    """Return timing and signals of the periods that have both."""
    timing = window.timing()
    if window.counts.get(AXIS_TOPIC + axis, 0) == 0:
        return timing[:0], window.axis(axis)
    table = window.axis(axis)
    if np.array_equal(timing.wake_ns, table.time_ns):
        return timing, table
    _, rows, others = np.intersect1d(timing.wake_ns, table.time_ns, return_indices=True)
    return timing[rows], table[others]


def _nearest(first_ns: IntArray, second_ns: IntArray, period_ns: int) -> tuple[IntArray, IntArray]:
    """Return the rows of the first run that have a counterpart, and those of their counterparts."""
    if len(second_ns) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    after = np.minimum(np.searchsorted(second_ns, first_ns), len(second_ns) - 1)
    before = np.maximum(after - 1, 0)
    is_nearer = np.abs(second_ns[before] - first_ns) <= np.abs(second_ns[after] - first_ns)
    nearest = np.where(is_nearer, before, after)
    rows = np.flatnonzero(2 * np.abs(second_ns[nearest] - first_ns) <= period_ns)
    return rows, nearest[rows]


def _period_ns(timing: TimingTable) -> int:
    return int(np.median(np.diff(timing.deadline_ns))) if len(timing) > 1 else 0


def _instant(timing: TimingTable, row: int) -> Instant:
    return Instant(int(timing.deadline_ns[row]), float(timing.time_s[row]))
