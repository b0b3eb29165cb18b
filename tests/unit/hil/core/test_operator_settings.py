"""Limits of an operator's requests: defaults, what the rig file gives, and what contradicts it."""

from __future__ import annotations

import math

import pytest
from support.gateway_bench import rig_text

from hil.core.errors import DocumentError
from hil.core.operator_settings import OperatorLimits
from hil.core.rig import read_rig


def limits(operator: str = "", envelope: str = "", axis: str = "vertical") -> OperatorLimits:
    """The limits of an axis whose table has these keys."""
    text = rig_text(axes=(axis,), envelope=envelope) + f"[axes.{axis}.operator]\n{operator}\n"
    return read_rig(text, "rig.toml").axes[axis].operator_limits


def test_defaults_come_from_the_envelope_and_the_valve() -> None:
    assert limits() == pytest.approx(OperatorLimits(0.45, 1.8, 1.0, 0.5))
    assert limits(axis="rotation") == OperatorLimits(4.5, 18.0, 1.0, 0.5)
    assert limits(envelope="max_speed = 0.4") == pytest.approx(OperatorLimits(0.1, 0.4, 1.0, 0.5))


def test_a_disabled_speed_check_does_not_make_setpoints_infinitely_fast() -> None:
    assert limits(envelope='disabled = ["max_speed"]').max_speed == pytest.approx(0.45)


def test_the_default_acceleration_follows_the_given_speed() -> None:
    assert limits("setpoint_max_speed = 0.1") == OperatorLimits(0.1, 0.4, 1.0, 0.5)


def test_every_key_can_be_given() -> None:
    given = "setpoint_max_speed = 0.1\nsetpoint_max_acceleration = 9.0\njog_max_v = 2.5\njog_max_s = 3.0"
    assert limits(given) == OperatorLimits(0.1, 9.0, 2.5, 3.0)


def test_a_setpoint_must_not_be_faster_than_the_envelope() -> None:
    assert limits("setpoint_max_speed = 1.8").max_speed == 1.8
    with pytest.raises(
        DocumentError,
        match=r"axes\.vertical\.operator\.setpoint_max_speed: 1\.81 m/s is more than .* max_speed, 1\.8 m/s",
    ):
        limits("setpoint_max_speed = 1.81")


def test_a_jog_must_not_open_the_valve_further_than_it_can() -> None:
    with pytest.raises(DocumentError, match=r"operator\.jog_max_v: 5\.1 V is more than the 4\.9996 V that"):
        limits("jog_max_v = 5.1")


@pytest.mark.parametrize("key", ["setpoint_max_speed", "setpoint_max_acceleration", "jog_max_v", "jog_max_s"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan, 1e7])
def test_limits_are_positive_and_finite(key: str, value: float) -> None:
    with pytest.raises(DocumentError, match=rf"operator\.{key}"):
        limits(f"{key} = {value}")


def test_the_default_jog_fits_a_small_valve() -> None:
    text = rig_text({"axes.vertical.valve.min_v": "4.5"}, axes=("vertical",))
    assert read_rig(text, "rig.toml").axes["vertical"].operator_limits.jog_max_v == 0.5
