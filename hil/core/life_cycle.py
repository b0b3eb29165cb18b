"""The gateway's life cycle as a table: what may follow what. No behaviour lives here."""

from __future__ import annotations

from enum import IntEnum, StrEnum


class State(IntEnum):
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

TRANSITIONS: dict[tuple[State, Trigger], State] = {
    (State.OFFLINE, Trigger.BOARDS_UP): State.READY,
    (State.READY, Trigger.BOARDS_LOST): State.OFFLINE,
    (State.READY, Trigger.ARM): State.ARMED,
    (State.ARMED, Trigger.START): State.RUNNING,
    (State.ARMED, Trigger.DISARM): State.READY,
    (State.RUNNING, Trigger.STOP): State.ARMED,
    (State.OFFLINE, Trigger.FAULT): State.FAULT,
    (State.READY, Trigger.FAULT): State.FAULT,
    (State.ARMED, Trigger.FAULT): State.FAULT,
    (State.RUNNING, Trigger.FAULT): State.FAULT,
    (State.FAULT, Trigger.RESET): State.OFFLINE,
}


def next_state(state: State, trigger: Trigger) -> State | None:
    """The state after ``trigger``, or None where the table has no such transition."""
    return TRANSITIONS.get((state, trigger))


def allowed_triggers(state: State) -> tuple[Trigger, ...]:
    """What an operator may ask for in ``state``."""
    return tuple(t for (s, t) in TRANSITIONS if s is state and t in OPERATOR_TRIGGERS)
