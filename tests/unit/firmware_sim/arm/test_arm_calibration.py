"""The calibrated arm does the paper's experiments: identification as eq. (15), steps as in Figs 13 to 15."""

import math

import pytest
from support.arm_bench import (
    PPID,
    Bench,
    Step,
    close_loops,
    excite,
    identify,
    measure_step,
    stairs,
)

from firmware_sim.arm.conditions import Payload, SupplyPressure
from firmware_sim.arm.parameters import shipped_arm
from hil.controller_file import Pid

VERTICAL, HORIZONTAL, ROTATION = range(3)
HORIZONTAL_PI = Pid(kp=10.5, ki=4.7)
ROTATION_PI = Pid(kp=0.95, ki=0.45)
LAWS = (PPID, HORIZONTAL_PI, ROTATION_PI)


def at_rest(_time_s: float) -> float:
    return 0.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_vertical_axis_identifies_as_equation_15(seed: int) -> None:
    model = identify(*excite(shipped_arm(), VERTICAL, 0.4, seed=seed), stops=0.14)
    assert model.velocity_gain == pytest.approx(0.47947 * 90.76 / 167.9, rel=0.05)
    assert model.slow_rad_s == pytest.approx(0.4231, rel=0.15)
    assert model.mode_rad_s == pytest.approx(math.sqrt(167.9), rel=0.10)
    assert model.damping == pytest.approx(16.97 / 2 / math.sqrt(167.9), rel=0.15)
    assert model.fit_percent > 98.0


@pytest.mark.parametrize(("axis", "velocity_gain", "stops"), [(HORIZONTAL, 0.25, 0.14), (ROTATION, 2.8, 1.5)])
def test_other_axes_identify_as_a_like_model(axis: int, velocity_gain: float, stops: float) -> None:
    model = identify(*excite(shipped_arm(), axis, 0.4, seed=1), stops=stops)
    assert model.velocity_gain == pytest.approx(velocity_gain, rel=0.1)
    assert 0.3 < model.slow_rad_s < 0.6
    assert 8.0 < model.mode_rad_s < 18.0
    assert 0.4 < model.damping < 1.0
    assert model.fit_percent > 97.0


@pytest.mark.parametrize("seed", [1, 2])
def test_vertical_step_of_100_mm_is_that_of_fig_13(seed: int) -> None:
    setpoints = (stairs((0.0, 0.0), (1.0, 0.1), (4.0, 0.0)), at_rest, at_rest)
    track = close_loops(Bench(shipped_arm(), seed=seed), LAWS, setpoints, 7.0)
    for start_s, end_s in ((1.0, 4.0), (4.0, 7.0)):
        step = measure_step(track, VERTICAL, start_s, end_s)
        assert 0.7 < step.settling_s < 1.3
        assert step.overshoot_percent < 1.0
        assert abs(step.error) < 0.7e-3


def test_ladder_with_payload_low_supply_and_the_other_axes_moving_is_that_of_fig_14() -> None:
    changes = (Payload(at_s=0.5, mass_kg=3.0), SupplyPressure(at_s=0.5, gauge_kpa=400.0))
    levels = (-0.04, 0.0, 0.04, 0.08)
    setpoints = (
        stairs((0.0, 0.0), (1.0, -0.08), *((6.0 + 3.0 * k, level) for k, level in enumerate(levels))),
        stairs(*((2.5 * k, 0.05 * (-1) ** k) for k in range(8))),
        stairs(*((3.5 * k, 0.4 * (-1) ** k) for k in range(6))),
    )
    bench = Bench(shipped_arm(), changes=changes)
    track = close_loops(bench, LAWS, setpoints, 18.0)
    assert bench.arm.view().supply_pa < 500e3
    steps = [measure_step(track, VERTICAL, 6.0 + 3.0 * k, 9.0 + 3.0 * k) for k in range(len(levels))]
    assert sorted(step.settling_s for step in steps)[2] < 1.2
    for step in steps:
        assert step.settling_s < 1.7  # the first reverses, against friction
        assert step.overshoot_percent < 2.0
        assert abs(step.error) < 1e-3


@pytest.mark.parametrize(("axis", "size"), [(HORIZONTAL, 0.1), (ROTATION, 1.0)])
def test_other_axes_step_cleanly_as_in_fig_15(axis: int, size: float) -> None:
    setpoints = [at_rest, at_rest, at_rest]
    setpoints[axis] = stairs((0.0, 0.0), (2.0, size), (6.0, 0.0))
    track = close_loops(Bench(shipped_arm()), LAWS, setpoints, 10.0)
    steps: list[Step] = [measure_step(track, axis, *span) for span in ((2.0, 6.0), (6.0, 10.0))]
    for step in steps:
        assert step.settling_s < 2.0
        assert step.overshoot_percent < 2.0
        assert abs(step.error) < 0.015 * size
