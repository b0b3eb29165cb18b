"""The compiled dynamics against a second opinion: scipy on the equations in plain Python, and eq. (2)."""

import ctypes
import math
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support.arm_files import FRICTIONLESS, arm_with
from support.arm_reference import Drive, solve, state_of

from firmware_sim.arm import native
from firmware_sim.arm.arm import Arm
from firmware_sim.arm.conditions import Leak, Payload, SupplyPressure
from firmware_sim.arm.linearisation import linearise
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
    """Voltages that send the spools there when each last moved the other way, without play."""
    return [axis.valve.centre_v + 5.0 * spool for axis, spool in zip(arm.ordered, spools, strict=True)]


def positions_and_pressures(
    parameters: ArmParameters, drives: list[tuple[float, Drive]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What the arm does, and what the reference says: states (n, 28) every 10 ms."""
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
def test_positions_agree_with_a_tight_reference(
    changes: dict[str, float], drives: list[tuple[float, Drive]], tolerance_mm: float
) -> None:
    arm, reference = positions_and_pressures(arm_with(DIRECT | changes), drives)
    assert np.ptp(reference[:, POSITION], axis=0).min() > 0.035
    assert np.abs(arm - reference)[:, POSITION].max() < 1e-3 * tolerance_mm
    assert np.abs(arm - reference)[:, PRESSURE].max() < 3e3


def test_payload_changes_the_bodies_as_in_the_reference() -> None:
    parameters = arm_with(DIRECT)
    drives = [(1.0, Drive((0.12, 0.1, 0.1), payload_kg=3.0))]
    arm, reference = positions_and_pressures(parameters, drives)
    light = solve(parameters, state_of(Arm(parameters, seed=1)), [(1.0, Drive((0.12, 0.1, 0.1)))], SAMPLE_S)
    assert np.abs(arm - reference)[:, POSITION].max() < 0.03e-3
    assert (np.abs(light - reference)[:, POSITION].max(axis=0) > 2e-3).all()


@pytest.mark.parametrize("conductance", [1e-7, 1e-6])
@pytest.mark.parametrize(("axis", "chamber"), [(0, 1), (1, 0), (1, 1), (2, 0)])
def test_a_chamber_that_empties_within_a_step_agrees_with_the_reference(
    axis: int, chamber: int, conductance: float
) -> None:
    """The largest leak empties the horizontal's chambers with a time constant under half a step's."""
    leak = (axis, chamber, conductance)
    drives = [(0.1, Drive((0.05, 0.05, 0.05), leak=leak)), (0.3, Drive((-0.5, -0.5, 0.5), leak=leak))]
    arm, reference = positions_and_pressures(arm_with(DIRECT), drives)
    leaking_pa = reference[:, 9 * axis + 5 + chamber]
    assert np.abs(leaking_pa[10:] - 100e3).max() < 15e3
    assert np.abs(arm - reference)[:, POSITION].max() < 0.2e-3
    assert np.abs(arm - reference)[:, PRESSURE].max() < 6e3


def test_error_falls_with_the_step() -> None:
    errors = []
    for step_s in (1e-3, 5e-4, 2.5e-4, 1.25e-4):
        parameters = arm_with(DIRECT | {"step_s": step_s})
        arm, reference = positions_and_pressures(parameters, MOVES[:2])
        errors.append(np.abs(arm - reference)[:, POSITION].max())
    assert all(fine < 0.6 * coarse for coarse, fine in pairwise(errors))
    assert errors[-1] < 0.01e-3


def test_tube_and_play_delay_and_hold_back_the_spool() -> None:
    """A spool command comes a tube's length later, short of the play; seen against the reference's spool."""
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


def test_cutting_a_period_into_pieces_changes_nothing_that_matters() -> None:
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


@pytest.mark.parametrize("axis", range(3), ids=AXES)
def test_equation_2_is_the_linearisation_of_the_arm_that_it_describes(axis: int) -> None:
    """No leak, no spring, no heat: the compiled dynamics, differentiated numerically, respond as eq. (2)."""
    ideal = {"axes.*.valve.clearance": 1e-3, "axes.*.spring.rate_n_m": 0.0, "axes.*.cylinder.heat_w_k": 0.0}
    linear = linearise(_smooth(ideal), axis)
    for w in (0.3, 1.0, 3.0, 10.0, 30.0):
        assert _response(_smooth(ideal), axis, w) == pytest.approx(linear.equation_2(1j * w), rel=0.01)


@pytest.mark.parametrize("axis", range(3), ids=AXES)
def test_leak_and_spring_make_the_slow_pole(axis: int) -> None:
    """The calibrated arm, walls and all, is eq. (2) with the two terms that it leaves out, within 15 %."""
    linear = linearise(_smooth({}), axis)
    for w in (0.05, 0.3, 1.0, 5.0):
        assert _response(_smooth({}), axis, w) == pytest.approx(linear.with_leak_and_spring(1j * w), rel=0.15)
        assert abs(_response(_smooth({}), axis, w)) < 0.75 * abs(linear.equation_2(1j * w))


def _smooth(changes: dict[str, float]) -> ArmParameters:
    """Without what has no derivative: dry friction."""
    viscous = {key: value for key, value in FRICTIONLESS.items() if "viscous" not in key}
    return arm_with(viscous | {"axes.vertical.spring.centre_n": 10.0 * 9.80665} | changes)


def _response(parameters: ArmParameters, axis: int, w: float) -> complex:
    """From volts on the valve to the axis' position at ``w`` rad/s, by central differences of short steps."""
    arm = Arm(parameters, seed=1)
    for number, (part, state) in enumerate(zip(parameters.ordered, arm.state.axis, strict=True)):
        pressure_pa = linearise(parameters, number).pressure_pa
        state.position_m = state.velocity_m_s = state.spool = state.spool_rate_1_s = 0.0
        volume_m3 = part.cylinder.dead_volume_m3 + 0.5 * part.cylinder.area_m2 * part.cylinder.stroke_m
        for chamber in range(2):
            state.pressure_pa[chamber] = pressure_pa
            state.air_kg[chamber] = pressure_pa * volume_m3 / (287.05 * 293.15)
        arm.conditions.axis[number].spool_free = 0.0
    arm.state.supply_pa = arm.conditions.regulator_pa
    rest = np.frombuffer(bytes(arm.state))
    packed, dynamics, dt = native.pack(parameters), native.Dynamics(), 1e-6
    names = [9 * axis + k for k in (2, 3, 5, 6, 7, 8)]
    nudges = (1e-5, 1e-4, 10.0, 10.0, 1e-8, 1e-8)

    def rates(index: int, nudge: float) -> NDArray[np.float64]:
        moved = rest.copy()
        moved[index] += nudge
        state = native.State.from_buffer_copy(moved.tobytes())
        arguments = (ctypes.byref(part) for part in (packed, arm.conditions, state))
        assert dynamics.advance(*arguments, dt, 1) == 0
        return np.asarray((np.frombuffer(bytes(state)) - moved)[names] / dt)

    def slope(index: int, nudge: float) -> NDArray[np.float64]:
        return (rates(index, nudge) - rates(index, -nudge)) / (2.0 * nudge)

    A = np.column_stack([slope(index, nudge) for index, nudge in zip(names, nudges, strict=True)])
    b = slope(9 * axis, 1e-4) / 5.0
    return complex(np.linalg.solve(1j * w * np.eye(6) - A, b)[0]) * parameters.travel[axis]


def run_bytes(library: ctypes.CDLL | None = None, *, seed: int = 1) -> bytes:
    """Readings and final state of a run with everything in it."""
    arm = Arm(arm_with({}), seed=seed, changes=[Payload(at_s=0.5, mass_kg=3.0)])
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


def test_optimisation_does_not_change_a_byte(tmp_path: Path) -> None:
    source = Path(native.__file__).with_name("dynamics.c")
    library = tmp_path / "plain.so"
    flags = ("-std=c11", "-O0", "-ffp-contract=off", "-shared", "-fPIC")
    subprocess.run(["gcc", *flags, "-o", library, source, "-lm"], check=True)
    assert run_bytes(ctypes.CDLL(str(library))) == run_bytes()
