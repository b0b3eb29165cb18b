"""The state alone: what a fault or the loss of a board sends and reports in each state."""

from __future__ import annotations

import pytest

from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.operating_state import OperatingState
from hil.core.output import NOTHING, LogEntry, LogThrottle, Output, Severity

CENTRE = Frame(0x7FF, b"centre")
PATH = {
    LifeCycleState.OFFLINE: (),
    LifeCycleState.READY: (Trigger.BOARDS_UP,),
    LifeCycleState.ARMED: (Trigger.BOARDS_UP, Trigger.ARM),
    LifeCycleState.RUNNING: (Trigger.BOARDS_UP, Trigger.ARM, Trigger.START),
    LifeCycleState.FAULT: (Trigger.FAULT,),
}


def state_at(state: LifeCycleState) -> OperatingState:
    """An operating state in ``state``."""
    operating = OperatingState(lambda: CENTRE, LogThrottle())
    for trigger in PATH[state]:
        operating.enter(trigger)
    assert operating.current is state
    return operating


def entry(severity: Severity, source: str, text: str) -> Output:
    return Output(log=(LogEntry(severity, source, text),))


def change(before: str, after: str, trigger: str) -> LogEntry:
    return LogEntry(Severity.INFO, "life cycle", f"{before} -> {after} ({trigger})")


@pytest.mark.parametrize("state", [s for s in LifeCycleState if s is not LifeCycleState.FAULT])
def test_a_fault_is_latched_and_centres_the_valves(state: LifeCycleState) -> None:
    operating = state_at(state)
    fatal = LogEntry(Severity.FATAL, "bus", "x")
    assert operating.fault("bus", "x") == Output(
        (CENTRE,), (fatal, change(state.name.lower(), "fault", "fault"))
    )
    assert operating.fault_reason == "bus: x"
    assert operating.fault("bus", "y") == entry(Severity.WARNING, "bus", "y")
    assert operating.fault_reason == "bus: x"


def test_a_reset_forgets_the_reason_of_the_fault() -> None:
    operating = state_at(LifeCycleState.RUNNING)
    operating.fault("bus", "x")
    operating.enter(Trigger.RESET)
    assert operating.fault_reason is None


@pytest.mark.parametrize("state", [LifeCycleState.ARMED, LifeCycleState.RUNNING])
def test_a_loss_once_armed_is_a_fault(state: LifeCycleState) -> None:
    operating = state_at(state)
    assert operating.lose("adc", "x").frames == (CENTRE,)
    assert operating.current is LifeCycleState.FAULT
    assert operating.fault_reason == "adc: x"


def test_a_loss_in_ready_leads_to_offline() -> None:
    operating = state_at(LifeCycleState.READY)
    warning = LogEntry(Severity.WARNING, "adc", "x")
    assert operating.lose("adc", "x") == Output(log=(warning, change("ready", "offline", "boards lost")))
    assert operating.current is LifeCycleState.OFFLINE


def test_a_loss_while_offline_is_reported() -> None:
    assert state_at(LifeCycleState.OFFLINE).lose("adc", "x") == entry(Severity.WARNING, "adc", "x")


def test_a_loss_in_fault_is_not_reported() -> None:
    assert state_at(LifeCycleState.FAULT).lose("adc", "x") is NOTHING


@pytest.mark.parametrize(
    ("state", "trigger", "text"),
    [
        (LifeCycleState.ARMED, Trigger.ARM, "arm refused in state armed (it is armed already); allowed: "),
        (LifeCycleState.RUNNING, Trigger.START, "start refused in state running (it is running already); "),
        (LifeCycleState.READY, Trigger.DISARM, "disarm refused in state ready (it is ready already); "),
        (LifeCycleState.FAULT, Trigger.ARM, "arm refused in state fault (adc: silent); allowed: reset"),
    ],
)
def test_a_refusal_says_that_nothing_is_left_to_do_or_which_fault_there_is(
    state: LifeCycleState, trigger: Trigger, text: str
) -> None:
    operating = state_at(LifeCycleState.READY)
    operating.fault("adc", "silent")
    if state is not LifeCycleState.FAULT:
        operating = state_at(state)
    assert operating.refuse(trigger, "boards up").log[0].text.startswith(text)


def test_a_refusal_names_the_state_its_circumstances_and_the_allowed_triggers() -> None:
    operating = state_at(LifeCycleState.ARMED)
    assert not operating.allows(Trigger.STOP)
    text = "stop refused in state armed (boards up); allowed: start, disarm"
    assert operating.refuse(Trigger.STOP, "boards up") == entry(Severity.WARNING, "life cycle", text)
