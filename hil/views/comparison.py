"""Compares two recordings signal by signal, aligned on the same event (``comparison_windows``)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hil.core.errors import RecordingError
from hil.recording.reader import Recording
from hil.recording.recorder import ARM_EVENTS, FAULTS_BEGUN
from hil.views.comparison_windows import (
    Control,
    Event,
    Instant,
    Pairs,
    best_shift,
    control_of,
    event_of,
    pairs_of,
)

SIGNALS = {"setpoint": "", "position": "", "error": "", "command_v": "V"}
"""Signals that are compared, and their unit; empty: the unit of the axis."""
_SETTINGS = (
    ("setpoints", "setpoint of {}"),
    (ARM_EVENTS, "arm event {}"),
    (FAULTS_BEGUN, "faults begun at {}"),
    ("plant", "plant: {}"),
)
"""Names of metadata that describe what was done in a run, and how an entry of them is named."""
_NAMED_BEFORE = {"plant": ("events", "faults")}
"""Entries of metadata that repeat those of other metadata."""


@dataclass(frozen=True)
class SignalDifference:
    """The difference of one signal between two runs: first minus second."""

    axis: str
    signal: str
    unit: str
    rms: float
    """Root mean square; NaN if no compared period has a value in both runs."""
    largest: float
    """Largest magnitude; NaN if no compared period has a value in both runs."""
    at_s: float
    """Time of the largest magnitude, in seconds from the event."""
    first: float
    """Value of the first run there."""
    second: float
    """Value of the second run there."""
    only_first: int
    """Number of compared periods in which only the first run has a value."""
    only_second: int


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
    """Number of periods of each axis that were compared."""
    from_s: float
    """Time of the first compared period, in seconds from the event."""
    to_s: float
    """Time of the last compared period, in seconds from the event."""
    signals: tuple[SignalDifference, ...]
    only_first: tuple[str, ...]
    """Axes that only the first run has."""
    only_second: tuple[str, ...]
    documents: tuple[str, ...]
    """Documents that are not equal in both runs."""
    settings: tuple[str, ...]
    """Setpoints, events, faults and plants that are not equal, with the values of both runs."""
    shift_periods: int = 0
    """Periods by which the second run's event was moved, because one of the runs was imported."""

    def exceeding(self, tolerances: Mapping[str, float]) -> list[SignalDifference]:
        """Return the differences over the tolerance of their signal; the key "" is for all signals.

        A signal exceeds every tolerance where only one of the runs has a value.
        """
        return [
            difference
            for difference in self.signals
            if _exceeds(difference, tolerances.get(difference.signal, tolerances.get("", math.inf)))
        ]


def _exceeds(difference: SignalDifference, tolerance: float) -> bool:
    is_known = difference.only_first == difference.only_second == 0
    return difference.largest > tolerance or (not is_known and tolerance < math.inf)


def compare(first: Recording, second: Recording, event: Event | None = None) -> Comparison:
    """Compare the periods in which both runs were under control; all periods if neither ever was.

    ``event`` None: the first event of :class:`Event` that both of them have. Raises RecordingError when a run
    has no period, or lacks ``event``, or when they have no common axis or no common range of time.
    """
    common = [name for name in first.axes if name in second.axes]
    if not common:
        raise RecordingError(
            f"{first.path} and {second.path} have no common axis: {', '.join(first.axes) or 'none'}; "
            f"{', '.join(second.axes) or 'none'}"
        )
    for name in common:
        unit, other_unit = first.axes[name], second.axes[name]
        if unit != other_unit:
            raise RecordingError(f"{name} is in {unit} in {first.path}, and in {other_unit} in {second.path}")
    chosen, events = _aligned(first, second, event)
    shift = 0
    if chosen is Event.RUNNING and any("imported" in run.metadata for run in (first, second)):
        shift, moved = best_shift(first, second, common, events)
        events = events[0], moved
    controls = control_of(first), control_of(second)
    all_periods = controls == (None, None)
    differences: list[SignalDifference] = []
    for name in common:
        axis = _AxisDifference(name, first.axes[name])
        for pairs in pairs_of(first, second, name, events, all_periods):
            axis.add(pairs)
        if axis.periods == 0:
            what = "" if all_periods else " in which both were under control"
            raise RecordingError(
                f"{first.path} and {second.path} have no common range of time{what}, aligned on the {chosen}"
            )
        differences += axis.signals()
    return Comparison(
        chosen,
        events[0].time_s,
        events[1].time_s,
        _controlled_s(controls[0]),
        _controlled_s(controls[1]),
        axis.periods,
        axis.from_s,
        axis.to_s,
        tuple(differences),
        tuple(name for name in first.axes if name not in common),
        tuple(name for name in second.axes if name not in common),
        tuple(_unequal_documents(first, second)),
        tuple(_unequal_settings(first, second)),
        shift,
    )


def _aligned(
    first: Recording, second: Recording, event: Event | None
) -> tuple[Event, tuple[Instant, Instant]]:
    """Return the event, and its periods in both runs."""
    for candidate in Event if event is None else (event,):
        one, other = event_of(first, candidate), event_of(second, candidate)
        if one is not None and other is not None:
            return candidate, (one, other)
    lacking = first if event_of(first, event or Event.BEGIN) is None else second
    what = "period, so there is nothing to compare" if event is None else f"{event.value}; choose another"
    raise RecordingError(f"{lacking.path}: has no {what}")


def _controlled_s(control: Control | None) -> float:
    return 0.0 if control is None else control.duration_s


class _AxisDifference:
    """Collects the differences of one axis, window by window."""

    def __init__(self, name: str, unit: str) -> None:
        self._signals = {
            signal: _SignalSums(name, signal, own_unit or unit) for signal, own_unit in SIGNALS.items()
        }
        self.periods = 0
        self.from_s = self.to_s = 0.0

    def add(self, pairs: Pairs) -> None:
        """Add periods that follow on those before."""
        if self.periods == 0:
            self.from_s = float(pairs.since_s[0])
        self.to_s = float(pairs.since_s[-1])
        self.periods += len(pairs.since_s)
        for name, sums in self._signals.items():
            sums.add(pairs.since_s, getattr(pairs.first, name), getattr(pairs.second, name))

    def signals(self) -> list[SignalDifference]:
        """Return the differences of all signals."""
        return [sums.result() for sums in self._signals.values()]


class _SignalSums:
    """Collects the difference of one signal."""

    def __init__(self, axis: str, signal: str, unit: str) -> None:
        self._names = axis, signal, unit
        self._square_sum = 0.0
        self._count = self._only_first = self._only_second = 0
        self._largest = self._at_s = self._first = self._second = math.nan

    def add(
        self,
        since_s: npt.NDArray[np.float64],
        first: npt.NDArray[np.float64],
        second: npt.NDArray[np.float64],
    ) -> None:
        lacks_first, lacks_second = np.isnan(first), np.isnan(second)
        self._only_first += int(np.count_nonzero(~lacks_first & lacks_second))
        self._only_second += int(np.count_nonzero(lacks_first & ~lacks_second))
        difference = np.abs(first - second)
        known = np.flatnonzero(~(lacks_first | lacks_second))
        # Where neither run has a value, they do not differ.
        self._count += len(known) + int(np.count_nonzero(lacks_first & lacks_second))
        if len(known) == 0:
            return
        self._square_sum += float(np.sum(difference[known] ** 2))
        row = int(known[np.argmax(difference[known])])
        if not self._largest >= difference[row]:
            self._largest, self._at_s = float(difference[row]), float(since_s[row])
            self._first, self._second = float(first[row]), float(second[row])

    def result(self) -> SignalDifference:
        rms = math.nan if math.isnan(self._largest) else math.sqrt(self._square_sum / self._count)
        return SignalDifference(
            *self._names,
            rms,
            self._largest,
            self._at_s,
            self._first,
            self._second,
            self._only_first,
            self._only_second,
        )


def _unequal_documents(first: Recording, second: Recording) -> Iterator[str]:
    for name in sorted(first.attachments.keys() | second.attachments.keys()):
        if first.attachments.get(name) != second.attachments.get(name):
            yield name


def _unequal_settings(first: Recording, second: Recording) -> Iterator[str]:
    for group, label in _SETTINGS:
        one, other = (recording.metadata.get(group, {}) for recording in (first, second))
        for name in sorted(one.keys() | other.keys()):
            if one.get(name) != other.get(name) and name not in _NAMED_BEFORE.get(group, ()):
                yield f"{label.format(name)} ({one.get(name) or 'none'}, {other.get(name) or 'none'})"
