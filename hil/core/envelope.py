"""The checks of one axis in state running: soft end stops, speed, tracking error, and a plausible sensor.

A violation is a fault: the gateway centres the valves. Times are those of the samples, so that periods
without a sample count too.
"""

from __future__ import annotations

from collections import deque

from hil.core.envelope_settings import SPEED_PERIODS, Limits

STILL_SHARE = 0.002
"""Share of the axis' range within which a position counts as standing still. Noise and the steps of a 12-bit
converter stay within it."""


class Envelope:
    """The envelope of one axis. Positions and errors are in the axis' unit, times in s, voltages in V."""

    __slots__ = (
        "_error_since_s",
        "_far_open_v",
        "_key",
        "_limits",
        "_max_error",
        "_max_speed",
        "_max_y",
        "_min_y",
        "_recent",
        "_still_band",
        "_still_from_s",
        "_still_y",
        "_unit",
        "follows_setpoint",
    )

    def __init__(self, limits: Limits, axis: str, unit: str) -> None:
        self._limits = limits
        self._key = f"rig: axes.{axis}.envelope."
        self._unit = unit
        # Copies of the limits, because reading an attribute of an attribute is slow in the hot path.
        self._min_y, self._max_y, self._max_speed, self._max_error = limits[:4]
        self._far_open_v = limits.far_open_v
        self._still_band = STILL_SHARE * limits.range_y
        self._recent: deque[tuple[float, float]] = deque(maxlen=SPEED_PERIODS + 1)
        """Times and positions of the last samples."""
        self._error_since_s: float | None = None
        """Time of the first sample in a row with a tracking error over the limit."""
        self._still_from_s: float | None = None
        """Time of the first sample in a row with the valve far open and the position at ``_still_y``."""
        self._still_y = 0.0
        self.follows_setpoint = True
        """False while an experiment moves the valve, so that there is no tracking error."""

    def begin(self) -> None:
        """Forget all earlier samples, because control begins."""
        self._recent.clear()
        self._error_since_s = self._still_from_s = None

    def check(self, t: float, y: float, error: float, offset_v: float) -> str | None:
        """Return what the sample ``y`` at time ``t`` violates, or None.

        ``error`` is the tracking error. ``offset_v`` is the valve's command about its centre, after the
        limits.
        """
        if not self._min_y <= y <= self._max_y:
            return self._beyond(y)
        recent = self._recent
        recent.append((t, y))
        before_s, before_y = recent[0]
        if abs(y - before_y) > self._max_speed * (t - before_s) and len(recent) > SPEED_PERIODS:
            return self._too_fast(abs(y - before_y), t - before_s)
        if -self._max_error <= error <= self._max_error or not self.follows_setpoint:
            self._error_since_s = None
        elif self._error_since_s is None:
            self._error_since_s = t
        elif t - self._error_since_s > self._limits.max_error_s:
            return self._does_not_follow(error, t - self._error_since_s)
        if -self._far_open_v < offset_v < self._far_open_v:
            self._still_from_s = None
            return None
        return self._check_still(t, y, offset_v)

    def refusal(self, setpoint: float, y: float) -> str | None:
        """Return why control must not begin at position ``y`` with this first setpoint, or None."""
        if not self._min_y <= y <= self._max_y:
            return f"{self._beyond(y)}; move the axis back by hand"
        if abs(setpoint - y) <= self._max_error:
            return None
        unit = self._unit
        return (
            f"the setpoint begins at {setpoint:g} {unit} and the position is {y:.4g} {unit}: they are "
            f"{abs(setpoint - y):.4g} {unit} apart, limit {self._max_error:g} {unit} ({self._key}max_error); "
            "begin with the setpoint at the position (hold), or move the axis there"
        )

    def _check_still(self, t: float, y: float, offset_v: float) -> str | None:
        """Check that an axis with a far open valve moves, unless an end stop may hold it."""
        limits = self._limits
        is_inside = limits.moving_min_y <= y <= limits.moving_max_y
        if self._still_from_s is None or not is_inside or abs(y - self._still_y) > self._still_band:
            self._still_from_s, self._still_y = t, y
            return None
        still_s = t - self._still_from_s
        if still_s <= limits.max_still_s:
            return None
        return (
            f"the position stands still at {y:.4g} {self._unit} for {still_s:.4g} s, limit "
            f"{limits.max_still_s:g} s ({self._key}max_still_s), with the valve {offset_v:+.2f} V from its "
            f"centre, far open from {limits.far_open_v:g} V on ({self._key}far_open_v): check the "
            "potentiometer, the valve and the supply"
        )

    def _beyond(self, y: float) -> str:
        side, key, limit = (
            ("below the lower", "min_y", self._min_y)
            if y < self._min_y
            else ("above the upper", "max_y", self._max_y)
        )
        return (
            f"position {y:.4g} {self._unit} is {side} soft end stop {limit:g} {self._unit} ({self._key}{key})"
        )

    def _too_fast(self, way: float, duration_s: float) -> str:
        unit = f"{self._unit}/s"
        return (
            f"the position changes by {way / duration_s:.4g} {unit} over {1e3 * duration_s:.4g} ms, limit "
            f"{self._max_speed:g} {unit} ({self._key}max_speed): check the potentiometer and its cable"
        )

    def _does_not_follow(self, error: float, duration_s: float) -> str:
        limits, unit = self._limits, self._unit
        return (
            f"the tracking error is {error:.4g} {unit}, over {limits.max_error:g} {unit} "
            f"({self._key}max_error) for {duration_s:.4g} s, limit {limits.max_error_s:g} s "
            f"({self._key}max_error_s): check the sign of the controller, the valve and the supply"
        )
