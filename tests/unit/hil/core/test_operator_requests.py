"""Operators' requests for the life cycle, and what a request for an axis changes besides the axis."""

from __future__ import annotations

import json

import pytest
from support.constants import CENTRED, PERIOD_S
from support.gateway_bench import LIVE_STATES, SteppedGateway, commands, make_stepped, rig_text, texts

from hil.core.life_cycle import OPERATOR_TRIGGERS, LifeCycleState, Trigger
from hil.core.requests import ControllerRequest, JogRequest, Reply, SetpointRequest
from hil.core.rig import read_rig
from hil.core.setpoints import parse_setpoint

PERMITTED = [
    (LifeCycleState.READY, Trigger.ARM, LifeCycleState.ARMED),
    (LifeCycleState.ARMED, Trigger.START, LifeCycleState.RUNNING),
    (LifeCycleState.RUNNING, Trigger.STOP, LifeCycleState.ARMED),
    (LifeCycleState.ARMED, Trigger.DISARM, LifeCycleState.READY),
    (LifeCycleState.FAULT, Trigger.RESET, LifeCycleState.OFFLINE),
]
OTHER_TRIGGERS = [trigger for trigger in Trigger if trigger not in OPERATOR_TRIGGERS]


@pytest.mark.parametrize(("before", "trigger", "after"), PERMITTED)
def test_a_trigger_changes_the_state_and_what_belongs_to_it(
    before: LifeCycleState, trigger: Trigger, after: LifeCycleState
) -> None:
    gateway = make_stepped(before)
    requests, calls = gateway.core._requests, []
    requests._on_start = lambda: calls.append("start")
    requests._on_reset = lambda: calls.append("reset")
    output = gateway.operate(trigger)
    assert gateway.state is after
    assert output.reply == Reply(True, f"{before.name.lower()} -> {after.name.lower()} ({trigger})")
    assert commands(output) == ([CENTRED] if trigger is Trigger.STOP else [])
    assert calls == {Trigger.START: ["start"], Trigger.RESET: ["reset"]}.get(trigger, [])


@pytest.mark.parametrize(("state", "trigger"), [(before, trigger) for before, trigger, _ in PERMITTED])
def test_only_arm_and_start_keep_the_setpoints_that_were_asked_for(
    state: LifeCycleState, trigger: Trigger
) -> None:
    gateway = make_stepped(state)
    loops = gateway.core._loops
    loops.change_setpoint("vertical", parse_setpoint("step:0.1@0"), is_running=False)
    gateway.operate(trigger)
    kept = trigger in (Trigger.ARM, Trigger.START)
    assert list(loops.requested_setpoints()) == ([("vertical", "step:0.1@0")] if kept else [])


def test_only_an_accepted_controller_replaces_one_whose_check_failed() -> None:
    gateway = make_stepped(LifeCycleState.READY)
    changed: list[str] = []
    gateway.core._arming.controller_changed = changed.append  # type: ignore[method-assign]
    gateway.operate(SetpointRequest("vertical", "0.1"))
    gateway.operate(ControllerRequest("vertical", "broken.json", "{}"))
    assert changed == []
    law = {"kind": "pid", "kp": 5.0, "ki": 0.0}
    document = {
        "format": "hil-controller",
        "version": 1,
        "name": "test",
        "description": "",
        "sample_time_s": PERIOD_S,
        "input_unit": "m",
        "output_unit": "V",
        "law": law,
        "origin": {},
    }
    gateway.operate(ControllerRequest("vertical", "new.json", json.dumps(document)))
    assert changed == ["vertical"]


@pytest.mark.parametrize("trigger", OTHER_TRIGGERS)
@pytest.mark.parametrize("state", LifeCycleState)
def test_a_trigger_that_is_not_an_operators_is_refused_in_every_state(
    trigger: Trigger, state: LifeCycleState
) -> None:
    gateway = make_stepped(state)
    reply = gateway.operate(trigger).reply
    assert reply is not None
    assert not reply.accepted
    assert f"{trigger.value} refused in state {state.name.lower()}" in reply.text
    assert gateway.state is state


@pytest.mark.parametrize("trigger", [Trigger.DISARM, Trigger.STOP])
def test_only_the_stop_of_a_jog_makes_the_next_jog_wait(trigger: Trigger) -> None:
    gateway = make_stepped(LifeCycleState.RUNNING if trigger is Trigger.STOP else LifeCycleState.ARMED)
    gateway.periods(2)
    gateway.operate(trigger)
    if trigger is Trigger.DISARM:
        gateway.operate(Trigger.ARM)
    reply = gateway.operate(JogRequest("vertical", 0.5, 0.1)).reply
    assert reply is not None
    assert reply.accepted


@pytest.mark.parametrize("state", LIVE_STATES)
def test_a_setpoint_that_would_be_taken_is_not_refused_beforehand(state: LifeCycleState) -> None:
    core = make_stepped(state).core
    assert core.refuse_setpoint(SetpointRequest("vertical", "0.1")) is None
    refusal = core.refuse_setpoint(SetpointRequest("vertical", "0.2"))
    assert refusal is not None
    assert "beyond 0.15 m" in refusal.text


def test_in_state_fault_every_setpoint_is_refused_beforehand() -> None:
    refusal = make_stepped(LifeCycleState.FAULT).core.refuse_setpoint(SetpointRequest("vertical", "0.1"))
    assert refusal is not None
    assert not refusal.accepted
    assert refusal.text.startswith("vertical: setpoint refused: the state is fault (link: test)")


def test_an_axis_that_is_calibrated_is_not_controlled() -> None:
    rig = read_rig('calibration = "horizontal"\n' + rig_text(), "rig.toml")
    gateway = SteppedGateway(rig).bring_to(LifeCycleState.ARMED)
    (refusal,) = texts(gateway.operate(Trigger.START))
    assert refusal == (
        "horizontal: start refused: this axis is being calibrated (rig: calibration); it can only be jogged"
    )
    assert gateway.state is LifeCycleState.ARMED
