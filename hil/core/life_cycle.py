"""The gateway's life cycle as a table of transitions.

The gateway acts on it; this module has no behaviour.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum


class LifeCycleState(IntEnum):
    """State of the gateway.

    A controller moves a valve only in RUNNING; in every other state valves are centred.
    """

    OFFLINE = 0
    """A board is missing or has an error, no good sample has arrived, or a hardware protection is missing."""
    READY = 1
    """Both boards are operational, samples are good, and the emergency stop is closed if there is one."""
    ARMED = 2
    """An operator has allowed motion. The valves are still centred."""
    RUNNING = 3
    """The controllers act on the valves."""
    FAULT = 4
    """A fault has been latched and the valves are centred. Only an operator's reset leaves this state."""


class Trigger(StrEnum):
    """Cause of a transition of the life cycle."""

    BOARDS_UP = "boards up"
    BOARDS_LOST = "boards lost"
    ARM = "arm"
    START = "start"
    STOP = "stop"
    DISARM = "disarm"
    FAULT = "fault"
    RESET = "reset"


OPERATOR_TRIGGERS = frozenset({Trigger.ARM, Trigger.START, Trigger.STOP, Trigger.DISARM, Trigger.RESET})
"""Triggers that an operator gives. The gateway itself causes the others."""

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
"""Every allowed transition: (state, trigger) to the next state."""


def next_state(state: LifeCycleState, trigger: Trigger) -> LifeCycleState | None:
    """Return the state after ``trigger``, or None if the table has no such transition."""
    return TRANSITIONS.get((state, trigger))


def allowed_triggers(state: LifeCycleState) -> tuple[Trigger, ...]:
    """Return the triggers that an operator may give in ``state``."""
    return tuple(trigger for (s, trigger) in TRANSITIONS if s is state and trigger in OPERATOR_TRIGGERS)
