"""Several observers of one run."""

from __future__ import annotations

from hil.core.gateway import Gateway
from hil.core.output import Cycle, LogEntry
from hil.shells.session import Observer


class Observers:
    """Passes on log entries and periods to each of several observers, in their order."""

    def __init__(self, *observers: Observer) -> None:
        self._observers = observers

    def log(self, entry: LogEntry) -> None:
        """Pass on a log entry."""
        for observer in self._observers:
            observer.log(entry)

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        """Pass on a completed period of ``gateway``."""
        for observer in self._observers:
            observer.cycle(cycle, gateway)
