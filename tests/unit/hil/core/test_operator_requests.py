"""Operators' requests for the life cycle, and what a request for an axis changes besides the axis."""

from __future__ import annotations

import pytest
from support.gateway_bench import LIVE_STATES, make_stepped

from hil.core.life_cycle import OPERATOR_TRIGGERS, LifeCycleState, Trigger
from hil.core.requests import JogRequest, SetpointRequest

OTHER_TRIGGERS = [trigger for trigger in Trigger if trigger not in OPERATOR_TRIGGERS]


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
