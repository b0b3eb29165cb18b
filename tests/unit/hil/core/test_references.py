"""Where the setpoint of an axis comes from, and how an operator's setpoint begins."""

from __future__ import annotations

import math

import pytest
from support.constants import PERIOD_S
from support.shipped_rig import SHIPPED_RIG

from hil.core.references import GivenSetpoint, HeldPosition, OperatorSetpoints, present_step
from hil.core.setpoint_profile import SetpointProfile
from hil.core.setpoints import Constant, parse_setpoint

AXIS = SHIPPED_RIG.axes["vertical"]
RAMP = parse_setpoint("ramp:0.1@0/1")
TARGET = parse_setpoint("step:0.1@0")


def operators(period_s: float = PERIOD_S, axis: str = "vertical") -> OperatorSetpoints:
    return OperatorSetpoints(SHIPPED_RIG.axes[axis], period_s)


def test_a_given_setpoint_begins_with_its_value_at_time_0() -> None:
    given = GivenSetpoint(parse_setpoint("step:0.1@0.5"))
    assert given.first(0.03) == 0.0
    assert given.begin(7.0, 0.03)(0.5) == 0.1
    assert GivenSetpoint(parse_setpoint("ladder:0.1,0.2@0/1")).first(0.03) == 0.1


def test_a_held_setpoint_is_the_position() -> None:
    assert HeldPosition().first(0.03) == 0.03
    assert HeldPosition().begin(7.0, 0.03) == Constant(0.03)


def test_the_motion_of_a_function_is_its_change_in_the_last_period() -> None:
    assert present_step(RAMP.at, 0.5, 0.01) == pytest.approx(0.001)
    assert present_step(RAMP.at, 5.0, 0.01) == 0.0


def test_the_motion_of_a_profile_is_its_own_and_asking_does_not_advance_it() -> None:
    profile = operators().reference(TARGET).begin(0.0, 0.0)
    assert isinstance(profile, SetpointProfile)
    moved = profile(PERIOD_S)
    assert present_step(profile, PERIOD_S, PERIOD_S) == profile.step == pytest.approx(moved)
    assert profile(PERIOD_S) == moved > 0.0


def test_an_operators_setpoint_begins_at_the_position_at_rest() -> None:
    reference = operators().reference(TARGET)
    assert reference.text == "step:0.1@0"
    assert reference.first(0.02) == 0.02
    r = reference.begin(3.0, 0.02)
    assert r(3.0) == 0.02
    assert r(3.0 + PERIOD_S) == pytest.approx(0.02 + AXIS.operator_limits.max_acceleration * PERIOD_S**2)


@pytest.mark.parametrize("axis", ["vertical", "rotation"])
def test_it_begins_at_rest_whatever_the_period_is(axis: str) -> None:
    """With a long period, a step of 1 would be within the axis' speed."""
    profile = operators(1.0, axis).reference(TARGET).begin(0.0, 0.02)
    assert isinstance(profile, SetpointProfile)
    assert profile.step == 0.0


def test_a_motion_within_the_envelopes_speed_goes_on_and_a_jump_does_not() -> None:
    fastest = AXIS.limits.max_speed * PERIOD_S
    maker = operators()
    for step in (fastest, -fastest, 0.001):
        assert maker.profile(TARGET, 0.02, step).step == step
        taken = maker.reference(TARGET).take_over(0.02, step)
        assert isinstance(taken, SetpointProfile)
        assert taken.step == step
    for step in (math.nextafter(fastest, 1.0), -0.1):
        assert maker.profile(TARGET, 0.02, step).step == 0.0
