"""The loop's side of what people see: a status a few times a second, and every event.

Printed by ``hil.views.watch`` in a process of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

from hil.core.gateway import Gateway
from hil.core.output import Cycle, LogEntry
from hil.views.onlooker import Onlooker

STATUS_PERIODS = 18
"""A status every so many periods, about 0.2 s."""


class Display:
    """An audience in a process of its own. Close it before printing anything else."""

    def __init__(self, axes: Sequence[tuple[str, str]]) -> None:
        """``axes`` are (name, unit)."""
        self._onlooker = Onlooker("hil.views.watch")
        self._worst_lateness_ns = 0
        self._began_ns: int | None = None
        self._onlooker.tell({"axes": axes})

    def log(self, event: LogEntry) -> None:
        """Show an event."""
        self._onlooker.tell({"event": [int(event.severity), event.source, event.text]})

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        """Show a status now and then."""
        self._worst_lateness_ns = max(self._worst_lateness_ns, cycle.wake_ns - cycle.deadline_ns)
        if self._began_ns is None:
            self._began_ns = cycle.deadline_ns
        if cycle.number % STATUS_PERIODS:
            return
        self._onlooker.tell(
            {
                "state": gateway.state.name.lower(),
                "time_s": (cycle.deadline_ns - self._began_ns) / 1e9,
                "axes": [[s.setpoint, s.position, s.command_v] for s in cycle.axes],
                "lateness_ms": self._worst_lateness_ns / 1e6,
                "missed": gateway.missed_periods,
                "rejected": gateway.rejected_frames,
            }
        )
        self._worst_lateness_ns = 0

    def close(self) -> None:
        """Let the display finish what it has, and wait for it."""
        self._onlooker.close()
