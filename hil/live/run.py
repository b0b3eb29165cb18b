"""What the page knows of a run: its history, log, status and readings."""

from __future__ import annotations

import json
from collections import deque
from typing import Any

from hil.live.bus_listener import listen
from hil.live.feed import PERIODS
from hil.live.history import History

MAX_LOG_ENTRIES = 500


class Run:
    """What has been received of a run so far."""

    def __init__(self) -> None:
        self.information: dict[str, Any] | None = None
        """``feed.RunInformation`` as a dict; None until the run is known."""
        self.history: History | None = None
        self.log: deque[list[Any]] = deque(maxlen=MAX_LOG_ENTRIES)
        """The last log entries: time in seconds, severity, source and text."""
        self.log_end = 0
        """Number of log entries that were ever received."""
        self.status: dict[str, Any] = {}
        """Counts, fault and readiness; another object after each change."""
        self.readings: dict[str, Any] = {}
        """Readings of the last steps; another object after each change."""
        self.bus: dict[str, str] = {}
        """Rates and load of the bus, by their names; another object after each change."""
        self.is_over = False

    def begin(self, information: dict[str, Any]) -> None:
        """Take what the run is."""
        self.information = information
        self.history = History(len(information["axes"]), information["period_s"], information["start_ns"])

    def end(self) -> None:
        """Take note that the run has ended."""
        self.is_over = True

    def log_entry(self, time_s: float, severity: int, source: str, text: str) -> None:
        """Add a log entry."""
        self.log.append([time_s, severity, source, text])
        self.log_end += 1

    def take_message(self, message: bytes) -> None:
        """Take a message of the feed."""
        if message.startswith(PERIODS):
            if self.history is not None:
                self.history.add_message(message[len(PERIODS) :])
            return
        content = json.loads(message)
        if "run" in content:
            rig_text = content["run"].pop("rig_text")
            self.begin(content["run"])
            listen(content["run"]["bus"], rig_text, self._take_bus)
        elif "log" in content:
            time_ns, severity, source, text = content["log"]
            start_ns = self.information["start_ns"] if self.information else time_ns
            self.log_entry((time_ns - start_ns) * 1e-9, severity, source, text)
        else:
            self.status = content

    def _take_bus(self, counts: dict[str, str]) -> None:
        """Take the counts of the listener, which is another thread."""
        self.bus = counts

    def update_readings(self) -> None:
        """Read the last step of every axis."""
        if self.history is None or self.information is None:
            return
        from hil.live.readings import readings

        rows = self.history.since(0)
        self.readings = readings(rows, self.information["axes"], self.information["states"])
