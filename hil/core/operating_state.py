"""The gateway's present state in its life cycle, and what a change of state sends and reports."""

from __future__ import annotations

from collections.abc import Callable

from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState, Trigger, allowed_triggers, next_state
from hil.core.output import NOTHING, LogEntry, LogThrottle, Output, Severity, combine

_AIMS = {
    Trigger.ARM: LifeCycleState.ARMED,
    Trigger.START: LifeCycleState.RUNNING,
    Trigger.DISARM: LifeCycleState.READY,
}
"""State that an operator wants to reach with a trigger."""


class OperatingState:
    """Present state and latched fault.

    ``centre`` centres every valve and returns the command that does so. ``throttle`` limits reports that
    may repeat with every frame.
    """

    def __init__(self, centre: Callable[[], Frame], throttle: LogThrottle) -> None:
        self._centre = centre
        self._throttle = throttle
        self.current = LifeCycleState.OFFLINE
        self.fault_reason: str | None = None
        """Source and reason of the fault in state fault, else None."""

    def allows(self, trigger: Trigger) -> bool:
        """Return whether the life cycle has a transition from the present state by ``trigger``."""
        return next_state(self.current, trigger) is not None

    def enter(self, trigger: Trigger, cause: str = "") -> Output:
        """Change the state by a trigger that it allows, and report the change.

        ``cause`` is named in place of the trigger.
        """
        after = next_state(self.current, trigger)
        assert after is not None, f"{trigger} in {self.current}"
        text = f"{self.current.name.lower()} -> {after.name.lower()} ({cause or trigger.value})"
        self.current = after
        if trigger is Trigger.RESET:
            self.fault_reason = None
        return Output(log=(LogEntry(Severity.INFO, "life cycle", text),))

    def fault(self, source: str, reason: str) -> Output:
        """Latch a fault and centre every valve at once. In state fault, only report the further reason."""
        if self.current is LifeCycleState.FAULT:
            return Output(log=(LogEntry(Severity.WARNING, source, reason),))
        self.fault_reason = f"{source}: {reason}"
        entry = LogEntry(Severity.FATAL, source, reason)
        return combine(Output(log=(entry,)), self.enter(Trigger.FAULT), Output((self._centre(),)))

    def lose(self, source: str, reason: str) -> Output:
        """React to the loss of a board or of its samples: a fault once armed, otherwise offline."""
        if self.current in (LifeCycleState.ARMED, LifeCycleState.RUNNING):
            return self.fault(source, reason)
        if self.current is LifeCycleState.FAULT:
            return NOTHING
        report = self._throttle.report(Severity.WARNING, source, reason)
        if self.current is LifeCycleState.READY:
            return combine(report, self.enter(Trigger.BOARDS_LOST))
        return report

    def stop(self, source: str, reason: str) -> Output:
        """Stop the motion for a reason that an operator has given without a request."""
        entry = LogEntry(Severity.WARNING, source, reason)
        return combine(Output(log=(entry,)), self.enter(Trigger.STOP))

    def refuse(self, trigger: Trigger, circumstances: str) -> Output:
        """Report that the state does not allow an operator's trigger."""
        allowed = ", ".join(allowed_triggers(self.current)) or "nothing"
        state = self.current.name.lower()
        if _AIMS.get(trigger) is self.current:
            circumstances = f"it is {state} already"
        elif self.current is LifeCycleState.OFFLINE and trigger is Trigger.ARM:
            circumstances = f"wait for state ready: {circumstances}"
        elif self.fault_reason is not None:
            circumstances = self.fault_reason
        text = f"{trigger.value} refused in state {state} ({circumstances}); allowed: {allowed}"
        return Output(log=(LogEntry(Severity.WARNING, "life cycle", text),))
