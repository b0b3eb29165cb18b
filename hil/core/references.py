"""Where the setpoint of an axis comes from, and how it begins when control begins."""

from __future__ import annotations

from typing import Protocol

from hil.core.rig import AxisSettings
from hil.core.setpoint_profile import SetpointProfile, step_limits
from hil.core.setpoints import Constant, Function, Setpoint


def present_step(setpoint: Function, t: float, period_s: float) -> float:
    """Return the motion of a setpoint in the period that ends at ``t``, in the axis' unit."""
    if isinstance(setpoint, SetpointProfile):
        return setpoint.step
    return setpoint(t) - setpoint(t - period_s)


class Reference(Protocol):
    """Origin of an axis' setpoint. Positions are in the axis' unit, times in seconds since control began."""

    def first(self, y: float) -> float:
        """Return the setpoint with which control begins at position ``y``."""

    def begin(self, t: float, y: float) -> Function:
        """Return r(t) for control that begins at time ``t`` and position ``y``."""


class GivenSetpoint:
    """A setpoint that is given as a function of time, as for the start of a run."""

    def __init__(self, setpoint: Setpoint) -> None:
        self._at = setpoint.at

    def first(self, y: float) -> float:
        """Return the setpoint at time 0."""
        return self._at(0.0)

    def begin(self, t: float, y: float) -> Function:
        """Return the setpoint itself."""
        return self._at


class HeldPosition:
    """The position at which the axis was when control began."""

    def first(self, y: float) -> float:
        """Return the position ``y``."""
        return y

    def begin(self, t: float, y: float) -> Function:
        """Return the position ``y`` as a constant."""
        return Constant(y)


class OperatorSetpoints:
    """Makes the references of one axis that an operator asks for."""

    def __init__(self, axis: AxisSettings, period_s: float) -> None:
        self._limits = step_limits(axis.operator_limits, period_s, axis.min_y, axis.max_y)
        self._max_present_step = axis.limits.max_speed * period_s
        self._period_s = period_s

    def reference(self, setpoint: Setpoint) -> LimitedSetpoint:
        """Return the reference that approaches ``setpoint`` within the axis' limits."""
        return LimitedSetpoint(self, setpoint)

    def profile(self, setpoint: Setpoint, r: float, step: float) -> SetpointProfile:
        """Return the profile that begins at ``r`` with a motion of ``step`` a period.

        A step beyond the envelope's speed is a jump, after which the setpoint stands still.
        """
        speed = step if abs(step) <= self._max_present_step else 0.0
        return SetpointProfile(setpoint, self._limits, self._period_s, r, speed)


class LimitedSetpoint:
    """A setpoint that is approached within the axis' limits of speed and acceleration."""

    def __init__(self, maker: OperatorSetpoints, setpoint: Setpoint) -> None:
        self._maker = maker
        self._setpoint = setpoint
        self.text = setpoint.text
        """Setpoint as it was asked for."""

    def first(self, y: float) -> float:
        """Return the position ``y``, from which the setpoint is approached."""
        return y

    def begin(self, t: float, y: float) -> Function:
        """Return the profile that begins at rest at position ``y``."""
        profile = self._maker.profile(self._setpoint, y, 0.0)
        profile.begin(t)
        return profile

    def take_over(self, r: float, step: float) -> Function:
        """Return the profile that goes on from setpoint ``r``, which moves by ``step`` a period."""
        return self._maker.profile(self._setpoint, r, step)
