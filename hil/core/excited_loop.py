"""The loop of the axis that an identification experiment excites.

It has the methods of an ordinary loop, so that the gateway's limits, guards and life cycle apply unchanged::

             approach ──► settle ──► excited ──► return ──► done
                            ▲          │ position beyond the fence
                            └ recover ◄┘

approach  The axis' controller moves it to the centre, along a minimum-jerk path.
settle    The controller holds it there. The mean of what the valve was given in the second half is the *valve
          offset*, the voltage at which the axis stands still.
excited   ``open loop``: the valve gets the offset plus the excitation. ``controller output``: it gets the
          controller's output plus the excitation. ``setpoint``: the controller follows the centre plus the
          excitation.
recover   The controller brings the axis back to the centre. The excitation goes on afterwards where it was
          interrupted. Samples of this phase are marked in the recording and are not used for a model.
return    The controller brings the axis to the centre a last time.

The excitation advances by one value in each period in which the loop acts. In a period without a good sample
the valve holds, and the recorded voltages say so.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hil.core.control_law import ControlLaw
from hil.core.experiment import Experiment
from hil.core.phase import Phase

MAX_FENCE_CROSSINGS = 20
"""The experiment ends with this crossing of the fence: the excitation is too large for the axis."""
MAX_SETTLE_FACTOR = 5.0
"""The experiment ends if the axis is not near its centre after this many times the settling time."""


class Fence(NamedTuple):
    """Positions, in the axis' unit, beyond which an excited axis goes back under its controller."""

    min_y: float
    max_y: float


class ExcitedLoop:
    """The state machine above. Times are seconds since the first controlled period."""

    def __init__(
        self, law: ControlLaw, experiment: Experiment, values: Sequence[float], fence: Fence
    ) -> None:
        """``values`` are the excitation, one a period: V, or the axis' unit in mode ``setpoint``."""
        self._law = law
        self._experiment = experiment
        self._values = values
        self._fence = fence
        self._index = 0
        self._excitation = 0.0
        self._phase_began_s = 0.0
        self._from_y = 0.0
        self._applied: list[float] = []
        self._offset_known = False
        self.phase = Phase.NONE
        self.offset_v = 0.0
        """Valve offset in V about the valve's centre; 0 until the axis has settled once."""
        self.fence_crossings = 0

    @property
    def is_done(self) -> bool:
        """True when the experiment is over and the axis is back in its centre."""
        return self.phase is Phase.DONE

    @property
    def is_complete(self) -> bool:
        """True when, besides, every value of the excitation was given."""
        return self.is_done and self._index >= len(self._values)

    @property
    def follows_setpoint(self) -> bool:
        """False while the excitation is added to the valve's command: then there is no tracking error."""
        return self.phase is not Phase.EXCITED or self._experiment.mode == "setpoint"

    def describe(self) -> str:
        """Return the present phase in words."""
        axis, low, high = self._experiment.axis, self._fence.min_y, self._fence.max_y
        match self.phase:
            case Phase.APPROACH:
                return f"{axis} moves to its centre, {self._experiment.centre:g}"
            case Phase.SETTLE:
                return f"{axis} settles"
            case Phase.EXCITED:
                given = f"{self._index} of {len(self._values)} values given"
                return f"{axis} is excited, {given}; the valve stands still at {self.offset_v:+.3f} V"
            case Phase.RECOVER:
                return (
                    f"{axis} is beyond its travel fence, {low:g} to {high:g} (rig: axes.{axis}.fence_min_y, "
                    f"fence_max_y): its controller brings it back, crossing {self.fence_crossings}"
                )
            case Phase.RETURN:
                given = f"{self._index} of {len(self._values)} values are given"
                return f"{given}; {axis} returns to its centre"
            case Phase.DONE:
                return "the experiment is done"
            case _:
                return f"{axis} is not excited"

    def outcome(self) -> dict[str, str]:
        """Return how far the experiment came, as texts for the recording's metadata."""
        return {
            "experiment": "complete" if self.is_complete else self.phase.name.lower(),
            "values given": f"{self._index} of {len(self._values)}",
            "valve offset, V": repr(self.offset_v),
            "fence crossings": str(self.fence_crossings),
        }

    def begin(self, t: float, y: float) -> None:
        """Take over at position ``y`` with the valve at its centre."""
        self._index = 0
        self._offset_known = False
        self._applied.clear()
        self.offset_v = 0.0
        self.fence_crossings = 0
        self._law.initialise(y, y, 0.0)
        self._enter(Phase.APPROACH, t, y)

    def output(self, t: float, y: float) -> tuple[float, float]:
        """Return setpoint r and valve voltage u (about the valve's centre) for a sample y at time t."""
        self._change_phase(t, y)
        if self.phase is not Phase.EXCITED:
            r = self._path(t)
            self._excitation = 0.0
            return r, self._law.output(r, y)
        self._excitation = self._values[self._index]
        self._index += 1
        centre = self._experiment.centre
        match self._experiment.mode:
            case "open loop":
                return centre, self.offset_v + self._excitation
            case "controller output":
                return centre, self._law.output(centre, y) + self._excitation
            case "setpoint":
                r = centre + self._excitation
                return r, self._law.output(r, y)

    def advance(self, u_applied: float) -> None:
        """Take what the limits let through, in V about the valve's centre."""
        if self.phase is Phase.SETTLE:
            self._applied.append(u_applied)
        if self.phase is not Phase.EXCITED or self._experiment.mode == "setpoint":
            self._law.advance(u_applied)
        elif self._experiment.mode == "controller output":
            self._law.advance(u_applied - self._excitation)

    def _change_phase(self, t: float, y: float) -> None:
        elapsed = t - self._phase_began_s
        match self.phase:
            case Phase.APPROACH | Phase.RECOVER if elapsed >= self._experiment.approach_s:
                self._applied.clear()
                self._enter(Phase.SETTLE, t, self._experiment.centre)
            case Phase.SETTLE if elapsed >= self._experiment.settle_s and self._is_near_centre(y):
                self._measure_offset()
                self._enter(Phase.EXCITED, t, y)
            case Phase.SETTLE if elapsed >= MAX_SETTLE_FACTOR * self._experiment.settle_s:
                self._enter(Phase.RETURN, t, y)
            case Phase.EXCITED if not self._fence.min_y <= y <= self._fence.max_y:
                self.fence_crossings += 1
                is_last = self.fence_crossings >= MAX_FENCE_CROSSINGS
                self._take_back(Phase.RETURN if is_last else Phase.RECOVER, t, y)
            case Phase.EXCITED if self._index >= len(self._values):
                self._take_back(Phase.RETURN, t, y)
            case Phase.RETURN if elapsed >= self._experiment.approach_s + self._experiment.settle_s:
                self._enter(Phase.DONE, t, self._experiment.centre)

    def _is_near_centre(self, y: float) -> bool:
        """Return whether ``y`` is in the inner half of the fence, so that the excitation may begin there."""
        centre = self._experiment.centre
        return 0.5 * (self._fence.min_y - centre) <= y - centre <= 0.5 * (self._fence.max_y - centre)

    def _measure_offset(self) -> None:
        """Take the mean of the second half; later pauses do not move the offset of an experiment."""
        if not self._offset_known and self._applied:
            half = self._applied[len(self._applied) // 2 :]
            self.offset_v = sum(half) / len(half)
            self._offset_known = True

    def _take_back(self, phase: Phase, t: float, y: float) -> None:
        """Put the axis under its controller, beginning at the voltage at which it stands still."""
        if self._experiment.mode == "open loop":
            self._law.initialise(y, y, self.offset_v)
        self._enter(phase, t, y)

    def _enter(self, phase: Phase, t: float, y: float) -> None:
        self.phase = phase
        self._phase_began_s = t
        self._from_y = y

    def _path(self, t: float) -> float:
        """Return the setpoint: from where the phase began to the centre, along a minimum-jerk path."""
        if self.phase not in (Phase.APPROACH, Phase.RECOVER, Phase.RETURN):
            return self._experiment.centre
        x = min(max((t - self._phase_began_s) / self._experiment.approach_s, 0.0), 1.0)
        blend = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
        return self._from_y + (self._experiment.centre - self._from_y) * blend
