"""The envelope of an axis: each check just inside and just outside its limit, and its time."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.constants import PERIOD_S

from hil.core.envelope import STILL_SHARE, Envelope
from hil.core.envelope_settings import SPEED_PERIODS, Limits

LIMITS = Limits(
    min_y=-0.16,
    max_y=0.16,
    max_speed=1.0,
    max_error=0.075,
    max_error_s=0.5,
    max_still_s=0.3,
    far_open_v=3.0,
    range_y=0.3,
    moving_min_y=-0.135,
    moving_max_y=0.135,
)
TINY = 1e-9


def envelope(**changes: float) -> Envelope:
    begun = Envelope(LIMITS._replace(**changes), "vertical", "m")
    begun.begin()
    return begun


class TestEndStops:
    @pytest.mark.parametrize("y", [-0.16, 0.16, 0.0])
    def test_a_position_at_the_stop_is_inside(self, y: float) -> None:
        assert envelope().check(0.0, y, 0.0, 0.0) is None

    @pytest.mark.parametrize(
        ("y", "said"),
        [
            (-0.16 - TINY, "is below the lower soft end stop -0.16 m (rig: axes.vertical.envelope.min_y)"),
            (0.16 + TINY, "is above the upper soft end stop 0.16 m (rig: axes.vertical.envelope.max_y)"),
        ],
    )
    def test_a_position_beyond_is_a_violation_at_once(self, y: float, said: str) -> None:
        assert envelope().check(0.0, y, 0.0, 0.0) == f"position {y:.4g} m {said}"


def at_speed(speed: float, periods: int, begun: Envelope) -> str | None:
    """The first violation of a position that moves at ``speed`` for some periods."""
    found = (begun.check(k * PERIOD_S, -0.1 + speed * k * PERIOD_S, 0.0, 0.0) for k in range(periods + 1))
    return next((violation for violation in found if violation is not None), None)


class TestSpeed:
    def test_a_speed_at_the_limit_is_allowed(self) -> None:
        assert at_speed(1.0 - TINY, 15, envelope()) is None

    @pytest.mark.parametrize("direction", [1.0, -1.0])
    def test_a_higher_speed_is_a_violation_after_a_few_periods(self, direction: float) -> None:
        speed = direction * 1.001
        assert at_speed(speed, SPEED_PERIODS - 1, envelope()) is None
        assert at_speed(speed, SPEED_PERIODS, envelope()) == (
            "the position changes by 1.001 m/s over 44.8 ms, limit 1 m/s "
            "(rig: axes.vertical.envelope.max_speed): check the potentiometer and its cable"
        )

    def test_a_step_of_the_converter_is_no_speed(self) -> None:
        """One period alone would show 7 m/s at a limit of 1 m/s, if it were the only one."""
        begun = envelope()
        positions = [0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0]
        assert [begun.check(k * PERIOD_S, y, 0.0, 0.0) for k, y in enumerate(positions)] == [None] * 9

    def test_periods_without_a_sample_count(self) -> None:
        """The axis moves at 0.9 m/s. Four samples then take five periods."""
        begun = envelope()
        times_s = [k * PERIOD_S for k in (0, 1, 2, 3, 5, 6, 8)]
        assert [begun.check(t, 0.9 * t, 0.0, 0.0) for t in times_s] == [None] * len(times_s)

    def test_samples_before_the_start_do_not_count(self) -> None:
        begun = envelope()
        for k in range(6):
            begun.check(k * PERIOD_S, 0.1, 0.0, 0.0)
        begun.begin()
        assert begun.check(0.0, -0.1, 0.0, 0.0) is None


def error_lasts(begun: Envelope, error: float, duration_s: float, start_s: float = 0.0) -> str | None:
    begun.check(start_s, 0.0, error, 0.0)
    return begun.check(start_s + duration_s, 0.0, error, 0.0)


class TestTrackingError:
    @pytest.mark.parametrize("error", [0.075, -0.075])
    def test_an_error_at_the_limit_may_last(self, error: float) -> None:
        assert error_lasts(envelope(), error, 100.0) is None

    @pytest.mark.parametrize("error", [0.075 + TINY, -0.075 - TINY, 1e300])
    def test_a_larger_error_may_last_for_the_time_and_no_longer(self, error: float) -> None:
        assert error_lasts(envelope(), error, 0.5) is None
        violation = error_lasts(envelope(), error, 0.5 + TINY)
        assert violation == (
            f"the tracking error is {error:.4g} m, over 0.075 m (rig: axes.vertical.envelope.max_error) for "
            "0.5 s, limit 0.5 s (rig: axes.vertical.envelope.max_error_s): check the sign of the controller, "
            "the valve and the supply"
        )

    def test_the_time_begins_again_after_a_small_error(self) -> None:
        begun = envelope()
        assert error_lasts(begun, 0.1, 0.4) is None
        assert begun.check(0.41, 0.0, 0.075, 0.0) is None
        assert error_lasts(begun, 0.1, 0.5, start_s=0.42) is None
        assert begun.check(0.93, 0.0, 0.1, 0.0) is not None


def stands_still(begun: Envelope, offset_v: float, duration_s: float, y: float = 0.0) -> str | None:
    begun.check(0.0, y, 0.0, offset_v)
    return begun.check(duration_s, y, 0.0, offset_v)


class TestStandstill:
    @pytest.mark.parametrize("offset_v", [2.9999, -2.9999, 0.0])
    def test_with_a_less_open_valve_the_axis_may_stand_still(self, offset_v: float) -> None:
        assert stands_still(envelope(), offset_v, 100.0) is None

    @pytest.mark.parametrize("offset_v", [3.0, -3.0, 5.0])
    def test_with_a_far_open_valve_it_may_do_so_for_the_time_and_no_longer(self, offset_v: float) -> None:
        assert stands_still(envelope(), offset_v, 0.3) is None
        violation = stands_still(envelope(), offset_v, 0.3 + TINY)
        assert violation == (
            "the position stands still at 0 m for 0.3 s, limit 0.3 s "
            f"(rig: axes.vertical.envelope.max_still_s), with the valve {offset_v:+.2f} V from its centre, "
            "far open from 3 V on (rig: axes.vertical.envelope.far_open_v): check the "
            "potentiometer, the valve and the supply"
        )

    @pytest.mark.parametrize(
        ("moved", "is_violation"), [(STILL_SHARE * 0.3 - TINY, True), (STILL_SHARE * 0.3 + TINY, False)]
    )
    def test_a_movement_larger_than_the_noise_is_no_standstill(
        self, moved: float, is_violation: bool
    ) -> None:
        begun = envelope()
        begun.check(0.0, 0.0, 0.0, 4.0)
        assert begun.check(0.2, moved, 0.0, 4.0) is None
        assert (begun.check(0.35, moved, 0.0, 4.0) is not None) is is_violation

    @pytest.mark.parametrize(
        ("y", "is_violation"), [(0.135, True), (0.1351, False), (-0.135, True), (-0.1351, False)]
    )
    def test_near_the_ends_an_end_stop_may_hold_the_axis(self, y: float, is_violation: bool) -> None:
        assert (stands_still(envelope(), 5.0, 100.0, y) is not None) is is_violation

    def test_a_valve_that_closes_begins_the_time_again(self) -> None:
        begun = envelope()
        assert stands_still(begun, 4.0, 0.2) is None
        assert begun.check(0.21, 0.0, 0.0, 1.0) is None
        assert begun.check(0.22, 0.0, 0.0, 4.0) is None
        assert begun.check(0.51, 0.0, 0.0, 4.0) is None
        assert begun.check(0.53, 0.0, 0.0, 4.0) is not None


class TestStart:
    def test_a_setpoint_within_the_largest_error_is_accepted(self) -> None:
        assert envelope().refusal(0.075, 0.0) is None

    def test_a_farther_setpoint_is_refused(self) -> None:
        assert envelope().refusal(0.1, -0.02) == (
            "the setpoint begins at 0.1 m and the position is -0.02 m: they are 0.12 m apart, limit 0.075 m "
            "(rig: axes.vertical.envelope.max_error); begin with the setpoint at the position (hold), or "
            "move the axis there"
        )

    def test_a_position_beyond_an_end_stop_is_refused(self) -> None:
        assert envelope().refusal(0.16, 0.161) == (
            "position 0.161 m is above the upper soft end stop 0.16 m (rig: axes.vertical.envelope.max_y); "
            "move the axis back by hand"
        )


DISABLED = LIMITS._replace(
    min_y=-math.inf, max_y=math.inf, max_speed=math.inf, max_error=math.inf, max_still_s=math.inf
)
signals = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-5.0, 5.0))


@given(st.lists(signals, max_size=60))
def test_disabled_checks_never_act(samples: list[tuple[float, float, float]]) -> None:
    disabled = Envelope(DISABLED, "vertical", "m")
    assert disabled.refusal(1.0, -1.0) is None
    for k, (y, error, offset_v) in enumerate(samples):
        assert disabled.check(0.5 * k, y, error, offset_v) is None


@given(st.lists(signals, max_size=60))
def test_a_violation_names_a_limit_that_the_samples_exceed(samples: list[tuple[float, float, float]]) -> None:
    begun = envelope()
    for k, (y, error, offset_v) in enumerate(samples):
        violation = begun.check(0.1 * k, y, error, offset_v)
        if violation is None:
            assert -0.16 <= y <= 0.16
            continue
        key = re.findall(r"axes\.vertical\.envelope\.(\w+)", violation)[0]
        assert {
            "min_y": y < -0.16,
            "max_y": y > 0.16,
            "max_speed": k >= SPEED_PERIODS and abs(y - samples[k - SPEED_PERIODS][0]) > 0.4,
            "max_error": min(abs(past[1]) for past in samples[max(k - 6, 0) : k + 1]) > 0.075,
            "max_still_s": min(abs(past[2]) for past in samples[max(k - 3, 0) : k + 1]) >= 3.0,
        }[key]
        return


WIDE = {"min_y": -10.0, "max_y": 10.0, "max_error": 10.0}
"""Limits for positions that binary fractions give exactly."""


def test_the_speed_is_measured_over_four_periods_and_no_more() -> None:
    """A jump that five periods would allow."""
    begun = envelope()
    for k in range(10):
        assert begun.check(k * PERIOD_S, 0.0, 0.0, 0.0) is None
    assert begun.check(10 * PERIOD_S, 4.5 * PERIOD_S, 0.0, 0.0) is not None


def test_exactly_the_largest_speed_is_allowed() -> None:
    begun = envelope(**WIDE)
    assert [begun.check(0.25 * k, 0.25 * k, 0.0, 0.0) for k in range(8)] == [None] * 8


def test_messages_name_durations_and_not_times() -> None:
    begun = envelope(**WIDE)
    found = [begun.check(8.0 + 0.25 * k, 0.5 * k, 0.0, 0.0) for k in range(5)][-1]
    assert found is not None
    assert "changes by 2 m/s over 1000 ms" in found
    begun = envelope(max_error_s=0.5)
    assert [begun.check(8.0 + 0.25 * k, 0.0, 1.0, 0.0) for k in range(3)] == [None] * 3
    found = begun.check(8.75, 0.0, 1.0, 0.0)
    assert found is not None
    assert "for 0.75 s, limit 0.5 s" in found


def test_a_move_of_exactly_the_band_is_no_motion() -> None:
    begun = envelope(**WIDE, range_y=500.0, moving_min_y=-9.0, moving_max_y=9.0, max_speed=100.0)
    assert STILL_SHARE * 500.0 == 1.0
    assert begun.check(0.0, 0.0, 0.0, 4.0) is None
    assert begun.check(0.25, 1.0, 0.0, 4.0) is None
    assert begun.check(0.5, 0.0, 0.0, 4.0) is not None


@pytest.mark.parametrize("y", [-0.16, 0.16])
def test_control_may_begin_at_a_soft_end_stop(y: float) -> None:
    assert envelope().refusal(y, y) is None
