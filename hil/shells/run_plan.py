"""What an unattended run asks of the gateway: arm, start, stop in time, end with centred valves."""

from __future__ import annotations

from enum import StrEnum

from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState, Trigger

CENTRING_PERIODS = 3
"""Periods that centred commands are sent for at the end, so that the board applies them in either mode."""


class Ending(StrEnum):
    """Why a run ended."""

    COMPLETED = "completed"
    INTERRUPTED = "interrupted"
    FAULT = "fault"
    NO_BOARDS = "boards did not come up"
    LINK = "link failed"
    ERROR = "internal error"


class StopRequest:
    """Set by a signal handler; the shells look at it once a period."""

    def __init__(self) -> None:
        self.is_set = False

    def set(self, *_signal: object) -> None:
        """Ask the run to end; usable as a signal handler."""
        self.is_set = True


class RunPlan:
    """Consulted once a period; says which trigger to give, and when the run is over."""

    def __init__(self, duration_s: float, period_s: float, bring_up_s: float = 5.0) -> None:
        self.duration_s = duration_s
        self._run_periods = max(round(duration_s / period_s), 1)
        self._bring_up_periods = max(round(bring_up_s / period_s), 1)
        self._periods = 0
        self._started_at: int | None = None
        self._last_periods: int | None = None
        self.ending: Ending | None = None
        """Why the run is ending; None before it does."""

    @property
    def is_over(self) -> bool:
        """Whether the last centred command has been sent."""
        return self._last_periods == 0

    def end(self, ending: Ending) -> None:
        """Begin to end the run; the first reason stays."""
        if self.ending is None:
            self.ending = ending
            self._last_periods = CENTRING_PERIODS

    def fail(self, ending: Ending) -> None:
        """End the run at once; only a fault that came before stays the reason."""
        if self.ending is not Ending.FAULT:
            self.ending = ending
        self._last_periods = 0

    def after_period(self, gateway: Gateway) -> Trigger | None:
        """Count a period that has begun; returns what the operator asks for now."""
        self._periods += 1
        if self._last_periods:
            self._last_periods -= 1
        if gateway.state is LifeCycleState.FAULT:
            self.end(Ending.FAULT)
            return None
        if self.ending is not None:
            return Trigger.STOP if gateway.state is LifeCycleState.RUNNING else None
        if self._started_at is None:
            return self._bring_up(gateway)
        if self._periods - self._started_at > self._run_periods:
            self.end(Ending.COMPLETED)
            return Trigger.STOP
        return None

    def _bring_up(self, gateway: Gateway) -> Trigger | None:
        if gateway.state is LifeCycleState.READY:
            return Trigger.ARM
        if gateway.state is LifeCycleState.ARMED:
            self._started_at = self._periods
            return Trigger.START
        if self._periods > self._bring_up_periods:
            self.end(Ending.NO_BOARDS)
        return None
