"""The plans of a run: which triggers a shell gives by itself, and how the run ends with centred valves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from enum import StrEnum

from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.requests import ArmRequest, CheckFailure, arm_request

CENTRING_PERIODS = 3
"""Number of periods in which the centring command is sent at the end.

The board then applies it in either of its modes (at SYNC or at once).
"""


class Ending(StrEnum):
    """Reason why a run ended."""

    COMPLETED = "completed"
    INTERRUPTED = "interrupted"
    FAULT = "fault"
    START_REFUSED = "start was refused"
    RELEASED = "enable switch was released"
    """The gateway stopped the motion, because an operator has released the enable switch."""
    NO_BOARDS = "boards did not come up"
    LINK = "link failed"
    ERROR = "internal error"


class StopRequest:
    """Request to end a run, set by a signal handler. The shells read it once per period."""

    def __init__(self) -> None:
        self.is_set = False
        self.signal: int | None = None
        """Number of the signal that has asked, if it was one."""

    def set(self, signal: int | None = None, _frame: object = None) -> None:
        """Request the end of the run. Usable as a signal handler."""
        self.is_set = True
        self.signal = signal


class Plan(ABC):
    """The triggers that a shell gives by itself, and the end of the run."""

    def __init__(self) -> None:
        self._remaining_periods: int | None = None
        """Number of periods left after the run has begun to end; None before."""
        self.ending: Ending | None = None
        """Reason why the run ends; None before it begins to end."""

    @property
    def is_over(self) -> bool:
        """True if the last centring command has been sent."""
        return self._remaining_periods == 0

    def end(self, ending: Ending) -> None:
        """Begin to end the run. If it is ending already, the first reason stays."""
        if self.ending is None:
            self.ending = ending
            self._remaining_periods = CENTRING_PERIODS

    def fail(self, ending: Ending) -> None:
        """End the run at once. Only an earlier fault stays as the reason."""
        if self.ending is not Ending.FAULT:
            self.ending = ending
        self._remaining_periods = 0

    def after_period(self, gateway: Gateway) -> Trigger | ArmRequest | None:
        """Count a period that has begun, and return the request to give to ``gateway`` now, if any."""
        if self._remaining_periods:
            self._remaining_periods -= 1
        return self._next_trigger(gateway)

    @abstractmethod
    def _next_trigger(self, gateway: Gateway) -> Trigger | ArmRequest | None:
        """Return the request to give to ``gateway`` in the period that has begun, if any."""

    def _stop(self, gateway: Gateway) -> Trigger | None:
        """Return the trigger that ends the motion of a run that ends."""
        return Trigger.STOP if gateway.state is LifeCycleState.RUNNING else None


class OperatorPlan(Plan):
    """The plan of a daemon: an operator gives every trigger, and only a request to stop ends the run.

    A fault does not end the run. It stays latched until the operator resets it.
    """

    def _next_trigger(self, gateway: Gateway) -> Trigger | None:
        return None if self.ending is None else self._stop(gateway)


class RunPlan(Plan):
    """The plan of a run without an operator: arm, start, and stop after a time."""

    def __init__(
        self, duration_s: float, period_s: float, bring_up_s: float = 5.0, overrides: Sequence[str] = ()
    ) -> None:
        """The boards may take ``bring_up_s`` to come up. From the start on, the run lasts ``duration_s``.

        ``overrides`` are names of checks that do not keep the gateway from arming if they fail.
        """
        super().__init__()
        self._overrides = tuple(overrides)
        self._arm = arm_request((), self._overrides)
        self._has_asked_to_arm = False
        self.duration_s = duration_s
        self._run_periods = max(round(duration_s / period_s), 1)
        self._bring_up_periods = max(round(bring_up_s / period_s), 1)
        self._periods = 0
        self._started_at_period: int | None = None

    def take_failures(self, failures: tuple[CheckFailure, ...]) -> None:
        """Take the checks of this machine that have failed, for the request to arm."""
        self._arm = arm_request(failures, self._overrides)

    def _next_trigger(self, gateway: Gateway) -> Trigger | ArmRequest | None:
        self._periods += 1
        if gateway.state is LifeCycleState.FAULT:
            self.end(Ending.FAULT)
            return None
        if self.ending is not None:
            return self._stop(gateway)
        if self._started_at_period is None:
            return self._bring_up(gateway)
        if gateway.state is not LifeCycleState.RUNNING:
            has_run = self._periods - self._started_at_period > 1
            self.end(Ending.RELEASED if has_run else Ending.START_REFUSED)
            return None
        is_done = gateway.experiment is not None and gateway.experiment.is_done
        if is_done or self._periods - self._started_at_period > self._run_periods:
            self.end(Ending.COMPLETED)
            return Trigger.STOP
        return None

    def _bring_up(self, gateway: Gateway) -> Trigger | ArmRequest | None:
        if gateway.state is LifeCycleState.READY:
            if self._has_asked_to_arm:
                self.end(Ending.START_REFUSED)
                return None
            self._has_asked_to_arm = True
            return self._arm
        if gateway.state is LifeCycleState.ARMED:
            self._started_at_period = self._periods
            return Trigger.START
        if self._periods > self._bring_up_periods:
            self.end(Ending.NO_BOARDS)
        return None
