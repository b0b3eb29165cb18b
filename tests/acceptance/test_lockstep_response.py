"""Each shipped controller in closed loop: against python-control, and against the paper."""

from __future__ import annotations

import control
import numpy as np
import pytest
from support.constants import PERIOD_S

from firmware_sim.plants.linear_plant import LinearPlant
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.control_law import ControlLaw, realise
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState
from hil.core.output import Cycle, LogEntry
from hil.shells.lockstep import Lockstep
from hil.shells.run_plan import Ending, RunPlan, StopRequest
from hil.shells.run_setup import RunSetup, load_setup, setup_from_texts
from hil.shells.session import Session

PAPER_PLANT = control.tf(0.47947 * np.array([1.0, 90.76]), np.polymul([1.0, 0.4231], [1.0, 16.97, 167.9]))


class Cycles:
    """A recorder and an observer in one, which keeps the cycles of a run."""

    def __init__(self) -> None:
        self.running: list[Cycle] = []

    def cycle(self, cycle: Cycle, *_rest: object) -> None:
        if cycle.state is LifeCycleState.RUNNING and (not self.running or self.running[-1] is not cycle):
            self.running.append(cycle)

    def log(self, _entry: LogEntry) -> None: ...
    def log_entry(self, _entry: LogEntry, _now_ns: int) -> None: ...
    def frame_received(self, _frame: Frame, _now_ns: int, _stamp_ns: int) -> None: ...
    def frame_sent(self, _frame: Frame, _now_ns: int) -> None: ...
    def deadline_called(self, _deadline_ns: int, _now_ns: int) -> None: ...
    def operated(self, *_rest: object) -> None: ...
    def hand_over(self) -> None: ...


def run_lockstep(setup: RunSetup, duration_s: float) -> list[Cycle]:
    """The cycles of a run of ``setup`` against the linear plant behind 12-bit boards."""
    kept = Cycles()
    lockstep = Lockstep(SimulatedRig(setup.rig, LinearPlant(setup.rig)), 0)
    plan = RunPlan(duration_s, PERIOD_S)
    gateway = setup.gateway(setup.rig.loop.period_ns)
    session = Session(gateway, plan, lockstep.send, lockstep.clock_ns, kept, kept)  # type: ignore[arg-type]
    lockstep.run(session, StopRequest())
    assert plan.ending is Ending.COMPLETED
    return kept.running


def sampled_controller(setup: RunSetup) -> control.StateSpace:
    """The vertical axis' controller from e to u, for python-control."""
    A, B, C, D = realise(setup.controllers["vertical"].law, PERIOD_S)
    return control.ss(A, B[:, :1], C, D[:, :1], PERIOD_S)


STEP_M = 0.015
"""Small enough that ZN's derivative kick, 271 V/m, stays within the valve's range and rate."""


@pytest.fixture(params=["ppid", "hls", "zn", "tlc"])
def setup(request: pytest.FixtureRequest) -> RunSetup:
    return load_setup(None, {"vertical": request.param}, {"vertical": f"step:{STEP_M}@0.112"})


def test_hand_stepped_loop_equals_python_controls(setup: RunSetup) -> None:
    """Law and plant, one period of actuation delay, no quantisation: the same discrete loop to 1e-9."""
    periods = 900
    law, plant = ControlLaw(setup.controllers["vertical"].law, PERIOD_S), LinearPlant(setup.rig)
    axis = setup.rig.axes["vertical"]
    law.initialise(0.0, 0.0, 0.0)
    applied_v, positions = 0.0, []
    for k in range(periods):
        y = plant.position("vertical")
        positions.append(y)
        r = STEP_M if k >= 10 else 0.0
        u = law.output(r, y)
        law.advance(u)
        volts = [axis.valve.centre_v] * 3
        volts[axis.valve.channel - 1] += applied_v
        plant.advance(setup.rig.loop.period_ns, volts)
        applied_v = u

    delay = control.tf([1.0], [1.0, 0.0], PERIOD_S)
    sampled_plant = control.sample_system(control.ss(PAPER_PLANT), PERIOD_S, "zoh")
    # u decided at k is applied from k + 1 on
    loop = control.feedback(sampled_plant * control.ss(delay) * sampled_controller(setup))
    reference = np.where(np.arange(periods) >= 10, STEP_M, 0.0)
    expected = control.forced_response(loop, U=reference).outputs
    np.testing.assert_allclose(positions, expected, atol=1e-9, rtol=0)


def test_recorded_outputs_equal_python_controls(setup: RunSetup) -> None:
    """Through boards and frames: u before quantisation is K's response to the recorded errors, to 1e-9."""
    signals = [cycle.axes[0] for cycle in run_lockstep(setup, 5.0)]
    errors = np.array([s.error for s in signals])
    expected = control.forced_response(sampled_controller(setup), U=errors).outputs
    np.testing.assert_allclose([s.output_v for s in signals], expected, atol=1e-9, rtol=0)
    np.testing.assert_allclose([s.command_v - 5.0 for s in signals], expected, atol=1e-9, rtol=0)


PAPER_OVERSHOOT_PERCENT = {"ppid": 1.17, "hls": 0.2, "zn": 46.1, "tlc": 9.6}


def test_step_response_is_the_papers(setup: RunSetup) -> None:
    """With commands applied at once, as the paper's loops assume: sampled, but without a period of delay."""
    at_once = {**setup.texts, "rig.toml": setup.texts["rig.toml"].replace('"at sync"', '"at once"', 1)}
    assert at_once != setup.texts
    cycles = run_lockstep(setup_from_texts(at_once, {n: s.text for n, s in setup.setpoints.items()}), 8.0)
    t = np.array([cycle.deadline_ns for cycle in cycles]) * 1e-9
    y = np.array([cycle.axes[0].position for cycle in cycles])
    r = np.array([cycle.axes[0].setpoint for cycle in cycles])
    t = t - t[np.argmax(r > 0)]
    overshoot_percent = (y.max() / STEP_M - 1.0) * 100.0
    paper = PAPER_OVERSHOOT_PERCENT[setup.controllers["vertical"].name]
    assert paper - 1.0 < overshoot_percent < paper + 6.0
    assert abs(y[-90:].mean() - STEP_M) < 0.0002
    if paper < 2.0:
        settled = t[np.abs(y - STEP_M) > 0.02 * STEP_M + 0.00005].max()
        assert 0.7 < settled < 1.2, "2 % settling time, the paper: about 1.1 s"
