"""The live display of a run: observes the run, and sends log entries and a regular status to the terminal.

The process ``hil.views.terminal`` prints them.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic_ns

from hil.core.gateway import Gateway
from hil.core.output import Cycle, LogEntry
from hil.views.display_process import DisplayProcess

STATUS_PERIODS = 18
"""Number of periods from one status to the next, about 0.2 s."""


class LiveDisplay:
    """Observer of a run in real time. Close it before this process prints anything itself."""

    def __init__(self, axes: Sequence[tuple[str, str]]) -> None:
        """``axes``: name and unit of each axis."""
        self._process = DisplayProcess("hil.views.terminal")
        self._max_lateness_ns = 0
        self._start_ns: int | None = None
        """Deadline of the first period, from which displayed times count; None before that period."""
        self._process.send({"axes": axes})

    def log(self, entry: LogEntry) -> None:
        """Show a log entry with the present time."""
        time_s = 0.0 if self._start_ns is None else (monotonic_ns() - self._start_ns) / 1e9
        self._process.send({"log": [time_s, int(entry.severity), entry.source, entry.text]})

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        """Show a status every ``STATUS_PERIODS`` periods, with the largest lateness since the last one."""
        self._max_lateness_ns = max(self._max_lateness_ns, cycle.wake_ns - cycle.deadline_ns)
        if self._start_ns is None:
            self._start_ns = cycle.deadline_ns
        if cycle.number % STATUS_PERIODS:
            return
        self._process.send(
            {
                "state": gateway.state.name.lower(),
                "time_s": (cycle.deadline_ns - self._start_ns) / 1e9,
                "axes": [[s.setpoint, s.position, s.command_v] for s in cycle.axes],
                "max_lateness_ms": self._max_lateness_ns / 1e6,
                "missed": gateway.missed_periods,
                "rejected": gateway.rejected_frames,
            }
        )
        self._max_lateness_ns = 0

    def close(self) -> None:
        """Wait until everything is displayed."""
        self._process.close()
