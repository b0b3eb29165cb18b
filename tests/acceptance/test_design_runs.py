"""What was designed runs: the daemon's law and lockstep shell give the response that the report draws."""

from __future__ import annotations

import os
import re
from functools import cache
from importlib import resources
from pathlib import Path
from unittest import mock

import control
import numpy as np
import pytest
from numpy.typing import NDArray
from support.constants import PERIOD_S
from support.drawn_curves import drawn_curves

from design.closed_loop.comparison import Candidate
from design.models.plant import paper_plant, read_plant
from design.synthesis.design_file import read_design
from design.synthesis.procedure import Design, design_controller
from firmware_sim.plants.linear_plant import LinearPlant
from firmware_sim.simulated_rig import SimulatedRig
from hil.cli import main
from hil.core.control_law import ControlLaw
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.core.output import Cycle, LogEntry
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder
from hil.shells.lockstep import Lockstep
from hil.shells.run_plan import Ending, RunPlan, StopRequest
from hil.shells.run_setup import RunSetup, load_setup
from hil.shells.session import Session
from hil.views.summary import StepResponse, summarise

Values = NDArray[np.float64]

STEP_M = 0.015
"""Small enough that the kick of ZN's derivative stays within the valve's range and rate."""
STEP_AT_PERIOD = 10
STEMS = {"PID (designed)": "controller", "HLS": "hls", "PI": "pi", "ZN": "zn", "TLC": "tlc"}
SPAN_M, VALVE_V = 0.33, 10.0


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``hil design`` writes for the paper's plant."""
    folder = tmp_path_factory.mktemp("designed")
    before = Path.cwd()
    os.chdir(folder)
    try:
        assert main(["design"]) == 0
    finally:
        os.chdir(before)
    return folder / "designs" / "paper"


def setup_of(written: Path, name: str) -> RunSetup:
    step = f"step:{STEP_M}@{STEP_AT_PERIOD * PERIOD_S}"
    return load_setup(None, {"vertical": str(written / f"{STEMS[name]}.json")}, {"vertical": step})


def drawn(written: Path, name: str) -> tuple[Values, Values]:
    """Times and positions of a unit step, read off the figure in the file."""
    figure = "fig9-tuning-rules" if name in ("ZN", "TLC") else "fig10-steps"
    (run,) = drawn_curves((written / "figures" / f"{figure}.svg").read_text())[0][name]
    return run[:, 0], run[:, 1]


class Running:
    """An observer that keeps what the vertical axis measured while running."""

    def __init__(self) -> None:
        self.r: list[float] = []
        self.y: list[float] = []

    def log(self, entry: LogEntry) -> None:
        """See Observer."""

    def cycle(self, cycle: Cycle, _gateway: Gateway) -> None:
        """See Observer."""
        if cycle.state is LifeCycleState.RUNNING and cycle.fresh:
            self.r.append(cycle.axes[0].setpoint)
            self.y.append(cycle.axes[0].position)


def lockstep_step(setup: RunSetup, resolution_bits: int) -> Values:
    """Positions from the step on, through gateway, frames and boards of so many bits."""
    running = Running()
    recorder = mock.create_autospec(Recorder, instance=True)
    recorder.hand_over.return_value = None
    boards = SimulatedRig(setup.rig, LinearPlant(setup.rig), resolution_bits=resolution_bits)
    shell = Lockstep(boards, 0)
    plan = RunPlan(4.0, PERIOD_S)
    gateway = setup.gateway(setup.rig.loop.period_ns)
    shell.run(Session(gateway, plan, shell.send, shell.clock_ns, recorder, running), StopRequest())
    assert plan.ending is Ending.COMPLETED
    return np.array(running.y)[int(np.argmax(np.array(running.r) > 0.0)) :]


def test_design_for_the_arms_axis_does_on_the_arm_what_the_report_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """README's sequence, both ways: a step up takes a little longer than the model's, one down less."""
    monkeypatch.chdir(tmp_path)
    assert main(["design", "vertical"]) == 0
    text = resources.files("design.models").joinpath("plants/vertical.json").read_text()
    reported = design_controller(read_design("", "design.toml"), read_plant(text, "vertical")).measures[0]
    settling_s = []
    for size in ("0.1", "-0.1"):
        asked = ["--controller", "vertical=designs/vertical/controller.json"]
        asked += ["--setpoint", f"vertical=step:{size}@2", "--duration", "8", "--record", f"run{size}.mcap"]
        assert main(["run", "--lockstep", *asked]) == 0
        step = summarise(Recording(Path(f"run{size}.mcap"))).axes["vertical"]
        assert isinstance(step, StepResponse)
        assert step.settling_s is not None
        settling_s.append(step.settling_s)
        assert step.overshoot_percent < 1.0
    assert max(settling_s) < 1.2, "what was asked for"
    assert np.mean(settling_s) == pytest.approx(reported.settling_s, abs=0.05)


def test_design_against_two_plants_overshoots_on_neither(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """README's: the shipped controller of the rotation axis, designed without load, overshoots under load."""
    monkeypatch.chdir(tmp_path)
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    Path("both.toml").write_text(re.findall(r"```toml\n(.*?)```", readme, re.DOTALL)[0])
    assert main(["design", "rotation", "--design", "both.toml", "--out", "both"]) == 0
    overshoot = {}
    for scenario in ("fig14", "fig15"):
        for controller in ("rotation", "both/controller.json"):
            record = Path(f"{scenario}-{len(overshoot)}.mcap")
            asked = [
                "--scenario",
                scenario,
                "--controller",
                f"rotation={controller}",
                "--record",
                str(record),
            ]
            assert main(["run", "--lockstep", *asked]) == 0
            step = summarise(Recording(record)).axes["rotation"]
            assert isinstance(step, StepResponse)
            overshoot[scenario, controller] = step.overshoot_percent
    assert overshoot["fig14", "rotation"] > 5.0
    assert overshoot["fig14", "both/controller.json"] < 1.0
    assert overshoot["fig15", "both/controller.json"] < 2.0


def quantisation_bound_m(candidate: Candidate, resolution_bits: int) -> float:
    """The most that both converters can move a position: errors times the l1 norms of T and G/(1 + GK).

    The potentiometer board rounds, the valve board drops the bits that it has not, the frame rounds to 15.
    """
    plant = paper_plant()
    G = control.sample_system(control.ss(control.tf(plant.num, plant.den)), PERIOD_S, "zoh")
    G = G * control.ss(control.tf([1.0], [1.0, 0.0], PERIOD_S))
    K = control.sample_system(
        control.ss(control.tf(candidate.controller.num.ravel(), candidate.controller.den.ravel())),
        PERIOD_S,
        "bilinear",
    )
    t = np.arange(0.0, 60.0, PERIOD_S)

    def l1(H: control.StateSpace) -> float:
        # impulse_response scales by 1/period
        return float(np.abs(control.impulse_response(H, t).outputs).sum() * PERIOD_S)

    position_m = 0.5 * SPAN_M / 2**resolution_bits
    valve_v = VALVE_V / 2**resolution_bits + 0.5 * VALVE_V / 2**15
    return l1(control.feedback(G * K)) * position_m + l1(control.feedback(G, K)) * valve_v + position_m


@pytest.mark.parametrize("bits", [12, 15])
@pytest.mark.parametrize("name", STEMS)
def test_lockstep_run_is_the_drawn_response_within_quantisation(written: Path, name: str, bits: int) -> None:
    setup = setup_of(written, name)
    t, y = drawn(written, name)
    measured = lockstep_step(setup, bits)
    bound_m = quantisation_bound_m(candidate_of(default_design(), name), bits)
    assert bound_m < 0.1 * STEP_M, "a bound that says something"
    pixel = 0.003
    k = np.rint(t / PERIOD_S).astype(int)
    np.testing.assert_allclose(measured[k] / STEP_M, y, rtol=0, atol=bound_m / STEP_M + pixel)


@cache
def default_design() -> Design:
    return design_controller(read_design("", "design.toml"), paper_plant())


def candidate_of(design: Design, name: str) -> Candidate:
    return next(candidate for candidate in design.candidates if candidate.name == name)


def stepped_by_hand(design: Design, candidate: Candidate, setup: RunSetup, periods: int) -> Values:
    """Law and plant alone: no quantisation, one period of delay."""
    law, plant = ControlLaw(candidate.law, PERIOD_S), LinearPlant(setup.rig)
    valve = setup.rig.axes["vertical"].valve
    law.initialise(0.0, 0.0, 0.0)
    applied_v, positions = [0.0] * (design.problem.rig_sampling.delay_samples), []
    for _ in range(periods):
        y = plant.position("vertical")
        positions.append(y)
        u = law.output(1.0, y)
        law.advance(u)
        applied_v.append(u)
        volts = [valve.centre_v] * 3
        volts[valve.channel - 1] += applied_v.pop(0)
        plant.advance(setup.rig.loop.period_ns, volts)
    return np.array(positions)


STRUCTURES = {
    "pid": "",
    "pid-2dof": "",
    "pi-lead": "",
    "lead-lag": "",
    "free": "orders = { num = 2, den = 1, integrators = 1 }",
}


@pytest.mark.parametrize("structure", STRUCTURES)
def test_law_stepped_by_hand_is_the_computed_response(structure: str) -> None:
    """To 1e-9, for the designed controller of each structure and every controller it is compared with."""
    text = "[search]\nweight_evaluations = 500\ncontroller_evaluations = 2000\n"
    text += f'[controller]\nstructure = "{structure}"\n{STRUCTURES[structure]}\n'
    design = design_controller(read_design(text, "design.toml"), paper_plant())
    setup = load_setup(None, {}, {})
    for candidate in design.candidates:
        expected = design.problem.step(candidate, 400 * PERIOD_S).y[0]
        positions = stepped_by_hand(design, candidate, setup, len(expected))
        np.testing.assert_allclose(positions, expected, rtol=0, atol=1e-9, err_msg=candidate.name)


@pytest.mark.parametrize("delay", [0, 2])
def test_other_delays(delay: int) -> None:
    text = f"[loop]\ndelay_samples = {delay}\n"
    text += "[search]\nweight_evaluations = 500\ncontroller_evaluations = 1000\n"
    design = design_controller(read_design(text, "design.toml"), paper_plant())
    expected = design.problem.step(design.designed, 300 * PERIOD_S).y[0]
    positions = stepped_by_hand(design, design.designed, load_setup(None, {}, {}), len(expected))
    np.testing.assert_allclose(positions, expected, rtol=0, atol=1e-9)
