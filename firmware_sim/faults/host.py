"""Faults of the computer on which the gateway runs, for simulated time."""

from __future__ import annotations


class HostTiming:
    """The gateway's process as the lockstep shell sees it: whether it runs, and what its wall clock shows."""

    def __init__(self) -> None:
        self.asleep_until_ns = 0
        """Time until which the process does not run. Frames wait for it, and deadlines are served late."""
        self.clock_offset_ns = 0
        """Difference of the wall clock from the simulated time, by which receive stamps are shifted."""

    def stall(self, now_ns: int, duration_ns: int) -> None:
        """Stop the process for ``duration_ns`` from now; a longer stall that has begun already stays."""
        self.asleep_until_ns = max(self.asleep_until_ns, now_ns + duration_ns)

    def step_clock(self, step_ns: int) -> None:
        """Set the wall clock forward by ``step_ns``, or back if it is negative."""
        self.clock_offset_ns += step_ns
