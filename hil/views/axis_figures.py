"""Figures of one axis under control: of a step response, or of tracking.

Overshoot, 2 % settling time and steady-state error as in Franklin, Powell, Emami-Naeini, Feedback Control of
Dynamic Systems, section 3.4. The signals may be given in parts, and memory does not grow with their number.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple, Protocol, Self

import numpy as np
import numpy.typing as npt

from hil.recording.tables import BoolArray, FloatArray
from hil.views.tail_mean import TailMean

SETTLING_BAND = 0.02
"""Settling tolerance as a part of the step's size."""
STEADY_PART = 0.2
"""Last part of the response over which the steady-state error is averaged."""
MIN_CONSTANT_PERIODS = 5
"""A change of the setpoint is a step only with a constant setpoint for this many periods on either side."""
MAX_INITIAL_ERROR = 0.1
"""A change of the setpoint is a step only if the error before it was at most this part of its size.

Otherwise the axis was still on its way to an earlier setpoint, as in a fast ladder or a random excitation,
and the readings would mix two responses. It must hold for every change of the run: a single one that does is
chance.
"""
MIN_STEP_PART = 0.005
"""A change of the setpoint is a step only if it is at least this part of the range of setpoints.

A daemon that starts on hold changes the setpoint by about one count of the converter. Nothing can be read
from that: with 12 bits over the range, the settling band of a step below this limit is narrower than one
count.
"""
RISE_FROM, RISE_TO = 0.1, 0.9
"""Parts of the step's size between which the rise time is measured."""
MAX_DELAY_S = 2.0
"""Largest delay of the position behind the setpoint that is looked for."""
MAX_DELAY_PERIODS = 60_000
"""Number of periods, from the first one on, from which the delay is computed: eleven minutes."""


@dataclass(frozen=True)
class StepResponse:
    """The response to the last step of the setpoint. Positions and errors are in ``unit``."""

    unit: str
    step_from: float
    step_to: float
    overshoot_percent: float
    """Largest deviation beyond ``step_to``, in per cent of the step's size."""
    settling_s: float | None
    """Time from the step until the position stays within 2 % of the step's size; None if it does not."""
    steady_state_error: float
    """Mean of setpoint minus position over the last fifth of the response."""
    rise_s: float | None
    """Time from 10 to 90 % of the step's size; None if the position does not reach 90 %."""
    min_valve_v: float
    max_valve_v: float


@dataclass(frozen=True)
class Tracking:
    """The errors with a setpoint other than a step from rest. Errors are in ``unit``."""

    unit: str
    rms_error: float
    max_error: float
    """Largest magnitude of the error."""
    delay_s: float | None
    """Shift of the setpoint in time for which it is closest to the position.

    None if the setpoint is constant, or changes so near the end that the rows do not show a response.
    """
    min_valve_v: float
    max_valve_v: float


class AxisSignals(Protocol):
    """Signals of one axis, one row for each period, as in :class:`hil.recording.tables.AxisTable`."""

    @property
    def time_s(self) -> FloatArray:
        """Time in seconds."""

    @property
    def setpoint(self) -> FloatArray:
        """Setpoint r in ``unit``."""

    @property
    def position(self) -> FloatArray:
        """Measured output y in ``unit``."""

    @property
    def error(self) -> FloatArray:
        """Control error r - y in ``unit``."""

    @property
    def command_v(self) -> FloatArray:
        """Valve voltage after the limits in V."""

    @property
    def running(self) -> BoolArray:
        """True where the controller acted."""

    @property
    def unit(self) -> str:
        """Unit of setpoint, position and error."""


def axis_summary(axis: AxisSignals, min_step: float = 0.0) -> StepResponse | Tracking | None:
    """Return the figures of one axis; None if it was not controlled. ``min_step`` as in ``AxisFigures``."""
    figures = AxisFigures(axis.unit, min_step)
    figures.add(axis)
    return figures.result()


class AxisFigures:
    """Collects the figures of an axis from consecutive parts of its signals.

    They are about the periods from the last one before the controllers acted to the last one in which they
    did. ``min_step``: smallest change of the setpoint that is a step, in ``unit``.
    """

    def __init__(self, unit: str, min_step: float = 0.0) -> None:
        self._unit = unit
        self._min_step = min_step
        self._before: _Rows | None = None
        """Last row before the controllers acted; None if there was none."""
        self._response: _Response | None = None
        """What was collected of all rows from there on."""
        self._controlled: _Response | None = None
        """What was collected up to the last row in which the controllers acted."""

    def add(self, part: AxisSignals) -> None:
        """Take the rows that follow on those before."""
        rows = _Rows(part.time_s, part.setpoint, part.position, part.error, part.command_v)
        running = np.flatnonzero(part.running)
        if self._response is None:
            if len(running) == 0:
                self._before = rows.between(-1, None) if len(rows.time_s) else self._before
                return
            first = int(running[0])
            self._response = _Response()
            if first > 0:
                self._before = rows.between(first - 1, first)
            if self._before is not None:
                self._response.add(self._before)
            rows, running = rows.between(first, None), running - first
        end = int(running[-1]) + 1 if len(running) else 0
        if end:
            self._response.add(rows.between(0, end))
            self._controlled = copy(self._response)
        self._response.add(rows.between(end, None))

    def result(self) -> StepResponse | Tracking | None:
        """Return the figures; None if the axis was not controlled."""
        return None if self._controlled is None else self._controlled.result(self._unit, self._min_step)


class _Rows(NamedTuple):
    time_s: FloatArray
    setpoint: FloatArray
    position: FloatArray
    error: FloatArray
    command_v: FloatArray

    def between(self, begin: int, end: int | None) -> _Rows:
        return _Rows(*(column[begin:end] for column in self))


class _Response:
    """What has been collected of a response. A copy of it stays as it is when more rows are added.

    Row 0 is from before the controllers acted, when the setpoint follows the position. The change from there
    to the first setpoint is a step only if it is more than a deviation of the position.
    """

    def __init__(self) -> None:
        self._count = 0
        self._last: _Rows | None = None
        """Last row that was added."""
        self._first_setpoints: tuple[float, ...] = ()
        """Setpoints of the rows 0 and 1."""
        self._square_sum = self._max_error = 0.0
        self._valve_v = (math.inf, -math.inf)
        self._delay = _Delay()
        self._changes = 0
        """Number of changes of the setpoint under control."""
        self._last_change = 0
        """Row of the last of them."""
        self._are_steps = True
        """True if the axis was at rest before each change."""
        self._step: _Step | None = None
        """Response to the last change, or to the first setpoint."""

    def add(self, rows: _Rows) -> None:
        count = len(rows.time_s)
        if count == 0:
            return
        begin = self._count
        self._first_setpoints += tuple(map(float, rows.setpoint[: max(2 - begin, 0)]))
        self._add_tracking(rows.between(max(1 - begin, 0), None))
        if self._last is not None:
            rows = _Rows(*(np.concatenate(pair) for pair in zip(self._last, rows, strict=True)))
            begin -= 1
        self._add_steps(rows, begin)
        self._count = begin + len(rows.time_s)
        self._last = rows.between(-1, None)

    def _add_tracking(self, rows: _Rows) -> None:
        if len(rows.time_s) == 0:
            return
        self._square_sum += float(np.sum(rows.error**2))
        self._max_error = float(np.maximum(self._max_error, np.abs(rows.error).max()))
        low, high = self._valve_v
        self._valve_v = (
            float(np.minimum(low, rows.command_v.min())),
            float(np.maximum(high, rows.command_v.max())),
        )
        self._delay = self._delay.extended(rows)

    def _add_steps(self, rows: _Rows, begin: int) -> None:
        """Take the changes of the setpoint in rows of which the first was taken before, or is row 0."""
        places = np.flatnonzero(np.diff(rows.setpoint)) + 1
        places = places[places + begin > 1]
        if begin == 0 and len(rows.time_s) > 1:
            self._step = _Step.at(rows, 1)
        if len(places):
            gaps = np.diff(places + begin, prepend=self._last_change if self._changes else -math.inf)
            sizes = np.abs(rows.setpoint[places] - rows.setpoint[places - 1])
            was_at_rest = np.abs(rows.error[places - 1]) <= MAX_INITIAL_ERROR * sizes
            self._are_steps &= bool(np.all(gaps >= MIN_CONSTANT_PERIODS) and np.all(was_at_rest))
            self._changes += len(places)
            self._last_change = begin + int(places[-1])
            self._step = _Step.at(rows, int(places[-1]))
        elif self._step is not None and not (begin == 0 and len(rows.time_s) > 1):
            self._step = self._step.extended(rows.between(1, None))

    def result(self, unit: str, min_step: float) -> StepResponse | Tracking | None:
        if self._count < 2:
            return None
        if self._step is None or self._step.size < min_step or not self._ends_with_step():
            rms = math.sqrt(self._square_sum / (self._count - 1))
            return Tracking(unit, rms, self._max_error, self._delay.result(), *self._valve_v)
        return self._step.result(unit, self._valve_v)

    def _ends_with_step(self) -> bool:
        if self._changes:
            return self._are_steps and self._count - self._last_change >= MIN_CONSTANT_PERIODS
        before, first = self._first_setpoints
        return abs(first - before) > 0.1 * abs(first) > 0.0


class _Step(NamedTuple):
    """The response to one change of the setpoint, as far as it is known. Deviations are parts of its size."""

    step_from: float
    step_to: float
    at_s: float
    largest: float
    """Largest deviation beyond the new setpoint."""
    settled_s: float | None
    """Time after the last row outside the settling band; None if that row is the last one."""
    rise_s: tuple[float | None, float | None]
    """Instants at which the position reached the parts between which it rises."""
    steady: TailMean

    @property
    def size(self) -> float:
        """Magnitude of the change of the setpoint."""
        return abs(self.step_to - self.step_from)

    @classmethod
    def at(cls, rows: _Rows, place: int) -> Self:
        """Return the response to the change in row ``place``, with that row and those that follow."""
        at_s = float(rows.time_s[place])
        step = cls(
            float(rows.setpoint[place - 1]),
            float(rows.setpoint[place]),
            at_s,
            -math.inf,
            at_s,
            (None, None),
            TailMean(),
        )
        return step.extended(rows.between(place, None))

    def extended(self, rows: _Rows) -> Self:
        """Return the response with the rows that follow."""
        size = self.step_to - self.step_from
        if len(rows.time_s) == 0 or size == 0.0:
            return self
        deviation = (rows.position - self.step_to) / size
        return self._replace(
            largest=float(np.maximum(self.largest, deviation.max())),
            settled_s=self._settled_s(rows.time_s, deviation),
            rise_s=(
                self._reached_s(0, rows.time_s, deviation >= RISE_FROM - 1.0),
                self._reached_s(1, rows.time_s, deviation >= RISE_TO - 1.0),
            ),
            steady=self.steady.extended(rows.error),
        )

    def _reached_s(self, place: int, time_s: FloatArray, has_reached: BoolArray) -> float | None:
        if self.rise_s[place] is not None or not has_reached.any():
            return self.rise_s[place]
        return float(time_s[np.argmax(has_reached)])

    def _settled_s(self, time_s: FloatArray, deviation: npt.NDArray[np.float64]) -> float | None:
        outside = np.flatnonzero((deviation > SETTLING_BAND) | (deviation < -SETTLING_BAND))
        if len(outside):
            first_inside = int(outside[-1]) + 1
            return float(time_s[first_inside]) if first_inside < len(time_s) else None
        return float(time_s[0]) if self.settled_s is None else self.settled_s

    def result(self, unit: str, valve_v: tuple[float, float]) -> StepResponse:
        low_s, high_s = self.rise_s
        return StepResponse(
            unit=unit,
            step_from=self.step_from,
            step_to=self.step_to,
            overshoot_percent=100.0 * max(self.largest, 0.0),
            settling_s=None if self.settled_s is None else self.settled_s - self.at_s,
            steady_state_error=self.steady.mean(STEADY_PART),
            rise_s=None if low_s is None or high_s is None else high_s - low_s,
            min_valve_v=valve_v[0],
            max_valve_v=valve_v[1],
        )


class _Delay(NamedTuple):
    """The first rows, from which the delay of the position behind the setpoint is computed."""

    parts: tuple[_Rows, ...] = ()
    length: int = 0

    def extended(self, rows: _Rows) -> _Delay:
        rows = rows.between(0, max(MAX_DELAY_PERIODS - self.length, 0))
        if len(rows.time_s) == 0:
            return self
        return _Delay((*self.parts, rows), self.length + len(rows.time_s))

    def result(self) -> float | None:
        """Return the delay for which the mean square of position minus delayed setpoint is smallest."""
        count = self.length
        if count < 2:
            return None
        time_s, setpoint, position, *_ = (np.concatenate(column) for column in zip(*self.parts, strict=True))
        if np.ptp(setpoint) == 0.0:
            return None
        period_s = float(np.median(np.diff(time_s)))
        largest = min(round(MAX_DELAY_S / period_s), count // 2)
        errors = [
            float(np.mean((position[delay:] - setpoint[: count - delay]) ** 2))
            for delay in range(largest + 1)
        ]
        delay = int(np.argmin(errors))
        # Shifted by this much, a setpoint that changes near the end no longer changes within the rows.
        if np.ptp(setpoint[: count - delay]) == 0.0:
            return None
        return delay * period_s
