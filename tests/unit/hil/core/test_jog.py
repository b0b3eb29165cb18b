"""The motion of one axis in a jog: its end to the nanosecond, and the travel fence to the last digit."""

from __future__ import annotations

import math

import pytest
from support.shipped_rig import SHIPPED_RIG

from hil.core.jog import OUTWARD_SHARE, Jog, limits_refusal
from hil.core.requests import JogRequest

AXIS = SHIPPED_RIG.axes["vertical"]
LOW, HIGH = AXIS.fence_limits
OUTWARD = OUTWARD_SHARE * (AXIS.max_y - AXIS.min_y)
REQUEST = JogRequest("vertical", 0.5, 0.2)
BEFORE, AFTER = -math.inf, math.inf


def begun(y: float) -> Jog:
    jog = Jog(AXIS, REQUEST, 0)
    jog.begin(y)
    return jog


def test_the_time_of_a_jog_is_exact_to_the_nanosecond() -> None:
    jog = Jog(AXIS, REQUEST._replace(duration_s=60.0), 7)
    assert (jog.axis, jog.offset_v, jog.end_ns) == ("vertical", 0.5, 60_000_000_007)
    jog.extend(REQUEST._replace(offset_v=-0.25, duration_s=10.0), 1_000)
    assert (jog.offset_v, jog.end_ns) == (-0.25, 10_000_001_000)


@pytest.mark.parametrize("y", [LOW, 0.0, HIGH])
def test_an_axis_that_begins_within_the_fence_may_reach_it(y: float) -> None:
    jog = begun(y)
    assert jog.check(LOW) is jog.check(HIGH) is None
    assert jog.check(math.nextafter(LOW, BEFORE)) is not None
    assert jog.check(math.nextafter(HIGH, AFTER)) is not None


def test_the_fence_holds_before_the_first_sample_too() -> None:
    jog = Jog(AXIS, REQUEST, 0)
    assert jog.check(HIGH) is None
    assert jog.check(math.nextafter(HIGH, AFTER)) is not None


def test_an_axis_above_the_fence_may_move_out_by_noise_only() -> None:
    y = HIGH + 0.01
    jog = begun(y)
    assert jog.check(y + OUTWARD) is jog.check(LOW) is None
    assert jog.check(math.nextafter(y + OUTWARD, AFTER)) is not None
    assert jog.check(math.nextafter(LOW, BEFORE)) is not None
    assert pytest.approx(0.0006) == OUTWARD


def test_an_axis_below_the_fence_may_move_out_by_noise_only() -> None:
    y = LOW - 0.01
    jog = begun(y)
    assert jog.check(y - OUTWARD) is jog.check(HIGH) is None
    assert jog.check(math.nextafter(y - OUTWARD, BEFORE)) is not None
    assert jog.check(math.nextafter(HIGH, AFTER)) is not None


def test_the_end_at_the_fence_names_position_limits_and_keys() -> None:
    end = begun(0.0).check(0.1234)
    assert end is not None
    for part in ("0.1234 m", "-0.12 to 0.12 m", "rig: axes.vertical.fence_min_y, fence_max_y"):
        assert part in end.reason


@pytest.mark.parametrize(
    ("offset_v", "duration_s", "key"),
    [
        (1.0, 0.5, None),
        (-1.0, 1e-9, None),
        (math.nextafter(1.0, AFTER), 0.5, "jog_max_v"),
        (math.nextafter(-1.0, BEFORE), 0.5, "jog_max_v"),
        (1.0, math.nextafter(0.5, AFTER), "jog_max_s"),
        (1.0, 0.0, "jog_max_s"),
        (1.0, -0.1, "jog_max_s"),
    ],
)
def test_a_jog_at_its_limits_is_allowed_and_beyond_them_refused(
    offset_v: float, duration_s: float, key: str | None
) -> None:
    refusal = limits_refusal(JogRequest("vertical", offset_v, duration_s), AXIS)
    assert (refusal is None) is (key is None)
    assert key is None or f"rig: axes.vertical.operator.{key}" in (refusal or "")
