"""The run that the page shows now: that of one feed, or one after another of a daemon that is restarted."""

from __future__ import annotations

from pathlib import Path
from time import monotonic

from hil.live.feed_file import FeedReader, FeedVersionError, next_feed
from hil.live.run import Run

SEARCH_INTERVAL_S = 0.5
"""Time between two attempts to find the feed of the next run."""


class CurrentRun:
    """The run that is shown. After its end, the next one if there may be one."""

    def __init__(self, feed: Path, *, is_followed: bool) -> None:
        """``feed``: of the run, or with ``is_followed`` a daemon's link to it. Raises OperationError."""
        self._feed = feed
        self.is_followed = is_followed
        """True if the next run of the daemon is shown after the end of this one."""
        self.run = Run(FeedReader(feed))
        self.feed_error = ""
        """Why the next run cannot be shown, although there is one; empty if nothing is wrong."""
        self._next_search_s = 0.0

    def update(self) -> bool:
        """Take what is new in the feed. Return True if another run has begun."""
        if not self.run.is_over:
            self.run.update()
            return False
        return self.is_followed and self._find_next()

    def _find_next(self) -> bool:
        now_s = monotonic()
        if now_s < self._next_search_s:
            return False
        self._next_search_s = now_s + SEARCH_INTERVAL_S
        try:
            feed = next_feed(self._feed)
            self.feed_error = ""
        except FeedVersionError as error:
            feed = None
            self.feed_error = str(error)
        if feed is None:
            return False
        self.run.close()
        self.run = Run(feed)
        return True
