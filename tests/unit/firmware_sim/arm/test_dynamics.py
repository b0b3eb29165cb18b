"""The compiled dynamics against the reference solution, and their reproducibility."""

import ctypes
import math
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support.arm_files import arm_with
from support.arm_reference import Drive, solve, state_of

from firmware_sim.arm import native
from firmware_sim.arm.arm import Arm
from firmware_sim.arm.events import Leak, Payload, SupplyPressure
from firmware_sim.arm.parameters import AXES, ArmParameters

SAMPLE_S = 0.01
SAMPLE_NS = 10_000_000
POSITION = [2, 11, 20]
PRESSURE = [5, 6, 14, 15, 23, 24]

EVERY_TERM = {
    "axes.*.valve.overlap": 0.02,
    "axes.*.valve.critical_ratio": 0.42,
    "axes.*.cylinder.heat_w_k": 2.0,
    "axes.*.friction.per_moment_1_n_m": 0.05,
    "axes.horizontal.spring.centre_n": 2.0,
    "axes.rotation.spring.centre_n": -1.5,
    "supply.volume_m3": 3e-4,
    "supply.max_flow_kg_s": 2.9e-3,
    "body.tip_m": 0.1,
}


def commands_v(arm: ArmParameters, spools: tuple[float, float, float]) -> list[float]:
    """Return the voltages that command these spool positions, without play."""
    return [axis.valve.centre_v + 5.0 * spool for axis, spool in zip(arm.ordered, spools, strict=True)]


def positions_and_pressures(
    parameters: ArmParameters, drives: list[tuple[float, Drive]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the states of the arm and of the reference solution: (n, 28) each, every 10 ms."""
    arm = Arm(parameters, seed=1)
    start = state_of(arm)
    states = []
    for seconds, drive in drives:
        arm.apply(Payload(at_s=0.0, mass_kg=drive.payload_kg))
        arm.apply(SupplyPressure(at_s=0.0, gauge_kpa=drive.regulator_pa * 1e-3 - 100.0))
        axis, chamber, conductance = drive.leak
        arm.apply(
            Leak(at_s=0.0, axis=AXES[axis], chamber=chamber + 1, conductance_m3_s_pa=conductance)  # type: ignore[arg-type]
        )
        for _ in range(round(seconds / SAMPLE_S)):
            arm.advance(SAMPLE_NS, commands_v(parameters, drive.spools))
            states.append(state_of(arm))
    return np.array(states), solve(parameters, start, drives, SAMPLE_S)


MOVES = [
    (0.4, Drive((0.12, 0.1, 0.1))),
    (0.5, Drive((-0.1, -0.15, -0.12))),
    (0.3, Drive((0.02, 0.2, 0.15), regulator_pa=500e3)),
    (0.3, Drive((0.0, 0.0, 0.0), regulator_pa=500e3)),
]
INTO_THE_STOPS = [(0.8, Drive((0.8, -0.8, 0.8))), (0.4, Drive((-0.5, 0.5, -0.5)))]
DIRECT = {"axes.*.cylinder.tube_m": 0.0, "axes.*.valve.hysteresis_v": 0.0}


@pytest.mark.parametrize(
    ("changes", "drives", "tolerance_mm"),
    [({}, MOVES, 0.02), (EVERY_TERM, MOVES, 0.03), ({}, INTO_THE_STOPS, 0.05)],
    ids=["shipped arm", "every term", "end stops"],
)
def test_positions_agree_with_the_reference_solution(
    changes: dict[str, float], drives: list[tuple[float, Drive]], tolerance_mm: float
) -> None:
    arm, reference = positions_and_pressures(arm_with(DIRECT | changes), drives)
    assert np.ptp(reference[:, POSITION], axis=0).min() > 0.035
    assert np.abs(arm - reference)[:, POSITION].max() < 1e-3 * tolerance_mm
    assert np.abs(arm - reference)[:, PRESSURE].max() < 3e3


def test_a_payload_acts_as_in_the_reference_solution() -> None:
    parameters = arm_with(DIRECT)
    drives = [(1.0, Drive((0.12, 0.1, 0.1), payload_kg=3.0))]
    arm, reference = positions_and_pressures(parameters, drives)
    light = solve(parameters, state_of(Arm(parameters, seed=1)), [(1.0, Drive((0.12, 0.1, 0.1)))], SAMPLE_S)
    assert np.abs(arm - reference)[:, POSITION].max() < 0.03e-3
    assert (np.abs(light - reference)[:, POSITION].max(axis=0) > 2e-3).all()


@pytest.mark.parametrize("conductance", [1e-7, 1e-6])
@pytest.mark.parametrize(("axis", "chamber"), [(0, 1), (1, 0), (1, 1), (2, 0)])
def test_a_chamber_that_empties_within_a_step_agrees_with_the_reference_solution(
    axis: int, chamber: int, conductance: float
) -> None:
    """With the largest leak the horizontal's chambers have a time constant below half a step."""
    leak = (axis, chamber, conductance)
    drives = [(0.1, Drive((0.05, 0.05, 0.05), leak=leak)), (0.3, Drive((-0.5, -0.5, 0.5), leak=leak))]
    arm, reference = positions_and_pressures(arm_with(DIRECT), drives)
    leaking_pa = reference[:, 9 * axis + 5 + chamber]
    assert np.abs(leaking_pa[10:] - 100e3).max() < 15e3
    assert np.abs(arm - reference)[:, POSITION].max() < 0.2e-3
    assert np.abs(arm - reference)[:, PRESSURE].max() < 6e3


def test_the_error_decreases_with_the_step() -> None:
    errors = []
    for step_s in (1e-3, 5e-4, 2.5e-4, 1.25e-4):
        parameters = arm_with(DIRECT | {"step_s": step_s})
        arm, reference = positions_and_pressures(parameters, MOVES[:2])
        errors.append(np.abs(arm - reference)[:, POSITION].max())
    assert all(fine < 0.6 * coarse for coarse, fine in pairwise(errors))
    assert errors[-1] < 0.01e-3


def test_tube_and_play_delay_the_spool_and_reduce_its_travel() -> None:
    """A command reaches the spool after the tube's delay, reduced by the play."""
    parameters = arm_with({})
    arm = Arm(parameters, seed=1)
    valve = parameters.axes.vertical.valve
    for volts, engaged_v in ((6.0, 1.0 - valve.hysteresis_v), (5.9, 0.9 + valve.hysteresis_v)):
        before = arm.state.axis[0].spool
        arm.advance(5_500_000, (valve.centre_v + volts - 5.0, 5.0, 5.0))
        assert arm.state.axis[0].spool == pytest.approx(before, abs=1e-6)
        arm.advance(194_500_000, (valve.centre_v + volts - 5.0, 5.0, 5.0))
        assert arm.state.axis[0].spool == pytest.approx(engaged_v / 5.0, abs=1e-9)
    arm.advance(200_000_000, (valve.centre_v + 0.9 + valve.hysteresis_v, 5.0, 5.0))
    assert arm.state.axis[0].spool == pytest.approx((0.9 + valve.hysteresis_v) / 5.0, abs=1e-9)


def test_dividing_a_period_into_pieces_changes_positions_little() -> None:
    whole, cut = Arm(arm_with({}), seed=1), Arm(arm_with({}), seed=1)
    pieces_ns = (1, 700_000, 4_300_123, 6_199_876)
    assert sum(pieces_ns) == 11_200_000
    for k in range(100):
        volts = (5.4, 4.7, 5.3) if k // 20 % 2 else (4.7, 5.2, 4.8)
        whole.advance(11_200_000, volts)
        for piece_ns in pieces_ns:
            cut.advance(piece_ns, volts)
    assert cut.time_ns == whole.time_ns
    for one, other in zip(whole.view().axes, cut.view().axes, strict=True):
        assert one.position == pytest.approx(other.position, abs=0.03e-3)


def run_bytes(library: ctypes.CDLL | None = None, *, seed: int = 1) -> bytes:
    """Return readings and final state of a run with moving valves and an event, as bytes."""
    arm = Arm(arm_with({}), seed=seed, events=[Payload(at_s=0.5, mass_kg=3.0)])
    if library is not None:
        library.arm_advance.argtypes = arm._dynamics.advance.argtypes
        arm._dynamics.advance = library.arm_advance
    readings = []
    for k in range(200):
        arm.advance(11_200_000, (5.0 + math.sin(0.1 * k), 5.0 - math.sin(0.07 * k), 5.0 + 0.01 * (k % 50)))
        readings += arm.potentiometer_v()
    return np.array(readings).tobytes() + bytes(arm.state)


def test_the_same_run_gives_the_same_bytes() -> None:
    assert run_bytes() == run_bytes()
    assert run_bytes() != run_bytes(seed=2)


def test_compiler_optimisation_changes_no_byte(tmp_path: Path) -> None:
    source = Path(native.__file__).with_name("dynamics.c")
    library = tmp_path / "plain.so"
    flags = ("-std=c11", "-O0", "-ffp-contract=off", "-shared", "-fPIC")
    subprocess.run(["gcc", *flags, "-o", library, source, "-lm"], check=True)
    assert run_bytes(ctypes.CDLL(str(library))) == run_bytes()
