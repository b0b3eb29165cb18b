"""The profile of a changed setpoint: exact limits in discrete time, the shortest time, and no overshoot."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.operator_settings import OperatorLimits
from hil.core.setpoint_profile import SetpointProfile, StepLimits, braking_way, largest_step, step_limits
from hil.core.setpoints import Setpoint, parse_setpoint

PERIOD_S = 0.01
LIMITS = step_limits(OperatorLimits(0.4, 2.0, 1.0, 0.5), PERIOD_S, -0.15, 0.15)
ROUNDING = 1e-12


def constant(value: float) -> Setpoint:
    return Setpoint("", lambda _t: value, value, value)


def follow(
    setpoint: Setpoint, periods: int, r: float = 0.0, step: float = 0.0, limits: StepLimits = LIMITS
) -> list[float]:
    """The profile's values from ``r`` on, which is the first one."""
    profile = SetpointProfile(setpoint, limits, PERIOD_S, r, step)
    return [r, *(profile(k * PERIOD_S) for k in range(periods))]


def assert_within_limits(values: list[float], step: float = 0.0, limits: StepLimits = LIMITS) -> None:
    steps = [step, *(after - before for before, after in pairwise(values))]
    scale = ROUNDING * max(1.0, *map(abs, values))
    assert all(abs(s) <= limits.max_step + scale for s in steps[1:])
    assert all(abs(after - before) <= limits.max_change + scale for before, after in pairwise(steps))


def shortest(way: float, limits: StepLimits) -> int:
    """The smallest number of periods of any motion from rest to rest over ``way``, by its largest way."""
    periods = 0
    while True:
        # The largest steps that end at rest rise by max_change, stay at max_step, and fall by max_change.
        steps = [
            min((k + 1) * limits.max_change, (periods - k) * limits.max_change, limits.max_step)
            for k in range(periods)
        ]
        if sum(steps) >= way * (1.0 - 1e-12):
            return periods
        periods += 1


class TestTowardsAConstant:
    @pytest.mark.parametrize("target", [0.1, -0.1, 0.0004, 0.0002, 0.0001, 1e-9, 0.15, -0.15])
    def test_the_target_is_reached_exactly_in_the_shortest_time(self, target: float) -> None:
        values = follow(constant(target), 200)
        arrived = values.index(target)
        assert arrived == shortest(abs(target), LIMITS)
        assert values[arrived:] == [target] * (len(values) - arrived)
        assert_within_limits(values)
        assert all(abs(after) >= abs(before) for before, after in pairwise(values))

    def test_a_long_way_has_a_phase_at_the_largest_speed(self) -> None:
        values = follow(constant(0.15), 100, r=-0.15)
        steps = [after - before for before, after in pairwise(values)]
        assert sum(abs(step - LIMITS.max_step) < ROUNDING for step in steps) > 40

    def test_a_target_at_the_present_setpoint_moves_nothing(self) -> None:
        assert follow(constant(0.05), 5, r=0.05) == [0.05] * 6

    @settings(max_examples=60, deadline=None)
    @given(
        st.floats(-1.0, 1.0),
        st.floats(-1.0, 1.0),
        st.floats(1e-3, 10.0),
        st.floats(1e-2, 100.0),
        st.floats(-1.0, 1.0),
    )
    def test_limits_hold_from_every_beginning(
        self, r: float, target: float, speed: float, acceleration: float, share: float
    ) -> None:
        limits = step_limits(OperatorLimits(speed, acceleration, 1.0, 0.5), PERIOD_S, -1e3, 1e3)
        step = share * limits.max_step
        values = follow(constant(target), 3000, r, step, limits)
        assert_within_limits(values, step, limits)
        way = abs(target - r) + 2.0 * abs(braking_way(step, limits.max_change))
        periods = way / limits.max_step + 4.0 * limits.max_step / limits.max_change + 20.0
        if periods < 3000:
            assert values[-1] == target

    @settings(max_examples=100, deadline=None)
    @given(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15), st.floats(0.1, 1.0))
    def test_a_motion_that_can_stop_in_time_does_not_overshoot(
        self, r: float, target: float, share: float
    ) -> None:
        way = target - r
        step = math.copysign(min(largest_step(abs(way), LIMITS.max_change), LIMITS.max_step) * share, way)
        values = follow(constant(target), 400, r, step)
        assert values[-1] == target
        assert all((target - value) * way >= -ROUNDING for value in values)


class TestBraking:
    @given(st.floats(0.0, 100.0), st.floats(1e-6, 10.0))
    def test_the_way_after_the_largest_step_is_the_braking_way(self, way: float, change: float) -> None:
        step = largest_step(way, change)
        assert step + braking_way(step, change) == pytest.approx(way, rel=1e-9, abs=1e-12)

    def test_the_braking_way_is_the_sum_of_the_falling_steps(self) -> None:
        assert braking_way(1.0, 0.25) == pytest.approx(0.75 + 0.5 + 0.25)
        assert braking_way(-1.1, 0.25) == pytest.approx(-(0.85 + 0.6 + 0.35 + 0.1))
        assert braking_way(0.2, 0.25) == 0.0

    def test_hold_brakes_and_stays_without_going_back(self) -> None:
        values = follow(parse_setpoint("hold"), 60, r=0.02, step=LIMITS.max_step)
        assert_within_limits(values, LIMITS.max_step)
        assert values == sorted(values)
        assert values[-1] == pytest.approx(0.02 + braking_way(LIMITS.max_step, LIMITS.max_change))
        assert values[-1] == values[-2]

    def test_a_faster_motion_than_the_limit_is_braked_by_the_largest_acceleration(self) -> None:
        step = 3.0 * LIMITS.max_step
        values = follow(constant(0.1), 300, r=-0.1, step=step)
        steps = [after - before for before, after in pairwise(values)]
        assert steps[0] == pytest.approx(step - LIMITS.max_change)
        assert values[-1] == 0.1


class TestMovingTargets:
    @pytest.mark.parametrize(
        "text",
        ["minimum-jerk:0.1@0.5/1", "ramp:0.1@0.5/1", "sine:0.03@0.5/2", "ladder:0.1,-0.1,0.05@0.1/0.9"],
    )
    def test_the_profile_catches_up_and_then_is_the_target(self, text: str) -> None:
        setpoint = parse_setpoint(text)
        values = follow(setpoint, 400, r=0.02)
        assert_within_limits(values)
        at: Callable[[float], float] = setpoint.at
        caught_up = [value == at(k * PERIOD_S) for k, value in enumerate(values[1:])]
        assert sum(caught_up) > 200
        assert caught_up[-1]

    @settings(max_examples=100, deadline=None)
    @given(
        st.sampled_from(["ramp:{}@0.2/{}", "minimum-jerk:{}@0.2/{}", "sine:{}@0.2/{}", "ladder:{},0@0.2/{}"]),
        st.floats(-0.15, 0.15),
        st.floats(0.05, 2.0),
        st.floats(-0.15, 0.15),
    )
    def test_the_profile_never_leaves_the_range_of_the_axis(
        self, form: str, size: float, span: float, r: float
    ) -> None:
        values = follow(parse_setpoint(form.format(size, span)), 300, r)
        assert_within_limits(values)
        assert all(-0.15 - ROUNDING <= value <= 0.15 + ROUNDING for value in values)

    def test_time_0_is_the_first_call(self) -> None:
        profile = SetpointProfile(parse_setpoint("step:0.1@0.05"), LIMITS, PERIOD_S, 0.0, 0.0)
        values = [profile(7.0 + k * PERIOD_S) for k in range(8)]
        assert values[:5] == [0.0] * 5
        assert values[5] > 0.0

    def test_a_second_call_in_a_period_moves_nothing(self) -> None:
        profile = SetpointProfile(constant(0.1), LIMITS, PERIOD_S, 0.0, 0.0)
        assert profile(0.0) == profile(0.0) == LIMITS.max_change
        assert profile.step == LIMITS.max_change

    def test_control_that_begins_stays_at_the_first_setpoint_for_one_period(self) -> None:
        profile = SetpointProfile(constant(0.1), LIMITS, PERIOD_S, 0.03, 0.0)
        profile.begin(0.0)
        assert profile(0.0) == 0.03
        assert profile(PERIOD_S) == pytest.approx(0.03 + LIMITS.max_change)
