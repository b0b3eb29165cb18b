"""The envelope in the rig file: its defaults, what is disabled, and limits that are refused."""

from __future__ import annotations

import math

import pytest
from support.shipped_rig import RIG_TEXT, SHIPPED_RIG

from hil.core.envelope_settings import AxisRange, EnvelopeSettings, check_settings
from hil.core.errors import DocumentError
from hil.core.rig import Rig, read_rig

WHERE = "rig.toml: axes.vertical.envelope"


def rig_with(table: str, axis: str = "vertical") -> Rig:
    return read_rig(f"{RIG_TEXT}\n[axes.{axis}.envelope]\n{table}\n", "rig.toml")


def problem(table: str) -> str:
    with pytest.raises(DocumentError) as caught:
        rig_with(table)
    return str(caught.value)


def test_a_rig_file_without_the_table_has_the_defaults() -> None:
    limits = SHIPPED_RIG.axes["vertical"].limits
    assert limits.min_y == pytest.approx(-0.165 + 0.033 * 0.1)  # potentiometer.min_v
    assert limits.max_y == pytest.approx(-0.165 + 0.033 * 9.9)  # potentiometer.max_v
    assert limits[2:] == pytest.approx((1.8, 0.075, 3.0, 0.5, 3.0, 0.3, -0.135, 0.135))
    assert SHIPPED_RIG.axes["rotation"].limits[2:4] == pytest.approx((18.0, 0.75))


def test_a_reversed_potentiometer_has_the_same_end_stops() -> None:
    text = RIG_TEXT.replace("y_at_0v = -0.165                # 330 mm over 10 V\ny_at_10v = 0.165",
                            "y_at_0v = 0.165\ny_at_10v = -0.165", 1)  # fmt: skip
    assert text != RIG_TEXT
    limits = read_rig(text, "rig.toml").axes["vertical"].limits
    assert limits[:2] == pytest.approx(SHIPPED_RIG.axes["vertical"].limits[:2])


def test_given_limits_replace_the_defaults() -> None:
    table = (
        "min_y = -0.155\nmax_y = 0.16\nmax_speed = 1.2\nmax_error = 0.03\nmax_error_s = 1.0\n"
        "max_still_s = 2.0\nfar_open_v = 4.0"
    )
    assert rig_with(table).axes["vertical"].limits[:7] == (-0.155, 0.16, 1.2, 0.03, 1.0, 2.0, 4.0)


@pytest.mark.parametrize("key", ["min_y", "max_y", "max_speed", "max_error", "max_still_s"])
def test_a_disabled_check_has_no_limit_and_the_others_keep_theirs(key: str) -> None:
    limits = rig_with(f'disabled = ["{key}"]').axes["vertical"].limits
    assert getattr(limits, key) == (-math.inf if key == "min_y" else math.inf)
    assert limits._replace(**{key: 0.0}) == SHIPPED_RIG.axes["vertical"].limits._replace(**{key: 0.0})


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("min_y = -0.149", ".min_y: the soft end stop -0.149 m is not between -0.1617 m, "),
        ("min_y = -0.162", ".min_y: the soft end stop -0.162 m is not between -0.1617 m, "),
        ("max_y = 0.149", ".max_y: the soft end stop 0.149 m is not between the largest setpoint, max_y "),
        ("max_y = 0.162", ".max_y: the soft end stop 0.162 m is not between the largest setpoint, max_y "),
        ("max_error = 0.324", ".max_error: 0.324 m can never be exceeded, because the potentiometer cannot "),
        ("max_speed = 7.3", ".max_speed: 7.3 m/s can never be exceeded, because the potentiometer cannot "),
        ("far_open_v = 5.0", ".far_open_v: 5 V is more than the 4.9996 V that the valve can be opened to "),
        ('max_error = 0.1\ndisabled = ["max_error"]', ".disabled: max_error is disabled and given, as 0.1; "),
        ('disabled = ["max_eror"]', ".disabled[0] is 'max_eror', but must be 'max_error' or 'max_speed' or "),
        ('max_error = "off"', ".max_error is 'off', but must be a number"),
        ("max_error = 0.0", ".max_error is 0.0, but must be more than 0.0"),
        ("max_error_s = 61.0", ".max_error_s is 61.0, but must be at most 60.0"),
        ("largest_error = 0.1", ": unknown key largest_error"),
    ],
)  # fmt: skip
def test_a_limit_that_contradicts_the_rig_is_refused(table: str, said: str) -> None:
    assert problem(table).startswith(WHERE + said)


@pytest.mark.parametrize("table", ["min_y = -0.15\nmax_y = 0.15", "max_error = 0.323", "max_speed = 7.2"])
def test_a_limit_at_its_bound_is_accepted(table: str) -> None:
    rig_with(table)


@pytest.mark.parametrize(("rate", "is_accepted"), [("10000.0", True), ("10000.1", False), ("1e308", False)])
def test_a_valve_may_cross_its_range_within_1_ms_but_no_faster(rate: str, is_accepted: bool) -> None:
    text = RIG_TEXT.replace("max_rate_v_s = 400.0", f"max_rate_v_s = {rate}", 1)
    if is_accepted:
        assert read_rig(text, "rig.toml").axes["vertical"].valve.max_rate_v_s == 10_000.0
        return
    with pytest.raises(DocumentError, match=r"max_rate_v_s is .*, but must be at most 10000\.0"):
        read_rig(text, "rig.toml")


SETTINGS_RANGE = AxisRange(min_y=-1.0, max_y=2.0, sensor_min_y=-3.0, sensor_max_y=5.0, valve_v=4.0)


@pytest.mark.parametrize(
    ("key", "accepted", "refused"),
    [
        ("min_y", -3.0, math.nextafter(-3.0, -9.0)),
        ("min_y", -1.0, math.nextafter(-1.0, 9.0)),
        ("max_y", 2.0, math.nextafter(2.0, -9.0)),
        ("max_y", 5.0, math.nextafter(5.0, 9.0)),
        ("max_error", 8.0, math.nextafter(8.0, 9.0)),
        ("max_speed", 4.0, math.nextafter(4.0, 9.0)),  # 8 m in 4 periods of 0.5 s
        ("far_open_v", 4.0, math.nextafter(4.0, 9.0)),
    ],
)
def test_the_bounds_of_a_limit_are_exact(key: str, accepted: float, refused: float) -> None:
    check_settings(EnvelopeSettings(**{key: accepted}), SETTINGS_RANGE, 0.5, "m", "table")
    with pytest.raises(DocumentError, match=rf"^table\.{key}: "):
        check_settings(EnvelopeSettings(**{key: refused}), SETTINGS_RANGE, 0.5, "m", "table")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("max_error_s = 0.0", ".max_error_s is 0.0, but must be more than 0.0"),
        ("max_still_s = 60.5", ".max_still_s is 60.5, but must be at most 60.0"),
        ("max_speed = 2e6", ".max_speed is 2000000.0, but must be at most 1000000.0"),
        ("far_open_v = -0.5", ".far_open_v is -0.5, but must be more than 0.0"),
    ],
)
def test_a_limit_outside_any_range_is_refused(table: str, said: str) -> None:
    assert problem(table).startswith(WHERE + said)


def test_settings_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        EnvelopeSettings().max_error = 1.0  # type: ignore[misc]
