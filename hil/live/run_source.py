"""The present run as one viewer of the page sees it: what is new to it, and what it has missed."""

from __future__ import annotations

from collections.abc import Mapping
from time import monotonic
from typing import Any

from hil.live.current_run import CurrentRun
from hil.live.history import Rows
from hil.live.operator import DaemonOperator
from hil.live.run import MISSED, Run

MAX_ROWS = 4096
"""Largest number of rows in one message: 0.5 MB for three axes. It is the most that waits for a viewer."""


class RunSource:
    """The present run as one viewer sees it."""

    def __init__(self, current: CurrentRun, operator: DaemonOperator | None) -> None:
        self._current = current
        self._operator = operator
        self._feed_error = ""
        self._follow(current.run)

    def _follow(self, run: Run) -> None:
        """Begin with what is known of ``run``."""
        self._run = run
        self._next_row = run.history.begin
        self._missed = 0
        self._next_log = max(run.log_end - len(run.log), 0)
        self._status: object = None
        self._readings: object = None
        self._bus: object = None
        self._is_over = False
        self._last_s: float | None = None

    def begin(self) -> list[dict[str, Any]]:
        """Return what the run is."""
        return [
            {
                "run": self._run.information,
                "mode": "run",
                "may_operate": self._operator is not None,
            }
        ]

    def take(self) -> tuple[list[dict[str, Any]], Rows]:
        """Return messages and rows that are new since the last call.

        The last message has ``beat_s``, the present time of this process's monotonic clock, which a page
        repeats in a jog; ``age_s``, the age of the viewer's last row in s by the same clock, or None without
        a row; and ``is_behind``, True if there are more rows than one update has.
        """
        messages: list[dict[str, Any]] = []
        if self._current.run is not self._run:
            self._follow(self._current.run)
            messages += self.begin()
        run = self._run
        missed = max(run.history.begin - self._next_row, 0)
        self._missed += missed
        new_entries = run.log_end - self._next_log
        if new_entries:
            messages.append({"log": list(run.log)[-new_entries:]})
            self._next_log = run.log_end
        if run.status and (run.status is not self._status or missed):
            self._status = run.status
            counts = run.status["counts"]
            counts = {**counts, MISSED: counts.get(MISSED, 0) + self._missed}
            messages.append({"status": {**run.status, "counts": counts}})
        if run.bus is not self._bus:
            self._bus = run.bus
            messages.append({"bus": run.bus})
        if run.readings is not self._readings:
            self._readings = run.readings
            messages.append({"readings": run.readings})
        if run.is_over and not self._is_over:
            self._is_over = True
            messages.append({"over": True, "is_awaited": self._current.is_followed})
        if self._current.feed_error != self._feed_error:
            self._feed_error = self._current.feed_error
            messages.append({"feed_error": self._feed_error})
        rows = run.history.since(self._next_row, MAX_ROWS)
        self._next_row = max(self._next_row, run.history.begin) + len(rows)
        if len(rows):
            self._last_s = float(rows[-1, 0])
        messages.append(self._beat())
        return messages, rows

    def _beat(self) -> dict[str, Any]:
        beat_s, age_s = monotonic(), None
        if self._last_s is not None:
            # The loop's deadlines have the same clock: it runs on this machine.
            age_s = max(beat_s - self._run.information["start_ns"] * 1e-9 - self._last_s, 0.0)
        return {"beat_s": beat_s, "age_s": age_s, "is_behind": self._next_row < self._run.history.end}

    async def request(self, request: Mapping[str, Any]) -> dict[str, Any] | None:
        """Pass an operator's request to the daemon."""
        if self._operator is None:
            return {"reply": {"accepted": False, "text": "this page only shows; start it with --operate"}}
        return {"reply": await self._operator.ask(request)}
