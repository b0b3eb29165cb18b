"""Designed controllers in operation: law and lockstep shell give the response that the report draws."""

from __future__ import annotations

import os
import re
import shlex
from functools import cache
from importlib import resources
from pathlib import Path
from unittest import mock

import control
import msgspec
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
from hil.core.documents import to_json
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
"""Step size for which even the derivative of ZN stays within the valve's range and rate."""
STEP_AT_PERIOD = 10
STEMS = {"PID (designed)": "controller", "HLS": "hls", "PI": "pi", "ZN": "zn", "TLC": "tlc"}
SPAN_M, VALVE_V = 0.33, 10.0


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder that ``hil design`` writes for the paper's plant."""
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
    """Return times and positions of a unit step, read off the figure in the file."""
    figure = "tuning-rules" if name in ("ZN", "TLC") else "step-responses"
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
    """Return positions from the step on, through gateway, frames and boards of the given resolution."""
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


def test_a_design_for_an_axis_of_the_arm_has_the_reported_settling_time_on_the_arm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """README's commands. A step up takes a little longer than that of the model, a step down less."""
    monkeypatch.chdir(tmp_path)
    assert main(["design", "vertical"]) == 0
    text = resources.files("design.models").joinpath("plants/vertical.json").read_text()
    reported = design_controller(read_design("", "design.toml"), read_plant(text, "vertical")).measures[0]
    settling_s = []
    for size in ("0.1", "-0.1"):
        options = ["--controller", "vertical=designs/vertical/controller.json"]
        options += ["--setpoint", f"vertical=step:{size}@2", "--duration", "8", "--record", f"run{size}.mcap"]
        assert main(["run", "--lockstep", *options]) == 0
        step = summarise(Recording(Path(f"run{size}.mcap"))).axes["vertical"]
        assert isinstance(step, StepResponse)
        assert step.settling_s is not None
        settling_s.append(step.settling_s)
        assert step.overshoot_percent < 1.0
    assert max(settling_s) < 1.2, "the specified settling time"
    assert np.mean(settling_s) == pytest.approx(reported.settling_s, abs=0.05)


def test_the_next_command_runs_a_users_own_plant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command that ``hil design`` prints gives the settling time that its report states.

    The plant is twice as fast as the paper's, so that running another plant would be noticed. Its model
    contains the rig's delay, which must count once.
    """
    monkeypatch.chdir(tmp_path)
    paper = paper_plant()
    fast = msgspec.structs.replace(
        paper,
        name="my plant",
        num=[b * 2.0 ** (i + 2) for i, b in enumerate(paper.num)],
        den=[a * 2.0**i for i, a in enumerate(paper.den)],
        dead_time_s=PERIOD_S,
        contains_delay_samples=1,
        sample_time_s=PERIOD_S,
    )
    Path("my plant.json").write_text(to_json(fast))
    Path("d.toml").write_text(
        "[specifications]\novershoot = 0.05\nsettling_s = 0.6\nerror = 0.001\nbandwidth_rad_s = 8.0\n"
    )
    assert main(["design", "my plant.json", "--design", "d.toml", "--out", "out"]) == 0
    (line,) = (text for text in capsys.readouterr().out.splitlines() if text.startswith("next"))
    command = shlex.split(line.removeprefix("next"))
    assert command[:2] == ["hil", "run"]
    options = ["--lockstep", "--setpoint", "vertical=step:0.06@1", "--duration", "4", "--record", "run.mcap"]
    assert main([*command[1:], *options]) == 0
    reported = design_controller(read_design(Path("d.toml").read_text(), "d.toml"), fast).measures[0]
    step = summarise(Recording(Path("run.mcap"))).axes["vertical"]
    assert isinstance(step, StepResponse)
    assert step.settling_s == pytest.approx(reported.settling_s, abs=0.03)
    assert step.overshoot_percent == pytest.approx(100.0 * reported.overshoot, abs=1.0)
    assert reported.settling_s < 0.7, "far from the settling time of the paper's plant, 1.1 s"


def test_a_design_against_two_plants_overshoots_on_neither(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """README's example. The shipped controller, designed without load, overshoots with a load."""
    monkeypatch.chdir(tmp_path)
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    Path("both.toml").write_text(re.findall(r"```toml\n(.*?)```", readme, re.DOTALL)[0])
    assert main(["design", "rotation", "--design", "both.toml", "--out", "both"]) == 0
    overshoot = {}
    for scenario in ("fig14", "fig15"):
        for controller in ("rotation", "both/controller.json"):
            record = Path(f"{scenario}-{len(overshoot)}.mcap")
            options = [
                "--scenario",
                scenario,
                "--controller",
                f"rotation={controller}",
                "--record",
                str(record),
            ]
            assert main(["run", "--lockstep", *options]) == 0
            step = summarise(Recording(record)).axes["rotation"]
            assert isinstance(step, StepResponse)
            overshoot[scenario, controller] = step.overshoot_percent
    assert overshoot["fig14", "rotation"] > 5.0
    assert overshoot["fig14", "both/controller.json"] < 1.0
    assert overshoot["fig15", "both/controller.json"] < 2.0


def quantisation_bound_m(candidate: Candidate, resolution_bits: int) -> float:
    """Return the largest change of a position that quantisation can cause, in m.

    It is the sum of the quantisation errors times the l1 norms of T and G/(1 + GK). The potentiometer board
    rounds, the valve board cuts off the bits that it lacks, and the frame rounds to 15 bits.
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
        # impulse_response scales by 1/period.
        return float(np.abs(control.impulse_response(H, t).outputs).sum() * PERIOD_S)

    position_m = 0.5 * SPAN_M / 2**resolution_bits
    valve_v = VALVE_V / 2**resolution_bits + 0.5 * VALVE_V / 2**15
    return l1(control.feedback(G * K)) * position_m + l1(control.feedback(G, K)) * valve_v + position_m


@pytest.mark.parametrize("bits", [12, 15])
@pytest.mark.parametrize("name", STEMS)
def test_a_lockstep_run_gives_the_drawn_response_within_quantisation(
    written: Path, name: str, bits: int
) -> None:
    setup = setup_of(written, name)
    t, y = drawn(written, name)
    measured = lockstep_step(setup, bits)
    bound_m = quantisation_bound_m(candidate_of(default_design(), name), bits)
    assert bound_m < 0.1 * STEP_M, "a larger bound would hide errors"
    pixel = 0.003
    k = np.rint(t / PERIOD_S).astype(int)
    np.testing.assert_allclose(measured[k] / STEP_M, y, rtol=0, atol=bound_m / STEP_M + pixel)


@cache
def default_design() -> Design:
    return design_controller(read_design("", "design.toml"), paper_plant())


def candidate_of(design: Design, name: str) -> Candidate:
    return next(candidate for candidate in design.candidates if candidate.name == name)


def stepped_by_hand(design: Design, candidate: Candidate, setup: RunSetup, periods: int) -> Values:
    """Return positions with law and plant alone: no quantisation, and the delay of the design."""
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
def test_a_law_stepped_by_hand_gives_the_computed_response(structure: str) -> None:
    """The designed controller of each structure, and every controller it is compared with, agree to 1e-9."""
    text = "[search]\nweight_evaluations = 500\ncontroller_evaluations = 2000\n"
    text += f'[controller]\nstructure = "{structure}"\n{STRUCTURES[structure]}\n'
    design = design_controller(read_design(text, "design.toml"), paper_plant())
    setup = load_setup(None, {}, {})
    for candidate in design.candidates:
        expected = design.problem.step(candidate, 400 * PERIOD_S).y[0]
        positions = stepped_by_hand(design, candidate, setup, len(expected))
        np.testing.assert_allclose(positions, expected, rtol=0, atol=1e-9, err_msg=candidate.name)


@pytest.mark.parametrize("delay", [0, 2])
def test_other_delays_give_the_computed_response(delay: int) -> None:
    text = f"[loop]\ndelay_samples = {delay}\n"
    text += "[search]\nweight_evaluations = 500\ncontroller_evaluations = 1000\n"
    design = design_controller(read_design(text, "design.toml"), paper_plant())
    expected = design.problem.step(design.designed, 300 * PERIOD_S).y[0]
    positions = stepped_by_hand(design, design.designed, load_setup(None, {}, {}), len(expected))
    np.testing.assert_allclose(positions, expected, rtol=0, atol=1e-9)
