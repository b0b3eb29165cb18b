"""What a run in lockstep shows: warnings, and a progress bar if the run is long."""

from __future__ import annotations

from rich.console import Console
from rich.progress import Progress

from hil.core.gateway import Gateway
from hil.core.output import Cycle, LogEntry, Severity

MIN_DURATION_S = 120.0
"""Shortest run, in simulated seconds, that gets a progress bar."""
UPDATE_PERIODS = 2000
"""Number of periods from one update of the bar to the next."""


class LockstepProgress:
    """Observer of a run in lockstep. It prints to stderr while the simulated time waits."""

    def __init__(self, duration_s: float) -> None:
        self._progress = Progress(
            console=Console(stderr=True, markup=False, highlight=False), disable=duration_s < MIN_DURATION_S
        )
        self._task = self._progress.add_task("lockstep", total=duration_s)
        self._time_s = 0.0
        """Simulated time of the last period, from the start of the run."""

    def __enter__(self) -> LockstepProgress:
        self._progress.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._progress.stop()

    def log(self, entry: LogEntry) -> None:
        """Print a warning or an error with the simulated time; other entries are only recorded."""
        if entry.severity > Severity.INFO:
            line = f"{self._time_s:9.2f} s  {entry.source}: {entry.text}"
            self._progress.console.print(line, soft_wrap=True)

    def cycle(self, cycle: Cycle, _gateway: Gateway) -> None:
        """Note the time, and move the bar every ``UPDATE_PERIODS`` periods."""
        self._time_s = cycle.deadline_ns / 1e9
        if cycle.number % UPDATE_PERIODS == 0:
            self._progress.update(self._task, completed=self._time_s)
