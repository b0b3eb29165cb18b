"""Detect a second node that sends the ADC board's identifier, by counting answers against SYNCs.

The board gives one answer to each SYNC. More answers than SYNCs mean that another node answers too, or
sends without SYNC. The content does not matter: the second node may count as the first one does, or not
count at all. A single surplus answer may be a frame that the bus delivered twice. Only surplus answers in
several periods within a short time are a second sender.
"""

from __future__ import annotations

SURPLUS_PERIODS_LIMIT = 3
"""This many periods with surplus answers mean that a second node sends the same identifier."""
MAX_SURPLUS_PERIODS = 2 * SURPLUS_PERIODS_LIMIT
"""Upper bound of the count, so that a second sender that has gone is forgotten after this many periods."""
MAX_UNANSWERED_SYNCS = 5
"""Upper bound of the SYNCs that may still be answered. Older ones must not hide surplus answers."""


class SurplusAnswers:
    """Count of the periods with surplus answers, less the periods without."""

    def __init__(self) -> None:
        self._unanswered_syncs = 0
        self._is_in_this_period = False
        self._periods = 0

    @property
    def is_suspected(self) -> bool:
        """True if surplus answers came lately."""
        return self._periods > 0

    def begin_period(self) -> None:
        """Begin a period. The one before counts as good if it had no surplus answer."""
        if not self._is_in_this_period:
            self._periods = max(self._periods - 1, 0)
        self._is_in_this_period = False

    def sync_sent(self) -> None:
        """Expect one more answer."""
        self._unanswered_syncs = min(self._unanswered_syncs + 1, MAX_UNANSWERED_SYNCS)

    def answer_received(self) -> bool:
        """Count an undamaged answer, and return whether a second node must be sending.

        The first surplus answer of a period counts. Further ones in that period do not.
        """
        if self._unanswered_syncs > 0:
            self._unanswered_syncs -= 1
        elif not self._is_in_this_period:
            self._is_in_this_period = True
            self._periods = min(self._periods + 1, MAX_SURPLUS_PERIODS)
        return self._periods >= SURPLUS_PERIODS_LIMIT
