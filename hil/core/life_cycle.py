"""The gateway's life cycle as a table: what may follow what. No behaviour lives here."""

from __future__ import annotations

from enum import IntEnum, StrEnum


class LifeCycleState(IntEnum):
    """States of the gateway. Only RUNNING lets a controller move a valve; elsewhere valves are centred."""

    OFFLINE = 0
    """The boards are not all up."""
    READY = 1
    """Boards operational, samples good."""
    ARMED = 2
    """An operator has allowed motion; valves still centred."""
    RUNNING = 3
    """Controllers act on the valves."""
    FAULT = 4
    """Latched; valves centred; leaves by an operator's reset alone."""


class Trigger(StrEnum):
    """What moves the life cycle."""

    BOARDS_UP = "boards up"
    BOARDS_LOST = "boards lost"
    ARM = "arm"
    START = "start"
    STOP = "stop"
    DISARM = "disarm"
    FAULT = "fault"
    RESET = "reset"


OPERATOR_TRIGGERS = frozenset({Trigger.ARM, Trigger.START, Trigger.STOP, Trigger.DISARM, Trigger.RESET})

TRANSITIONS: dict[tuple[LifeCycleState, Trigger], LifeCycleState] = {
    (LifeCycleState.OFFLINE, Trigger.BOARDS_UP): LifeCycleState.READY,
    (LifeCycleState.READY, Trigger.BOARDS_LOST): LifeCycleState.OFFLINE,
    (LifeCycleState.READY, Trigger.ARM): LifeCycleState.ARMED,
    (LifeCycleState.ARMED, Trigger.START): LifeCycleState.RUNNING,
    (LifeCycleState.ARMED, Trigger.DISARM): LifeCycleState.READY,
    (LifeCycleState.RUNNING, Trigger.STOP): LifeCycleState.ARMED,
    (LifeCycleState.OFFLINE, Trigger.FAULT): LifeCycleState.FAULT,
    (LifeCycleState.READY, Trigger.FAULT): LifeCycleState.FAULT,
    (LifeCycleState.ARMED, Trigger.FAULT): LifeCycleState.FAULT,
    (LifeCycleState.RUNNING, Trigger.FAULT): LifeCycleState.FAULT,
    (LifeCycleState.FAULT, Trigger.RESET): LifeCycleState.OFFLINE,
}


def next_state(state: LifeCycleState, trigger: Trigger) -> LifeCycleState | None:
    """The state after ``trigger``, or None where the table has no such transition."""
    return TRANSITIONS.get((state, trigger))


def allowed_triggers(state: LifeCycleState) -> tuple[Trigger, ...]:
    """What an operator may ask for in ``state``."""
    return tuple(t for (s, t) in TRANSITIONS if s is state and t in OPERATOR_TRIGGERS)
