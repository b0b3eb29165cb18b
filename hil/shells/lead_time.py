"""The time before a deadline at which the loop wakes up, so that its rehearsal is over in time.

A rehearsal takes 0.1 to 0.5 ms, on a loaded machine and with a small cache more. A fixed time for it would
delay each deadline of a slow machine, and would waste processor time on a fast one. It is therefore measured.
"""

from __future__ import annotations

FIRST_REHEARSAL_NS = 500_000
"""Time for the first rehearsals, before any has been measured."""
FORGETTING_PERIODS = 128
"""Number of periods after which a long rehearsal counts as 1/e of its time, if later ones are shorter."""


class LeadTime:
    """Lead time of the wake-up in nanoseconds, from the longest rehearsal of the last periods."""

    def __init__(self, before_deadline_ns: int, max_rehearsal_ns: int) -> None:
        """``before_deadline_ns`` is the time in which the loop polls. It absorbs a late wake-up.

        ``max_rehearsal_ns`` is the longest time for which a rehearsal brings the wake-up forward; 0 without
        rehearsals.
        """
        self._before_deadline_ns = before_deadline_ns
        self._max_rehearsal_ns = max_rehearsal_ns
        self.rehearsal_ns = min(FIRST_REHEARSAL_NS, max_rehearsal_ns)
        """Longest time that a rehearsal takes, as far as is known."""

    @property
    def ns(self) -> int:
        """Time before a deadline at which the loop must be awake."""
        return self._before_deadline_ns + min(self.rehearsal_ns, self._max_rehearsal_ns)

    def measured(self, rehearsal_ns: int) -> None:
        """Take the time of a rehearsal."""
        self.omitted()
        self.rehearsal_ns = max(rehearsal_ns, self.rehearsal_ns)

    def omitted(self) -> None:
        """Forget some of the longest time, because there was no time for a rehearsal.

        One that took long while the machine stalled would otherwise prevent all later ones.
        """
        self.rehearsal_ns -= self.rehearsal_ns // FORGETTING_PERIODS
