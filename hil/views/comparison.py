"""Compares two recordings signal by signal, aligned on the same event.

Each sample of the first run is compared with the sample of the second run that is nearest in time, counted
from the event. Samples without a counterpart within one period are left out, and so are those at which only
one of both runs was under control.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.core.errors import RecordingError
from hil.recording.reader import Recording
from hil.recording.tables import IntArray
from hil.views.run_columns import AxisColumns, axis_columns

SIGNALS = {"setpoint": "", "position": "", "error": "", "command_v": "V"}
"""Signals that are compared, and their unit; empty: the unit of the axis."""


class Event(StrEnum):
    """Event on which two runs are aligned."""

    RUNNING = "first period under control"
    SETPOINT = "first change of a setpoint"
    BEGIN = "first recorded period"


@dataclass(frozen=True)
class SignalDifference:
    """The difference of one signal between two runs: first minus second."""

    axis: str
    signal: str
    unit: str
    rms: float
    largest: float
    """Largest magnitude; infinite where one run has no value and the other has one."""
    at_s: float
    """Time of the largest magnitude, in seconds from the event."""
    first: float
    """Value of the first run there."""
    second: float
    """Value of the second run there."""


@dataclass(frozen=True)
class Comparison:
    """The differences between two runs."""

    event: Event
    first_event_s: float
    """Time of the event in the first run, in seconds from its first recorded period."""
    second_event_s: float
    first_controlled_s: float
    """Time for which the first run was under control."""
    second_controlled_s: float
    samples: int
    """Number of samples of each axis that were compared."""
    from_s: float
    """Time of the first compared sample, in seconds from the event."""
    to_s: float
    """Time of the last compared sample, in seconds from the event."""
    signals: tuple[SignalDifference, ...]
    only_first: tuple[str, ...]
    """Axes that only the first run has."""
    only_second: tuple[str, ...]
    documents: tuple[str, ...]
    """Documents and setpoints that are not equal in both runs."""

    def exceeding(self, tolerances: Mapping[str, float]) -> list[SignalDifference]:
        """Return the differences over the tolerance of their signal; the key "" is for all signals."""
        return [
            difference
            for difference in self.signals
            if difference.largest > tolerances.get(difference.signal, tolerances.get("", math.inf))
        ]


def compare(first: Recording, second: Recording, event: Event | None = None) -> Comparison:
    """Compare two recordings. None: the first event of :class:`Event` that both of them have.

    Raises RecordingError when a run has no period, or lacks ``event``, or when they have no common axis or
    no common range of time.
    """
    common = [name for name in first.axes if name in second.axes]
    if not common:
        raise RecordingError(
            f"{first.path} and {second.path} have no common axis: {', '.join(first.axes) or 'none'}; "
            f"{', '.join(second.axes) or 'none'}"
        )
    chosen, first_ns, second_ns = _aligned(first, second, event)
    differences: list[SignalDifference] = []
    samples, ends, controlled = 0, (0, 0), (0.0, 0.0)
    for name in common:
        one, other = axis_columns(first, name), axis_columns(second, name)
        if one.unit != other.unit:
            raise RecordingError(
                f"{name} is in {one.unit} in {first.path}, and in {other.unit} in {second.path}"
            )
        rows, others = _pairs(one.time_ns - first_ns, other.time_ns - second_ns)
        is_alike = one.running[rows] == other.running[others]
        pairs = rows[is_alike], others[is_alike]
        if len(pairs[0]) == 0:
            raise RecordingError(
                f"{first.path} and {second.path} have no common range of time, aligned on the {chosen}"
            )
        since_ns = one.time_ns[pairs[0]] - first_ns
        samples, ends = len(since_ns), (int(since_ns[0]), int(since_ns[-1]))
        controlled = _controlled_s(one), _controlled_s(other)
        differences += _differences(name, one, other, pairs, since_ns)
    return Comparison(
        chosen,
        first_ns * 1e-9,
        second_ns * 1e-9,
        *controlled,
        samples,
        ends[0] * 1e-9,
        ends[1] * 1e-9,
        tuple(differences),
        tuple(name for name in first.axes if name not in common),
        tuple(name for name in second.axes if name not in common),
        tuple(_unequal_documents(first, second)),
    )


def _aligned(first: Recording, second: Recording, event: Event | None) -> tuple[Event, int, int]:
    """Return the event, and its instants in both runs."""
    for candidate in Event if event is None else (event,):
        first_ns, second_ns = (_instant(recording, candidate) for recording in (first, second))
        if first_ns is not None and second_ns is not None:
            return candidate, first_ns, second_ns
    lacking = first if event is None or _instant(first, event) is None else second
    what = "period, so there is nothing to compare" if event is None else f"{event.value}; choose another"
    raise RecordingError(f"{lacking.path}: has no {what}")


def _instant(recording: Recording, event: Event) -> int | None:
    """Return an event's sampling instant in ns from the first period; None if the run does not have it."""
    found = []
    for name in recording.axes:
        axis = axis_columns(recording, name)
        match event:
            case Event.RUNNING:
                places = np.flatnonzero(axis.running)
            case Event.SETPOINT:
                is_change = (np.diff(axis.setpoint) != 0.0) & axis.running[1:] & axis.running[:-1]
                places = np.flatnonzero(is_change) + 1
            case Event.BEGIN:
                places = np.arange(len(axis))[:1]
        if len(places):
            found.append(int(axis.time_ns[places[0]]))
    return min(found, default=None)


def _pairs(first_ns: IntArray, second_ns: IntArray) -> tuple[IntArray, IntArray]:
    """Return the rows of the first run that have a counterpart, and those of their counterparts."""
    if len(second_ns) == 0 or len(first_ns) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    period_ns = int(np.median(np.diff(second_ns))) if len(second_ns) > 1 else 0
    after = np.clip(np.searchsorted(second_ns, first_ns), 1, max(len(second_ns) - 1, 1))
    after = np.minimum(after, len(second_ns) - 1)
    before = np.maximum(after - 1, 0)
    is_nearer = np.abs(second_ns[before] - first_ns) <= np.abs(second_ns[after] - first_ns)
    nearest = np.where(is_nearer, before, after)
    rows = np.flatnonzero(np.abs(second_ns[nearest] - first_ns) <= period_ns)
    return rows, nearest[rows]


def _controlled_s(axis: AxisColumns) -> float:
    running = axis.time_s[axis.running]
    return float(running[-1] - running[0]) if len(running) else 0.0


def _differences(
    name: str, one: AxisColumns, other: AxisColumns, pairs: tuple[IntArray, IntArray], since_ns: IntArray
) -> Iterator[SignalDifference]:
    for signal, unit in SIGNALS.items():
        first: npt.NDArray[Any] = getattr(one, signal)[pairs[0]]
        second: npt.NDArray[Any] = getattr(other, signal)[pairs[1]]
        difference = np.abs(first - second)
        difference[np.isnan(first) & np.isnan(second)] = 0.0
        difference[np.isnan(difference)] = np.inf
        place = int(np.argmax(difference))
        yield SignalDifference(
            name,
            signal,
            unit or one.unit,
            float(np.sqrt(np.mean(difference**2))),
            float(difference[place]),
            float(since_ns[place]) * 1e-9,
            float(first[place]),
            float(second[place]),
        )


def _unequal_documents(first: Recording, second: Recording) -> Iterator[str]:
    for name in sorted(first.attachments.keys() | second.attachments.keys()):
        if first.attachments.get(name) != second.attachments.get(name):
            yield name
    one, other = (recording.metadata.get("setpoints", {}) for recording in (first, second))
    for name in sorted(one.keys() | other.keys()):
        if one.get(name) != other.get(name):
            yield f"setpoint of {name} ({one.get(name, 'none')}, {other.get(name, 'none')})"
