"""When a board that is not operational is sent NMT start: at once at first, then ever more rarely.

A board that starts normally needs one or two starts. A board that ignores them, or that leaves operational
again and again, would otherwise get a start with every heartbeat.
"""

from __future__ import annotations

IMMEDIATE_STARTS = 3
"""Number of starts that follow one another without waiting."""
FIRST_WAIT_NS = 1_000_000_000
"""Time before the start after the immediate ones. It doubles with every further start."""
MAX_WAIT_NS = 5_000_000_000
"""Longest time between two starts."""
SETTLED_NS = 1_000_000_000
"""Time that a board must stay operational until its earlier starts are forgotten."""


class NmtStarts:
    """The starts of one board. Times are monotonic nanoseconds."""

    def __init__(self) -> None:
        self.sent = 0
        """Number of starts since the board was last operational for ``SETTLED_NS``."""
        self._departures = 0
        """Number of times that the board left operational, in the same time."""
        self._last_ns = 0
        self._operational_since_ns: int | None = None

    @property
    def are_ignored(self) -> bool:
        """True if so many starts were sent that the board must have a reason not to start."""
        return self.sent >= IMMEDIATE_STARTS

    @property
    def are_excessive(self) -> bool:
        """True if the board needed many starts or left operational often, and must settle to count as fit."""
        return self.sent > IMMEDIATE_STARTS or self._departures >= IMMEDIATE_STARTS

    def operational(self, now_ns: int) -> None:
        """Take a heartbeat that says operational."""
        if self._operational_since_ns is None:
            self._operational_since_ns = now_ns
        self._forget_if_settled(now_ns)

    def silent(self) -> None:
        """Take note that the board's heartbeat has timed out."""
        self._operational_since_ns = None

    def should_start(self, now_ns: int) -> bool:
        """Take a heartbeat that does not say operational. Return whether to start the board now."""
        self._forget_if_settled(now_ns)
        self._departures += self._operational_since_ns is not None
        self._operational_since_ns = None
        if self.are_ignored:
            doublings = self.sent - IMMEDIATE_STARTS
            wait_ns = min(FIRST_WAIT_NS << min(doublings, 8), MAX_WAIT_NS)
            return now_ns - self._last_ns >= wait_ns
        return True

    def start_sent(self, now_ns: int) -> None:
        """Count a start that was sent."""
        self.sent += 1
        self._last_ns = now_ns

    def _forget_if_settled(self, now_ns: int) -> None:
        since_ns = self._operational_since_ns
        if since_ns is not None and now_ns - since_ns >= SETTLED_NS:
            self.sent = self._departures = 0
