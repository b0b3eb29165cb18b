"""The periods that the page can show: a ring of rows, from which every viewer takes what is new to it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hil.live.feed_file import HISTORY_S
from hil.live.period_record import Periods

Rows = npt.NDArray[np.float64]

COLUMNS = ("time_s", "lateness_ms", "response_ms", "state", "fresh")
"""Columns of a row before those of the axes: setpoint, position and valve voltage of each."""


class History:
    """The last ten minutes of a run.

    A row is a period; see ``COLUMNS``. A viewer that is slow loses rows, and never makes the ring grow.
    """

    def __init__(self, axes: int, period_s: float, start_ns: int = 0) -> None:
        self._start_ns = start_ns
        self._capacity = round(HISTORY_S / period_s)
        self._rows = np.full((self._capacity, len(COLUMNS) + 3 * axes), np.nan)
        self.end = 0
        """Number of rows that were ever added."""

    def add_periods(self, periods: Periods) -> None:
        """Add periods of the feed, the oldest first."""
        axes = periods["axes"]
        signals = np.stack([axes["setpoint"], axes["position"], axes["command_v"]], axis=2)
        columns = [
            (periods["deadline_ns"] - self._start_ns) * 1e-9,
            (periods["wake_ns"] - periods["deadline_ns"]) * 1e-6,
            (periods["sent_ns"] - periods["wake_ns"]) * 1e-6,
            periods["state"],
            periods["fresh"],
        ]
        self.add_rows(np.column_stack([*columns, signals.reshape(len(periods), -1)]))

    def add_rows(self, rows: Rows) -> None:
        """Add rows with the same columns."""
        kept = rows[-self._capacity :]
        begin = self.end + len(rows) - len(kept)
        self._rows[np.arange(begin, begin + len(kept)) % self._capacity] = kept
        self.end += len(rows)

    @property
    def begin(self) -> int:
        """Number of the oldest row that the ring still holds."""
        return max(self.end - self._capacity, 0)

    def since(self, begin: int, limit: int | None = None) -> Rows:
        """Return the rows from number ``begin`` on, or the oldest ones that the ring still holds.

        ``limit``: largest number of rows.
        """
        begin = max(begin, self.begin)
        end = self.end if limit is None else min(begin + limit, self.end)
        first, last = begin % self._capacity, end % self._capacity
        if end <= begin:
            return self._rows[:0]
        if first < last:
            return self._rows[first:last].copy()
        return np.concatenate([self._rows[first:], self._rows[:last]])
