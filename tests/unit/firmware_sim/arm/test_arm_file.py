"""The arm file: physically impossible values are rejected with their key, value and limit."""

import msgspec
import pytest
from support.arm_files import SHIPPED_TEXT, arm_with, text_with
from support.shipped_rig import SHIPPED_RIG

from firmware_sim.arm.arm_file import read_arm, shipped_arm
from firmware_sim.arm.parameters import ArmParameters
from hil.core.errors import DocumentError

VERTICAL = "axes.vertical"


def rejection(dotted: str, value: str) -> str:
    with pytest.raises(DocumentError) as caught:
        read_arm(text_with(dotted, value), "mine.toml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("dotted", "value", "limit"),
    [
        ("step_s", "0.01", "at most 0.001"),
        ("body.vertical_kg", "0.0", "at least 0.01"),
        ("body.pulley_m", "-0.09", "at least 0.001"),
        ("supply.gauge_kpa", "-1.0", "at least 0.0"),
        ("supply.gauge_kpa", "5500.0", "at most 1000.0"),
        ("supply.volume_m3", "-2e-3", "at least 1e-05"),
        ("supply.temperature_c", "-300.0", "at least -20.0"),
        (f"{VERTICAL}.cylinder.bore_m", "-0.02", "at least 0.0001"),
        (f"{VERTICAL}.cylinder.dead_volume_m3", "-1e-6", "at least 1e-07"),
        (f"{VERTICAL}.cylinder.tube_m", "-1.0", "at least 0.0"),
        (f"{VERTICAL}.cylinder.heat_w_k", "-0.1", "at least 0.0"),
        (f"{VERTICAL}.valve.critical_ratio", "1.2", "at most 0.98"),
        (f"{VERTICAL}.valve.critical_ratio", "-0.1", "at least 0.0"),
        (f"{VERTICAL}.valve.conductance_m3_s_pa", "-1e-9", "at least 0.0"),
        (f"{VERTICAL}.valve.clearance", "-0.1", "at least 0.0"),
        (f"{VERTICAL}.valve.spool_damping", "0.0", "at least 0.05"),
        (f"{VERTICAL}.valve.hysteresis_v", "-0.005", "at least 0.0"),
        (f"{VERTICAL}.friction.coulomb_n", "0.0", "at least 1e-06"),
        (f"{VERTICAL}.friction.viscous_n_s_m", "-1.0", "at least 0.0"),
        (f"{VERTICAL}.spring.rate_n_m", "-1.0", "at least 0.0"),
        (f"{VERTICAL}.stop.damping_s_m", "-1.0", "at least 0.0"),
        (f"{VERTICAL}.potentiometer.noise_v", "-1.0", "at least 0.0"),
    ],
)
def test_a_value_out_of_range_is_rejected(dotted: str, value: str, limit: str) -> None:
    message = rejection(dotted, value)
    assert message.startswith(f"mine.toml: {dotted} is {float(value)}, but must be ")
    assert message.endswith(limit)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", '"wide"'])
def test_a_value_that_is_not_a_number_is_rejected_by_its_key(value: str) -> None:
    assert f"mine.toml: {VERTICAL}.cylinder.bore_m" in rejection(f"{VERTICAL}.cylinder.bore_m", value)


def test_static_friction_below_coulomb_friction_is_rejected() -> None:
    assert rejection(f"{VERTICAL}.friction.static_n", "1.0") == (
        "mine.toml: axes.vertical.friction.static_n: 1.0 N is less than coulomb_n, 1.2 N"
    )


def test_friction_that_would_generate_energy_is_rejected() -> None:
    message = rejection(f"{VERTICAL}.friction.bristle_n_s_m", "800.0")
    assert "axes.vertical.friction.bristle_n_s_m: 800.0 N s/m exceeds 624 N s/m" in message
    assert "would generate energy" in message


def test_potentiometer_must_cover_the_stroke() -> None:
    message = rejection("axes.rotation.potentiometer.y_at_10v", "1.5")
    assert (
        "axes.rotation.potentiometer: y_at_0v and y_at_10v (-1.65 to 1.5) do not cover the stroke" in message
    )
    assert "-1.6 to 1.6" in message
    assert "stroke_m" in rejection("axes.horizontal.cylinder.stroke_m", "0.34")


def test_a_stop_that_lets_the_piston_reach_the_cover_is_rejected() -> None:
    text = text_with(f"{VERTICAL}.cylinder.dead_volume_m3", "1e-7").replace("2e5", "1e5")
    with pytest.raises(
        DocumentError, match=r"stop\.stiffness_n_m: 100000\.0 N/m is less than 1\.084e\+06 N/m"
    ):
        read_arm(text, "mine.toml")


def test_a_stop_too_stiff_for_the_step_is_rejected() -> None:
    message = rejection("axes.horizontal.stop.stiffness_n_m", "5e7")
    assert "axes.horizontal.stop.stiffness_n_m: 50000000.0 N/m exceeds 1.913e+07 N/m" in message


def test_a_reach_that_would_cross_the_axis_of_rotation_is_rejected() -> None:
    assert "mine.toml: body.reach_m: 0.1 m is less than 0.15 m" in rejection("body.reach_m", "0.1")


def test_a_load_sensitivity_that_would_make_friction_negative_is_rejected() -> None:
    message = rejection(f"{VERTICAL}.friction.per_moment_1_n_m", "0.5")
    assert "axes.vertical.friction.per_moment_1_n_m: 0.5 exceeds 0.4532" in message


def test_unknown_and_missing_keys_are_rejected() -> None:
    with pytest.raises(DocumentError, match=r"mine\.toml: .*elbow_kg"):
        read_arm(SHIPPED_TEXT.replace("[body]", "[body]\nelbow_kg = 1.0"), "mine.toml")
    with pytest.raises(DocumentError, match=r"mine\.toml: body.*tip_m"):
        read_arm(
            "\n".join(line for line in SHIPPED_TEXT.splitlines() if not line.startswith("tip_m")), "mine.toml"
        )


def test_every_number_of_the_shipped_file_has_its_source() -> None:
    numbers = [line for line in SHIPPED_TEXT.splitlines() if "=" in line and not line.startswith("#")]
    assert len(numbers) > 80
    for line in numbers[1:]:
        assert any(origin in line for origin in ("paper", "catalogue", "calibrated", "assumed")), line


def test_shipped_arm_agrees_with_the_shipped_rig() -> None:
    arm = shipped_arm()
    assert list(SHIPPED_RIG.axes) == ["vertical", "horizontal", "rotation"]
    for channel, (axis, part, travel) in enumerate(
        zip(SHIPPED_RIG.axes.values(), arm.ordered, arm.travel, strict=True), start=1
    ):
        assert axis.potentiometer.channel == axis.valve.channel == channel
        assert axis.potentiometer.y_at_0v == part.potentiometer.y_at_0v
        assert axis.potentiometer.y_at_10v == part.potentiometer.y_at_10v
        assert max(-axis.min_y, axis.max_y) <= 0.5 * part.cylinder.stroke_m * travel


def test_documents_are_frozen() -> None:
    arm: ArmParameters = arm_with({})
    with pytest.raises(AttributeError):
        arm.body.tip_m = 1.0  # type: ignore[misc]
    assert msgspec.structs.replace(arm, step_s=1e-4).step_s == 1e-4
