"""The life cycle as a table, and the gateway that follows it in every state and for every trigger."""

from __future__ import annotations

import pytest
from support.constants import CENTRED
from support.gateway_bench import SYNC, make_stepped

from hil.core.frames import Frame
from hil.core.life_cycle import (
    OPERATOR_TRIGGERS,
    TRANSITIONS,
    LifeCycleState,
    Trigger,
    allowed_triggers,
    next_state,
)
from hil.core.output import Severity
from hil.core.sync_matching import ANSWER_TIMEOUT_PERIODS
from hil.core.wire import codec

# Written a second time, so that a mistake in the table is found.
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
def test_the_table_has_the_expected_transitions(state: LifeCycleState, trigger: Trigger) -> None:
    assert next_state(state, trigger) is EXPECTED.get((state, trigger))


def test_states_have_the_numbers_in_recordings() -> None:
    assert [(state.name, state.value) for state in LifeCycleState] == [
        ("OFFLINE", 0),
        ("READY", 1),
        ("ARMED", 2),
        ("RUNNING", 3),
        ("FAULT", 4),
    ]


def test_the_table_has_no_other_transition() -> None:
    assert TRANSITIONS == EXPECTED


def test_running_is_entered_only_from_armed_and_fault_left_only_by_reset() -> None:
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
def test_the_triggers_that_an_operator_may_give(state: LifeCycleState, triggers: set[Trigger]) -> None:
    assert set(allowed_triggers(state)) == triggers


@pytest.mark.parametrize(("state", "trigger"), OPERATED)
def test_the_gateway_follows_the_table(state: LifeCycleState, trigger: Trigger) -> None:
    gateway = make_stepped(state)
    output = gateway.operate(trigger)
    after = EXPECTED.get((state, trigger))
    if after is not None:
        assert gateway.state is after
        text = f"{state.name.lower()} -> {after.name.lower()} ({trigger})"
        assert [(e.severity, e.source, e.text) for e in output.log] == [(Severity.INFO, "life cycle", text)]
    else:
        assert gateway.state is state
        assert output.frames == ()
        (entry,) = output.log
        assert (entry.severity, entry.source) == (Severity.WARNING, "life cycle")
        assert entry.text.startswith(f"{trigger} refused in state {state.name.lower()} (")
        allowed = ", ".join(allowed_triggers(state)) or "nothing"
        assert entry.text.endswith(f"; allowed: {allowed}")


@pytest.mark.parametrize("state", list(LifeCycleState))
@pytest.mark.parametrize("trigger", [Trigger.BOARDS_UP, Trigger.BOARDS_LOST, Trigger.FAULT])
def test_an_operator_cannot_give_triggers_of_the_core(state: LifeCycleState, trigger: Trigger) -> None:
    gateway = make_stepped(state)
    output = gateway.operate(trigger)
    assert gateway.state is state
    assert output.frames == ()
    assert "refused" in output.log[0].text


def test_a_refusal_describes_the_boards() -> None:
    gateway = make_stepped()
    assert gateway.operate(Trigger.ARM).log[0].text == (
        "arm refused in state offline (wait for state ready: adc silent; dac silent); allowed: nothing"
    )


@pytest.mark.parametrize("state", [state for state in LifeCycleState if state is not LifeCycleState.FAULT])
def test_a_fault_latches_from_any_state(state: LifeCycleState) -> None:
    gateway = make_stepped(state)
    gateway.core.link_failed("cable")
    assert gateway.state is LifeCycleState.FAULT
    assert gateway.core.fault_reason == "link: cable"
    gateway.periods(50)
    for trigger in sorted(OPERATOR_TRIGGERS - {Trigger.RESET}):
        gateway.operate(trigger)
        assert gateway.state is LifeCycleState.FAULT
    assert gateway.core.fault_reason == "link: cable"


def test_after_a_reset_nothing_moves_before_arm_and_start() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.core.link_failed("cable")
    gateway.operate(Trigger.RESET)
    assert (gateway.state, gateway.core.fault_reason) == (LifeCycleState.OFFLINE, None)
    for step in (None, Trigger.ARM, Trigger.START):
        gateway.transcript.frames.clear()
        if step is not None:
            gateway.operate(step)
            assert all(volts == CENTRED for volts in gateway.transcript.commands())
        gateway.periods(3)
        moved = any(volts != CENTRED for volts in gateway.transcript.commands())
        assert moved == (step is Trigger.START)


def test_a_reset_allows_any_counter_and_new_reports() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.deadline()
    gateway.receive(Frame(codec.TPDO1_ADC, b""))
    gateway.core.link_failed("x")
    gateway.operate(Trigger.RESET)
    gateway.counter -= 1  # the last counter once more
    gateway.periods(ANSWER_TIMEOUT_PERIODS + 1)
    assert gateway.state is LifeCycleState.READY
    gateway.receive(SYNC)
    gateway.operate(Trigger.RESET)
    assert len(gateway.receive(Frame(codec.TPDO1_ADC, b"")).log) == 1
    gateway.receive(SYNC)
    gateway.operate(Trigger.RESET)
    assert len(gateway.receive(Frame(codec.TPDO1_ADC, b"")).log) == 1


def test_stale_periods_in_fault_do_not_count_after_a_reset() -> None:
    gateway = make_stepped(LifeCycleState.FAULT)
    for _ in range(20):
        gateway.deadline()
    gateway.operate(Trigger.RESET)
    gateway.periods(ANSWER_TIMEOUT_PERIODS + 1)
    gateway.operate(Trigger.ARM)
    gateway.deadline()
    gateway.deadline()
    assert gateway.state is LifeCycleState.ARMED
