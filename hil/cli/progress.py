"""The audience of a lockstep run: warnings, and a bar where the run is long enough to want one."""

from __future__ import annotations

from rich.console import Console
from rich.progress import Progress

from hil.core.gateway import Gateway
from hil.core.output import Cycle, LogEntry, Severity

SHORT_RUN_S = 120.0
UPDATE_PERIODS = 2000


class LockstepProgress:
    """Prints to stderr, from the run's own thread: simulated time waits for it."""

    def __init__(self, duration_s: float) -> None:
        self._progress = Progress(console=Console(stderr=True), disable=duration_s < SHORT_RUN_S)
        self._task = self._progress.add_task("lockstep", total=duration_s)

    def __enter__(self) -> LockstepProgress:
        self._progress.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._progress.stop()

    def log(self, event: LogEntry) -> None:
        """Print what is worse than news."""
        if event.severity > Severity.INFO:
            self._progress.console.print(f"{event.source}: {event.text}", highlight=False, soft_wrap=True)

    def cycle(self, cycle: Cycle, _gateway: Gateway) -> None:
        """Move the bar now and then."""
        if cycle.number % UPDATE_PERIODS == 0:
            self._progress.update(self._task, completed=cycle.deadline_ns / 1e9)
