"""The arm as a plant: its start, its readings, its stops, and its errors."""

import math
import statistics
import subprocess
import sys
from pathlib import Path

import pytest
from support.arm_files import arm_with
from support.constants import CENTRED, PERIOD_NS

from firmware_sim.arm.arm import _SETTLED, Arm
from firmware_sim.arm.arm_file import shipped_arm
from firmware_sim.plants.plant import Plant
from hil.core.errors import SimulationError


def test_the_arm_is_a_plant_that_starts_at_rest() -> None:
    arm: Plant = Arm(shipped_arm(), seed=1)
    assert isinstance(arm, Arm)
    before = arm.view()
    assert before.time_ns == 0
    arm.advance(1_000_000_000, CENTRED)
    for one, other in zip(before.axes, arm.view().axes, strict=True):
        assert one.position == pytest.approx(other.position, abs=1e-3)
        assert abs(other.velocity) < 1e-3


def test_an_arm_that_takes_over_the_rest_of_the_one_before_is_equal_to_it_to_the_bit() -> None:
    _SETTLED.clear()
    first, second = (Arm(shipped_arm(), seed=1) for _ in range(2))
    assert len(_SETTLED) == 1
    assert first.view() == second.view()
    for number in range(100):
        valve_v = (5.0 + 2.0 * math.sin(number), 4.0, 6.0)
        for arm in (first, second):
            arm.advance(PERIOD_NS, valve_v)
        assert first.potentiometer_v() == second.potentiometer_v()
    assert first.view() == second.view()


def test_an_arm_with_other_parameters_rests_by_itself() -> None:
    before = Arm(shipped_arm(), seed=1).view()
    assert Arm(arm_with({"supply.gauge_kpa": 300.0}), seed=1).view() != before
    assert Arm(shipped_arm(), seed=1).view() == before


def test_positive_offsets_increase_every_potentiometer_voltage() -> None:
    arm = Arm(shipped_arm(), seed=1)
    before = list(arm.potentiometer_v())
    arm.advance(300_000_000, (5.5, 5.5, 5.5))
    after = arm.potentiometer_v()
    assert all(late > early + 0.3 for early, late in zip(before, after, strict=True))


def test_full_voltage_moves_every_axis_to_its_stop_and_not_through_it() -> None:
    for volts, side in ((10.0, 1.0), (0.0, -1.0)):
        arm = Arm(shipped_arm(), seed=1)
        arm.advance(3_000_000_000, (volts,) * 3)
        for axis, part, travel in zip(
            arm.view().axes, arm.parameters.ordered, arm.parameters.travel, strict=True
        ):
            end = 0.5 * part.cylinder.stroke_m * travel
            assert end < side * axis.position < end + 2e-3 * travel
            assert abs(axis.velocity) < 1e-3
        assert all(0.1 < reading < 9.9 for reading in arm.potentiometer_v())


def test_a_spool_with_little_damping_stays_within_its_travel() -> None:
    arm = Arm(arm_with({"axes.*.valve.spool_damping": 0.05}), seed=1)
    for volts in (0.0, 10.0) * 3:
        for _ in range(20):
            arm.advance(1_000_000, (volts,) * 3)
            assert max(abs(axis.spool) for axis in arm.view().axes) <= 1.0


@pytest.mark.parametrize("volume_m3", [1e-5, 2e-3])
def test_a_stiff_regulator_holds_its_pressure_under_any_load(volume_m3: float) -> None:
    stiff = {"supply.volume_m3": volume_m3, "supply.droop_kpa_s_kg": 1.0, "supply.max_flow_kg_s": 10.0}
    arm = Arm(arm_with(stiff | {"supply.max_relief_kg_s": 10.0}), seed=1)
    for volts in ((10.0, 10.0, 10.0), (0.0, 0.0, 0.0), (5.0, 5.0, 5.0)):
        for _ in range(20):
            arm.advance(10_000_000, volts)
            assert arm.view().supply_pa == pytest.approx(550e3, abs=100.0)


def test_readings_have_the_noise_and_the_scale_of_the_arm_file() -> None:
    noise_v = 0.004
    noisy = Arm(
        arm_with({"axes.*.potentiometer.noise_v": noise_v, "axes.*.potentiometer.nonlinearity": 0.0}), seed=1
    )
    readings = []
    for _ in range(2000):
        noisy.advance(1_000, CENTRED)
        readings.append(noisy.potentiometer_v()[1])
    assert statistics.stdev(readings) == pytest.approx(noise_v, rel=0.06)
    y = noisy.view().axes[1].position
    assert statistics.mean(readings) == pytest.approx(
        10.0 * (y + 0.165) / 0.33, abs=3.5 * noise_v / math.sqrt(2000)
    )


def test_a_reading_is_drawn_once_an_instant() -> None:
    arm = Arm(shipped_arm(), seed=1)
    first = list(arm.potentiometer_v())
    assert list(arm.potentiometer_v()) == first
    arm.advance(1, CENTRED)
    assert list(arm.potentiometer_v()) != first


def test_nonlinearity_is_the_largest_deviation_as_a_fraction_of_the_span() -> None:
    straight = arm_with({"axes.*.potentiometer.noise_v": 0.0, "axes.*.potentiometer.nonlinearity": 0.0})
    bent = arm_with({"axes.*.potentiometer.noise_v": 0.0, "axes.*.potentiometer.nonlinearity": 0.001})
    worst = 0.0
    for position_m in (-0.15, -0.1, -0.095263, -0.05, 0.0, 0.05, 0.095263, 0.15):
        readings = []
        for parameters in (straight, bent):
            arm = Arm(parameters, seed=1)
            arm.state.axis[0].position_m = position_m
            readings.append(arm.potentiometer_v()[0])
        assert readings[0] == pytest.approx(10.0 * (position_m + 0.165) / 0.33)
        departure = readings[1] - readings[0]
        assert departure * position_m <= 0.0
        worst = max(worst, abs(departure))
    assert worst == pytest.approx(0.001 * 10.0, rel=1e-6)


@pytest.mark.parametrize("volts", [math.nan, math.inf, -math.inf])
def test_a_voltage_that_is_not_finite_is_rejected(volts: float) -> None:
    with pytest.raises(SimulationError, match=r"valve voltage (nan|-?inf) V is not a finite number"):
        Arm(shipped_arm(), seed=1).advance(PERIOD_NS, (5.0, volts, 5.0))


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        ("velocity_m_s", r"horizontal at .* m of its cylinder, .*e\+\d\d m/s"),
        ("position_m", "horizontal at 1e.06 m"),
        ("spool", "horizontal"),
    ],
)
def test_an_impossible_state_raises_on_every_advance(spoil: str, complaint: str) -> None:
    arm = Arm(shipped_arm(), seed=1)
    setattr(arm.state.axis[1], spoil, 1e6)
    for _ in range(2):
        with pytest.raises(
            SimulationError,
            match=rf"diverged before \d.*s of its time: .*{complaint}.*step_s.*of axes\.horizontal",
        ):
            arm.advance(PERIOD_NS, CENTRED)


@pytest.mark.parametrize("field", ["position_m", "velocity_m_s", "bristle_m", "spool", "spool_rate_1_s"])
def test_a_nan_in_the_state_raises(field: str) -> None:
    arm = Arm(shipped_arm(), seed=1)
    setattr(arm.state.axis[2], field, math.nan)
    with pytest.raises(SimulationError, match="rotation"):
        arm.advance(PERIOD_NS, CENTRED)


def test_an_impossible_supply_pressure_raises() -> None:
    arm = Arm(shipped_arm(), seed=1)
    arm.state.supply_pa = -1.0
    with pytest.raises(SimulationError, match=r"supply pressure -1 Pa"):
        arm.advance(PERIOD_NS, CENTRED)


def test_the_arm_starts_without_the_heavy_libraries() -> None:
    program = (
        "import sys\n"
        "from firmware_sim.arm.arm import Arm\n"
        "from firmware_sim.arm.arm_file import shipped_arm\n"
        "Arm(shipped_arm(), seed=1)\n"
        "print(*{name.split('.')[0] for name in sys.modules})"
    )
    shown = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True, cwd=Path(__file__).parent
    )
    loaded = set(shown.stdout.split())
    assert "msgspec" in loaded
    assert not loaded & {"numpy", "scipy", "control", "matplotlib", "rich", "can", "mcap"}
