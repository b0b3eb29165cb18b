"""What the page knows of a run: its history, log, status and readings."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict
from typing import Any

from hil.live.bus_listener import BusListener
from hil.live.feed_file import FeedReader
from hil.live.history import History
from hil.live.period_record import unpack_periods
from hil.live.readings import readings
from hil.views.summary import min_steps

MAX_LOG_ENTRIES = 500
IDLE_PART = 0.15
"""Part of a period after which the loop has answered: 1.7 ms of 11.2."""
MISSED = "periods that this page missed"
"""Name of the count of periods that the page does not have, because it or its server was too slow."""


class Run:
    """What has been read of a run so far."""

    def __init__(self, feed: FeedReader) -> None:
        """Take what the run is, and begin to listen to its bus."""
        self._feed = feed
        information = asdict(feed.run)
        rig_text = information.pop("rig_text")
        self.information: dict[str, Any] = information
        """``RunInformation`` as a dict, without the text of the rig file."""
        self.history = History(len(feed.run.axes), feed.run.period_s, feed.run.start_ns)
        self.log: deque[list[Any]] = deque(maxlen=MAX_LOG_ENTRIES)
        """The last log entries: time in seconds, severity, source and text."""
        self.log_end = 0
        """Number of log entries that were ever received."""
        self.status: dict[str, Any] = {}
        """Counts, fault, readiness, recording and controllers; another object after each change."""
        self.readings: dict[str, Any] = {}
        """Readings of the last steps; another object after each change."""
        self.bus: dict[str, str] = {}
        """Rates and load of the bus, by their names; another object after each change."""
        self.is_over = False
        self._min_steps = min_steps(rig_text)
        self._lost = 0
        self._bus = BusListener(feed.run.bus, rig_text)

    def update(self) -> None:
        """Take what is new in the feed and on the bus."""
        is_over = self._feed.is_over()  # before the last reading, so that nothing is missed
        messages, lost = self._feed.periods.read()
        self._lost += lost
        if messages:
            self.history.add_periods(unpack_periods(messages, len(self._feed.run.axes)))
        for entry in self._feed.log():
            time_s = (entry.time_ns - self._feed.run.start_ns) * 1e-9
            self.log.append([time_s, entry.severity, entry.source, entry.text])
            self.log_end += 1
        status = self._feed.status()
        if status is not None:
            self.status = {
                "counts": {**status.counts, MISSED: self._lost},
                "fault": status.fault,
                "readiness": status.readiness,
                "recording": status.recording,
                "controllers": status.controllers,
            }
        self.bus = self._bus.take() or self.bus
        self.is_over = is_over
        if is_over:
            self._bus.close()

    def close(self) -> None:
        """Release the feed."""
        self._bus.close()
        self._feed.close()

    def update_readings(self) -> None:
        """Read the last step of every axis."""
        rows = self.history.since(0)
        self.readings = readings(rows, self.information["axes"], self.information["states"], self._min_steps)

    def until_idle_s(self, now_s: float, min_s: float) -> float:
        """Return the time, at least ``min_s``, until the loop has answered and waits for its deadline.

        ``now_s`` is monotonic, as the loop's deadlines are. Work of this process at another time slows the
        answer of loop and boards down: the processors have caches in common, and often a core.
        """
        rows = self.history.since(self.history.end - 1)
        if len(rows) == 0:
            return min_s
        period_s = self._feed.run.period_s
        deadline_s = self._feed.run.start_ns * 1e-9 + float(rows[-1, 0])
        return min_s + (deadline_s + IDLE_PART * period_s - now_s - min_s) % period_s
