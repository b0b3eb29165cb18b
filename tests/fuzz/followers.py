"""Facts about a rig that follow from the frames on its bus: contacts, valves and the motion of an axis.

Each follower knows only what the frames prove. Where a frame could be judged in two ways, it takes the way
that allows the gateway more, so that it never finds a mistake where there is none.
"""

from __future__ import annotations

from collections import deque

from fuzz import rigs, wire
from fuzz.rigs import Axis, RigFacts

ROUNDING = 1e-9


class Contact:
    """A contact in the frame with the digital inputs."""

    def __init__(self, mask: int, rig: RigFacts) -> None:
        self._mask = mask
        self._version = rig.wire_version
        self._is_protected = rig.inputs_protected
        self._counter: int | None = None
        self._closed_ns: int | None = None

    def take(self, data: bytes, now_ns: int) -> None:
        """Take the data of a frame."""
        if len(data) < wire.length(wire.INPUTS_LENGTH, self._is_protected):
            return
        if self._is_protected and not wire.is_intact(wire.INPUTS, data, self._version):
            return
        if not data[0] & self._mask:
            self._closed_ns = None
            return
        if self._is_protected:
            before, self._counter = self._counter, wire.counter_of(data)
            if before is not None and not 0 < (self._counter - before) % 256 < 128:
                return
        self._closed_ns = now_ns

    def is_closed(self, now_ns: int) -> bool:
        """Return whether the contact is closed and was proved so within its timeout."""
        return self._closed_ns is not None and now_ns - self._closed_ns <= rigs.CONTACT_TIMEOUT_NS


class ReadBack:
    """Comparison of the valve board's pins with the commands."""

    def __init__(self, rig: RigFacts) -> None:
        self._rig = rig
        self._length = wire.length(wire.ANALOGUE_LENGTH, rig.dac_protected)
        self._expected: tuple[int, ...] | None = None
        self._counter: int | None = None
        self._unanswered = 0
        self._different = dict.fromkeys((axis.name for axis in rig.axes), 0)

    def sync(self, commanded: tuple[int, ...]) -> None:
        """Take the command that the board has when SYNC is sent."""
        self._unanswered += self._expected is not None
        self._expected = commanded

    def take(self, data: bytes) -> None:
        """Take the data of a frame."""
        if len(data) != self._length:
            return
        if self._rig.dac_protected:
            if not wire.is_intact(wire.READ_BACK, data, self._rig.wire_version):
                return
            before, self._counter = self._counter, wire.counter_of(data)
            if before is not None and not 0 < (self._counter - before) % 256 < 128:
                return
        if self._expected is None:
            return
        pins, expected = wire.counts_of(data), self._expected
        self._expected = None
        self._unanswered = 0
        for axis in self._rig.axes:
            place = axis.valve_channel - 1
            difference_v = abs(pins[place] - expected[place]) * wire.COUNT_V
            is_different = difference_v > rigs.READ_BACK_TOLERANCE_V + wire.COUNT_V
            self._different[axis.name] = self._different[axis.name] + 1 if is_different else 0

    @property
    def problem(self) -> str | None:
        """Why the valves certainly do not follow their commands, or None."""
        if self._unanswered >= self._rig.stale_periods:
            return f"{self._unanswered} SYNCs without read-back"
        worst = max(self._different, key=lambda name: self._different[name])
        periods = self._different[worst]
        return f"valve of {worst} differs" if periods >= rigs.READ_BACK_PERIODS else None


class Motion:
    """The motion of one axis since control began, against its envelope."""

    def __init__(self, axis: Axis) -> None:
        self._axis = axis
        self._samples: deque[tuple[int, float]] = deque(maxlen=rigs.SPEED_SAMPLES + 1)
        self._error_since_ns: int | None = None
        self._still_since_ns: int | None = None
        self._still_y = 0.0

    def begin(self) -> None:
        """Forget everything, because control begins."""
        self._samples.clear()
        self._error_since_ns = self._still_since_ns = None

    def violation(self, t_ns: int, y: float, error: float) -> str | None:
        """Return which limit the sample ``y`` certainly exceeds, or None. ``t_ns`` is its deadline."""
        axis = self._axis
        if not axis.soft_ends[0] - ROUNDING <= y <= axis.soft_ends[1] + ROUNDING:
            return f"position {y}"
        self._samples.append((t_ns, y))
        before_ns, before_y = self._samples[0]
        way, limit = abs(y - before_y), axis.max_speed * (t_ns - before_ns) / 1e9
        if way > limit + ROUNDING and len(self._samples) > rigs.SPEED_SAMPLES:
            return f"speed: {way} in {t_ns - before_ns} ns"
        if abs(error) <= axis.max_error + ROUNDING:
            self._error_since_ns = None
        elif self._error_since_ns is None:
            self._error_since_ns = t_ns
        elif (t_ns - self._error_since_ns) / 1e9 > axis.max_error_s + ROUNDING:
            return f"tracking error {error} for {t_ns - self._error_since_ns} ns"
        return None

    def standstill(self, t_ns: int, y: float, offset_v: float) -> str | None:
        """Return why the axis should move at this command, or None. Call it after :meth:`violation`."""
        axis = self._axis
        low, high = axis.setpoint_range
        margin, band = 0.05 * (high - low), rigs.STILL_SHARE * (high - low)
        is_suspicious = abs(offset_v) >= axis.far_open_v - 1e-12 and low + margin <= y <= high - margin
        if not is_suspicious:
            self._still_since_ns = None
        elif self._still_since_ns is None or abs(y - self._still_y) > band:
            self._still_since_ns, self._still_y = t_ns, y
        elif (t_ns - self._still_since_ns) / 1e9 > axis.max_still_s + ROUNDING:
            return f"{y} stands still for {t_ns - self._still_since_ns} ns at {offset_v} V"
        return None
