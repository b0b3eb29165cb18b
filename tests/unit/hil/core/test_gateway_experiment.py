"""An experiment through the whole gateway: phases, envelope, fence, and what reaches the valve."""

from __future__ import annotations

import pytest
from support.constants import COUNT_V, PERIOD_S
from support.gateway_bench import START_NS, SteppedGateway, commands, make_gateway, make_rig, texts

from hil.core.control_law import ControlLaw
from hil.core.controller_file import PidLaw
from hil.core.excitation import Steps
from hil.core.experiment import Experiment
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Output, Severity
from hil.core.phase import Phase
from hil.core.requests import ControllerRequest, JogRequest, Reply, Request, SetpointRequest
from hil.core.setpoints import parse_setpoint

AMPLITUDE_V = 0.5


def experiment(mode: str = "open loop") -> Experiment:
    return Experiment(
        format="hil-experiment",
        version=1,
        axis="vertical",
        mode=mode,  # type: ignore[arg-type]
        signal=Steps(amplitude=AMPLITUDE_V, duration_s=80 * PERIOD_S, hold_s=20 * PERIOD_S),
        approach_s=10 * PERIOD_S,
        settle_s=10 * PERIOD_S,
    )


def started(envelope: str = "", mode: str = "open loop") -> SteppedGateway:
    rig = make_rig(envelope=envelope)
    core = Gateway(
        rig,
        {name: ControlLaw(PidLaw(kp=20.0, ki=0.0), PERIOD_S) for name in rig.axes},
        {name: parse_setpoint("hold") for name in rig.axes},
        START_NS,
        experiment(mode),
    )
    return SteppedGateway(rig, core).bring_to(LifeCycleState.RUNNING)


def until(gateway: SteppedGateway, phase: Phase) -> Output:
    """Let periods pass until the experiment is in ``phase``; the output of the last one."""
    for _ in range(100):
        output = gateway.period()
        if output.cycle is not None and output.cycle.axes[0].phase is phase:
            return output
    raise AssertionError(f"{phase} does not come")


def test_the_phases_are_reported_and_recorded_with_the_excited_axis_only() -> None:
    gateway = started()
    phases, reports = [], []
    severities = set()
    for _ in range(200):
        output = gateway.period()
        assert output.cycle is not None
        excited, *others = [signals.phase for signals in output.cycle.axes]
        assert others == [Phase.NONE, Phase.NONE]
        if not phases or phases[-1] is not excited:
            phases.append(excited)
            reports += texts(output)
            severities |= {entry.severity for entry in output.log}
    order = [Phase.APPROACH, Phase.SETTLE, Phase.EXCITED, Phase.RETURN, Phase.DONE]
    assert phases == order
    assert [text.split(" ", 1)[0] for text in reports] == ["experiment:"] * len(order)
    assert "settles" in reports[1]
    assert severities == {Severity.INFO}
    said = [text for text in gateway.transcript.texts() if text.startswith("experiment:")]
    assert said == reports, "each phase is reported once"


def test_in_open_loop_the_valve_gets_the_excitation() -> None:
    gateway = started()
    output = until(gateway, Phase.EXCITED)
    assert commands(output)[0][0] == pytest.approx(5.0 + AMPLITUDE_V, abs=COUNT_V)
    assert commands(output)[0][1:] == (5.0, 5.0)


def test_the_tracking_error_counts_only_under_the_controller() -> None:
    """10 V are 330 mm, so that 4 V are 33 mm from the middle."""
    strict = f"max_error = 0.01\nmax_error_s = {3.5 * PERIOD_S}\ndisabled = ['max_speed']"
    excited = started(strict)
    until(excited, Phase.EXCITED)
    for _ in range(10):
        excited.period((4.0, 5.0, 5.0))
    assert excited.state is LifeCycleState.RUNNING
    settling = started(strict)
    until(settling, Phase.SETTLE)
    for _ in range(10):
        settling.period((4.0, 5.0, 5.0))
    assert settling.state is LifeCycleState.FAULT


def test_beyond_the_fence_the_controller_takes_the_axis_back() -> None:
    gateway = started("disabled = ['max_speed']")
    until(gateway, Phase.EXCITED)
    output = gateway.period((9.0, 5.0, 5.0))
    assert output.cycle is not None
    assert output.cycle.axes[0].phase is Phase.RECOVER
    assert any("beyond its travel fence" in text for text in texts(output))
    assert output.log[-1].severity == 30


def test_the_law_takes_what_the_limits_let_through() -> None:
    """An integrator that is told of a limited command does not wind up."""
    gateway = started("disabled = ['max_speed', 'max_error', 'max_still_s']")
    applied: list[float] = []
    loop = gateway.core.experiment
    assert loop is not None
    advance = loop.advance
    loop.advance = lambda u: applied.append(u) or advance(u)  # type: ignore[method-assign, func-returns-value]
    output = gateway.period()
    assert output.cycle is not None
    assert applied == [output.cycle.axes[0].command_v - 5.0]


@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.EXCITED])
def test_after_a_stop_the_experiment_begins_anew_and_its_first_phase_is_reported_again(phase: Phase) -> None:
    gateway = started()
    until(gateway, phase)
    gateway.operate(Trigger.STOP)
    gateway.operate(Trigger.START)
    output = gateway.period()
    assert output.cycle is not None
    assert output.cycle.axes[0].phase is Phase.APPROACH
    assert any("moves to its centre" in text for text in texts(output))


@pytest.mark.parametrize(
    "request_",
    [
        SetpointRequest("vertical", "0.05"),
        ControllerRequest("vertical", "new.json", ""),
        JogRequest("vertical", 0.5, 0.1),
    ],
)
def test_requests_for_the_excited_axis_are_refused(request_: Request) -> None:
    gateway = started()
    reply = gateway.operate(request_).reply
    assert reply == Reply(False, "refused: an experiment has this axis until the end of the run")


def test_the_setpoint_of_another_axis_can_be_changed() -> None:
    gateway = started()
    gateway.period()
    reply = gateway.operate(SetpointRequest("horizontal", "0.02")).reply
    assert reply is not None
    assert reply.accepted
    before = gateway.period().cycle
    after = gateway.period().cycle
    assert before is not None and after is not None
    assert after.axes[1].setpoint > before.axes[1].setpoint


def test_a_held_setpoint_is_the_position_at_the_start() -> None:
    rig = make_rig()
    gateway = SteppedGateway(rig, make_gateway(rig, setpoints="hold"))
    gateway.volts = (6.0, 5.0, 4.0)
    gateway.bring_to(LifeCycleState.RUNNING)
    cycle = gateway.period().cycle
    assert cycle is not None
    positions = [signals.position for signals in cycle.axes]
    assert positions == pytest.approx([0.033, 0.0, -0.33], abs=1e-4)
    cycle = gateway.period((6.1, 5.1, 4.1)).cycle
    assert cycle is not None
    assert [signals.setpoint for signals in cycle.axes] == positions
    assert [signals.phase for signals in cycle.axes] == [Phase.NONE] * 3


def test_before_an_experiment_no_other_axis_is_jogged() -> None:
    gateway = started()
    gateway.operate(Trigger.STOP)
    reply = gateway.operate(JogRequest("horizontal", 0.5, 0.1)).reply
    assert reply is not None
    assert not reply.accepted
    assert "an experiment is planned" in reply.text
    assert gateway.state is LifeCycleState.ARMED
