"""A setpoint that approaches another one within limits of speed and acceleration.

In each period the setpoint r moves by a step s. The limits hold exactly in discrete time:

    |s| <= S = max_speed Ts,     |s - s_before| <= D = max_acceleration Ts^2

Towards a constant the motion is time-optimal: the largest step is taken after which braking by D a period
still ends at the target. An axis that brakes from step s needs the way (s - D) + (s - 2 D) + ..., as long as
the terms are positive. The step s and this way are together

    w(s) = (n + 1) s - n (n + 1)/2 D     with n D < s <= (n + 1) D,

which rises strictly. So the largest step for a remaining way w is s = w/(n + 1) + n D/2, with the n for which
n (n + 1)/2 D < w <= (n + 1) (n + 2)/2 D. A remaining way of D or less is one step, which ends at the target.

A moving target is approached in the same way, in coordinates that move with it, while its speed and
acceleration are within the limits. Once r has caught up, r is the target itself. Where the target jumps, or
its speed does, r leaves it and catches up again. r never leaves the range of the axis' setpoints: the way
that remains to each end limits the step as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hil.core.operator_settings import OperatorLimits
from hil.core.setpoints import HOLD, Constant, Function, Setpoint


class StepLimits(NamedTuple):
    """Limits of a setpoint in discrete time, in the axis' unit."""

    max_step: float
    """Largest change of the setpoint in one period."""
    max_change: float
    """Largest change of this step from one period to the next."""
    min_r: float
    """Smallest setpoint of the axis."""
    max_r: float


def step_limits(limits: OperatorLimits, period_s: float, min_r: float, max_r: float) -> StepLimits:
    """Return the limits of speed and acceleration as limits of the steps of one period."""
    return StepLimits(limits.max_speed * period_s, limits.max_acceleration * period_s**2, min_r, max_r)


def largest_step(way: float, max_change: float) -> float:
    """Return the largest step after which braking still ends within ``way``, which is 0 or more."""
    n = max(math.ceil(0.5 * (math.sqrt(1.0 + 8.0 * way / max_change) - 3.0)), 0)
    return way / (n + 1) + 0.5 * n * max_change


def braking_way(step: float, max_change: float) -> float:
    """Return the way from a motion of ``step`` a period to rest, with the sign of ``step``."""
    n = max(math.ceil(abs(step) / max_change) - 1, 0)
    return math.copysign(n * abs(step) - 0.5 * n * (n + 1) * max_change, step)


class SetpointProfile:
    """A setpoint r(t) that approaches the setpoint of a request. Call it once in each controlled period.

    Times are seconds since control began, at most one call a period counts. r is in the axis' unit.
    """

    __slots__ = ("_at", "_limits", "_origin_s", "_period_s", "_r", "_step", "_t")

    def __init__(
        self, setpoint: Setpoint, limits: StepLimits, period_s: float, r: float, step: float
    ) -> None:
        """Begin at ``r`` with a motion of ``step`` a period. ``hold`` brakes, and keeps what it then is."""
        self._limits = limits
        self._period_s = period_s
        rest = r + braking_way(step, limits.max_change)
        self._at: Function = Constant(rest) if setpoint.text == HOLD else setpoint.at
        self._r = r
        self._step = step
        self._origin_s = self._t = math.nan

    @property
    def step(self) -> float:
        """Motion in the last period, in the axis' unit."""
        return self._step

    def begin(self, t: float) -> None:
        """Let control begin at time ``t``: r stays where it is in this period."""
        self._origin_s = self._t = t

    def __call__(self, t: float) -> float:
        """Return r at time ``t``. Time 0 of the request's setpoint is the first call."""
        if t == self._t:
            return self._r
        if math.isnan(self._t):
            self._origin_s = t
        self._t = t
        # Rounded to nanoseconds: a step begins in its own period even if the difference is rounded down.
        target, drift = self._target(round(t - self._origin_s, 9))
        self._advance(target, drift)
        return self._r

    def _target(self, t: float) -> tuple[float, float]:
        """Return the target at ``t``, and its step of this period, or 0 if r could not make this step."""
        now, before, earlier = (self._at(t - k * self._period_s) for k in range(3))
        drift, limits = now - before, self._limits
        is_smooth = abs(drift) <= limits.max_step and abs(drift - (before - earlier)) <= limits.max_change
        return now, drift if is_smooth else 0.0

    def _advance(self, target: float, drift: float) -> None:
        max_step, change, min_r, max_r = self._limits
        r, before = self._r, self._step
        way = target - drift - r
        step = drift + math.copysign(largest_step(abs(way), change), way)
        if abs(way) <= change:
            step = target - r  # Without the rounding errors of the sum, so that r becomes the target.
        # Each limit contains what the ones before it left, if they can be met together.
        step = min(step, max_step, largest_step(max(max_r - r, 0.0), change))
        step = max(step, -max_step, -largest_step(max(r - min_r, 0.0), change))
        step = min(max(step, before - change), before + change)
        self._step = step
        self._r = target if step == target - r else r + step
