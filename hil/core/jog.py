"""A jog: one axis is moved with a constant valve voltage for a short time, without a controller.

The jog ends after its time, at the travel fence, or with any trigger that leaves state running. An axis that
begins beyond the fence may move back; the jog ends if it moves further out.
"""

from __future__ import annotations

from typing import NamedTuple

from hil.core.excited_loop import Fence
from hil.core.requests import JogRequest
from hil.core.rig import AxisSettings

OUTWARD_SHARE = 0.002
"""Share of the axis' range by which noise may show an axis beyond the fence further out than it is."""


class JogEnd(NamedTuple):
    """Reason why a jog ends before its time."""

    reason: str


class Jog:
    """The motion of one axis in a jog. Positions are in the axis' unit, times in monotonic nanoseconds."""

    offset_v: float
    """Valve voltage in volts, relative to the valve's centre."""
    end_ns: int
    """Time from which on the valve is centred."""

    def __init__(self, axis: AxisSettings, request: JogRequest, now_ns: int) -> None:
        self._fence = Fence(*axis.fence_limits)
        self._unit = axis.unit
        self._outward = OUTWARD_SHARE * (axis.max_y - axis.min_y)
        self._limits = self._fence
        self.axis = request.axis
        self.extend(request, now_ns)

    def extend(self, request: JogRequest, now_ns: int) -> None:
        """Take a further request for the same axis: its voltage, and its time from ``now_ns`` on."""
        self.offset_v = request.offset_v
        self.end_ns = now_ns + round(request.duration_s * 1e9)

    def begin(self, y: float) -> None:
        """Begin at position ``y``."""
        low, high = self._fence
        self._limits = Fence(
            low if y >= low else y - self._outward,
            high if y <= high else y + self._outward,
        )

    def check(self, y: float) -> JogEnd | None:
        """Return why the jog must end at position ``y``, or None."""
        if self._limits.min_y <= y <= self._limits.max_y:
            return None
        low, high = self._fence
        return JogEnd(
            f"position {y:.4g} {self._unit} is beyond the travel fence, {low:g} to {high:g} {self._unit} "
            f"(rig: axes.{self.axis}.fence_min_y, fence_max_y)"
        )


def limits_refusal(request: JogRequest, axis: AxisSettings) -> str | None:
    """Return why the limits of ``axis`` do not allow a jog, or None."""
    limits = axis.operator_limits
    key = f"rig: axes.{request.axis}.operator"
    if not abs(request.offset_v) <= limits.jog_max_v:
        return f"the jog's offset is {request.offset_v:g} V, limit {limits.jog_max_v:g} V ({key}.jog_max_v)"
    if not 0.0 < request.duration_s <= limits.jog_max_s:
        return (
            f"the jog's time is {request.duration_s:g} s, but must be over 0 s and at most "
            f"{limits.jog_max_s:g} s ({key}.jog_max_s); repeat the request to go on"
        )
    return None
