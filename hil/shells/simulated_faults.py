"""What a shell records of the faults and events of a simulated rig, and the states that it tells the rig."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.core.output import Cycle, LogEntry, Severity
from hil.recording.recorder import BEGINS, EVENT_SOURCE, FAULT_SOURCE


def fault_entry(text: str) -> LogEntry:
    """Return the log entry of a simulated fault that begins."""
    return LogEntry(Severity.WARNING, FAULT_SOURCE, f"{text}{BEGINS}")


def event_entry(text: str) -> LogEntry:
    """Return the log entry of a planned event of the simulated arm that begins."""
    return LogEntry(Severity.INFO, EVENT_SOURCE, f"{text}{BEGINS}")


def faults_by_instant(begun: Iterable[tuple[int, str]], origin_ns: int = 0) -> dict[str, str]:
    """Return faults by the instant at which they began, in seconds from ``origin_ns``, for the metadata.

    ``begun`` has time in nanoseconds and text of each fault. Faults of one instant are joined by spaces.
    """
    joined: dict[str, str] = {}
    for at_ns, text in begun:
        instant = f"{(at_ns - origin_ns) * 1e-9:.4f} s"
        joined[instant] = f"{joined[instant]} {text}" if instant in joined else text
    return joined


class StateReports:
    """Observer that reports each state that ``gateway`` enters, and the first one.

    Each transition has a log entry, so a state is reported even if it lasts for less than a period.
    """

    def __init__(self, gateway: Gateway, report: Callable[[LifeCycleState], None]) -> None:
        self._gateway = gateway
        self._report = report
        self._state: LifeCycleState | None = None

    def log(self, _entry: LogEntry) -> None:
        """Report the state if it has changed."""
        self.update()

    def cycle(self, _cycle: Cycle, _gateway: Gateway) -> None:
        """Report the state if it has changed."""
        self.update()

    def update(self) -> None:
        """Report the state if it has changed."""
        state = self._gateway.state
        if state is not self._state:
            self._state = state
            self._report(state)
