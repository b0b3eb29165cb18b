"""Deadlines of the loop on a fixed grid. Missed deadlines are skipped and counted, never caught up."""

from __future__ import annotations


class PeriodClock:
    """Number, deadline and wake-up time of the present period. Times are monotonic nanoseconds."""

    def __init__(self, period_ns: int, first_deadline_ns: int) -> None:
        self.period_ns = period_ns
        self.next_deadline_ns = first_deadline_ns
        """Time at which the next period begins."""
        self.number = -1
        """Number of the present period, counted from 0 and including skipped periods; -1 before the first."""
        self.deadline_ns = first_deadline_ns
        """Time at which the present period was due."""
        self.wake_ns = 0
        """Time at which the present period began."""
        self.missed_periods = 0
        """Number of periods that were skipped, or passed without SYNC because they began too late."""

    def skipped_periods(self, now_ns: int) -> int:
        """Return how many whole periods have passed since the next deadline, at ``now_ns``."""
        return max((now_ns - self.next_deadline_ns) // self.period_ns, 0)

    def begin_period(self, now_ns: int, skipped: int) -> None:
        """Begin a period at ``now_ns``, after as many skipped ones as :meth:`skipped_periods` says."""
        self.missed_periods += skipped
        self.number += 1 + skipped
        self.deadline_ns = self.next_deadline_ns + skipped * self.period_ns
        self.wake_ns = now_ns
        self.next_deadline_ns = self.deadline_ns + self.period_ns

    def count_missed_period(self) -> None:
        """Count the present period as missed, because it began too late."""
        self.missed_periods += 1

    @property
    def is_very_late(self) -> bool:
        """True if the present period began more than half a period after its deadline."""
        return self.wake_ns - self.deadline_ns > self.period_ns // 2
