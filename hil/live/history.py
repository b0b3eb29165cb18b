"""The periods that the page can show: a ring of rows, from which every viewer takes what is new to it."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hil.live.feed import period_format

Rows = npt.NDArray[np.float64]

COLUMNS = ("time_s", "lateness_ms", "response_ms", "state", "fresh")
"""Columns of a row before those of the axes: setpoint, position and valve voltage of each."""
HISTORY_S = 600.0
"""Time that the ring holds."""


class History:
    """The last ten minutes of a run.

    A row is a period; see ``COLUMNS``. A viewer that is slow loses rows, and never makes the ring grow.
    """

    def __init__(self, axes: int, period_s: float, start_ns: int = 0) -> None:
        self._format = struct.Struct(period_format(axes))
        self._start_ns = start_ns
        self._capacity = round(HISTORY_S / period_s)
        self._rows = np.full((self._capacity, len(COLUMNS) + 3 * axes), np.nan)
        self.end = 0
        """Number of rows that were ever added."""

    def add_message(self, message: bytes) -> None:
        """Add the periods of a message of the feed, without its first byte."""
        for deadline_ns, wake_ns, done_ns, state, fresh, *signals in self._format.iter_unpack(message):
            self._rows[self.end % self._capacity] = (
                (deadline_ns - self._start_ns) * 1e-9,
                (wake_ns - deadline_ns) * 1e-6,
                (done_ns - wake_ns) * 1e-6,
                state,
                fresh,
                *signals,
            )
            self.end += 1

    def add_row(self, row: Sequence[float]) -> None:
        """Add a row of the same columns."""
        self._rows[self.end % self._capacity] = row
        self.end += 1

    def since(self, begin: int) -> Rows:
        """Return the rows from number ``begin`` on, or the oldest ones that the ring still holds."""
        begin = max(begin, self.end - self._capacity, 0)
        return self._rows[np.arange(begin, self.end) % self._capacity]
