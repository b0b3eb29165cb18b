"""Report to systemd that the loop's periods really run."""

from __future__ import annotations

from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.core.output import Cycle, LogEntry
from hil.operation.systemd import Notifier


class WatchdogObserver:
    """Observer of a run that reports readiness, the state, and that periods complete.

    The daemon is reported ready after its first period. Only completed periods serve the watchdog, at a
    quarter of its time, so that systemd restarts a daemon whose loop hangs.
    """

    def __init__(self, notifier: Notifier) -> None:
        self._notifier = notifier
        self._interval_ns = None if notifier.watchdog_s is None else round(notifier.watchdog_s * 0.25e9)
        self._next_ns = 0
        self._state: LifeCycleState | None = None

    def log(self, entry: LogEntry) -> None:
        """Take a log entry. systemd does not get it."""

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        """Take a completed period."""
        if gateway.state is not self._state:
            ready = ("READY=1",) if self._state is None else ()
            self._state = gateway.state
            self._notifier.send(*ready, f"STATUS={gateway.state.name.lower()}")
        if self._interval_ns is not None and cycle.wake_ns >= self._next_ns:
            self._next_ns = cycle.wake_ns + self._interval_ns
            self._notifier.send("WATCHDOG=1")
