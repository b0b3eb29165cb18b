"""The life cycle as a table, and the gateway held to it: state by state, trigger by trigger."""

from __future__ import annotations

import pytest
from support.gateway_bench import HandGateway, make_rig

from hil.core.life_cycle import (
    OPERATOR_TRIGGERS,
    TRANSITIONS,
    LifeCycleState,
    Trigger,
    allowed_triggers,
    next_state,
)
from hil.core.output import Severity

# Written out again, so that a slip of the table is one here.
EXPECTED = {
    (LifeCycleState.OFFLINE, Trigger.BOARDS_UP): LifeCycleState.READY,
    (LifeCycleState.READY, Trigger.BOARDS_LOST): LifeCycleState.OFFLINE,
    (LifeCycleState.READY, Trigger.ARM): LifeCycleState.ARMED,
    (LifeCycleState.ARMED, Trigger.DISARM): LifeCycleState.READY,
    (LifeCycleState.ARMED, Trigger.START): LifeCycleState.RUNNING,
    (LifeCycleState.RUNNING, Trigger.STOP): LifeCycleState.ARMED,
    (LifeCycleState.FAULT, Trigger.RESET): LifeCycleState.OFFLINE,
} | {
    (state, Trigger.FAULT): LifeCycleState.FAULT
    for state in LifeCycleState
    if state is not LifeCycleState.FAULT
}
PAIRS = [(state, trigger) for state in LifeCycleState for trigger in Trigger]
OPERATED = [(state, trigger) for state in LifeCycleState for trigger in sorted(OPERATOR_TRIGGERS)]


@pytest.mark.parametrize(("state", "trigger"), PAIRS)
def test_the_table_is_what_it_should_be(state: LifeCycleState, trigger: Trigger) -> None:
    assert next_state(state, trigger) is EXPECTED.get((state, trigger))


def test_states_have_the_numbers_that_recordings_hold() -> None:
    assert [(state.name, state.value) for state in LifeCycleState] == [
        ("OFFLINE", 0),
        ("READY", 1),
        ("ARMED", 2),
        ("RUNNING", 3),
        ("FAULT", 4),
    ]


def test_nothing_else_is_in_it() -> None:
    assert TRANSITIONS == EXPECTED


def test_running_is_reached_from_armed_alone_and_fault_left_by_reset_alone() -> None:
    assert [pair for pair, after in TRANSITIONS.items() if after is LifeCycleState.RUNNING] == [
        (LifeCycleState.ARMED, Trigger.START)
    ]
    assert [trigger for state, trigger in TRANSITIONS if state is LifeCycleState.FAULT] == [Trigger.RESET]


@pytest.mark.parametrize(
    ("state", "triggers"),
    [
        (LifeCycleState.OFFLINE, set()),
        (LifeCycleState.READY, {Trigger.ARM}),
        (LifeCycleState.ARMED, {Trigger.START, Trigger.DISARM}),
        (LifeCycleState.RUNNING, {Trigger.STOP}),
        (LifeCycleState.FAULT, {Trigger.RESET}),
    ],
)
def test_what_an_operator_may_ask_for(state: LifeCycleState, triggers: set[Trigger]) -> None:
    assert set(allowed_triggers(state)) == triggers


@pytest.mark.parametrize(("state", "trigger"), OPERATED)
def test_the_gateway_follows_the_table(state: LifeCycleState, trigger: Trigger) -> None:
    gateway = HandGateway(make_rig()).to(state)
    output = gateway.operate(trigger)
    after = EXPECTED.get((state, trigger))
    if after is not None:
        assert gateway.state is after
        text = f"{state.name.lower()} -> {after.name.lower()} ({trigger})"
        assert [(e.severity, e.source, e.text) for e in output.log] == [(Severity.INFO, "life cycle", text)]
    else:
        assert gateway.state is state
        assert output.frames == ()
        (event,) = output.log
        assert (event.severity, event.source) == (Severity.WARNING, "life cycle")
        assert event.text.startswith(f"{trigger} refused in state {state.name.lower()} (")
        allowed = ", ".join(allowed_triggers(state)) or "nothing"
        assert event.text.endswith(f"; allowed: {allowed}")


@pytest.mark.parametrize("state", list(LifeCycleState))
@pytest.mark.parametrize("trigger", [Trigger.BOARDS_UP, Trigger.BOARDS_LOST, Trigger.FAULT])
def test_an_operator_cannot_give_the_cores_own_triggers(state: LifeCycleState, trigger: Trigger) -> None:
    gateway = HandGateway(make_rig()).to(state)
    output = gateway.operate(trigger)
    assert gateway.state is state
    assert output.frames == ()
    assert "refused" in output.log[0].text


def test_a_refusal_says_what_the_boards_are_doing() -> None:
    gateway = HandGateway(make_rig())
    assert gateway.operate(Trigger.ARM).log[0].text == (
        "arm refused in state offline (adc silent; dac silent); allowed: nothing"
    )


@pytest.mark.parametrize("state", [state for state in LifeCycleState if state is not LifeCycleState.FAULT])
def test_a_fault_latches_from_any_state(state: LifeCycleState) -> None:
    gateway = HandGateway(make_rig()).to(state)
    gateway.core.link_failed("cable")
    assert gateway.state is LifeCycleState.FAULT
    assert gateway.core.fault_reason == "link: cable"
    gateway.periods(50)
    for trigger in sorted(OPERATOR_TRIGGERS - {Trigger.RESET}):
        gateway.operate(trigger)
        assert gateway.state is LifeCycleState.FAULT
    assert gateway.core.fault_reason == "link: cable"


def test_after_a_reset_nothing_moves_before_arm_and_start() -> None:
    gateway = HandGateway(make_rig()).to(LifeCycleState.RUNNING)
    gateway.core.link_failed("cable")
    gateway.operate(Trigger.RESET)
    assert (gateway.state, gateway.core.fault_reason) == (LifeCycleState.OFFLINE, None)
    for step in (None, Trigger.ARM, Trigger.START):
        gateway.told.frames.clear()
        if step is not None:
            gateway.operate(step)
            assert all(volts == (5.0, 5.0, 5.0) for volts in gateway.told.commands())
        gateway.periods(3)
        moved = any(volts != (5.0, 5.0, 5.0) for volts in gateway.told.commands())
        assert moved == (step is Trigger.START)
