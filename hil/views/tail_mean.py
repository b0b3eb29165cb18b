"""The mean of the last part of a series whose length is not known before its end."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

MAX_SUMS = 65_536
"""Number of sums that are kept. A longer series is kept as sums over two, four, eight… of its values."""

_NONE: npt.NDArray[np.float64] = np.empty(0)


class TailMean(NamedTuple):
    """A series of values, in memory that does not grow with its length.

    Up to 65,536 values, which are twelve minutes of periods, the mean is exact. Beyond them, the beginning of
    the last fifth is rounded to a multiple of ``size`` values, which is less than 1/6,000 of that fifth.
    """

    sums: npt.NDArray[np.float64] = _NONE
    """Sums over ``size`` consecutive values."""
    size: int = 1
    rest: npt.NDArray[np.float64] = _NONE
    """Last values, which do not fill a sum."""

    def extended(self, values: npt.NDArray[np.float64]) -> TailMean:
        """Return the series with the values that follow."""
        sums, size, rest = self.sums, self.size, np.concatenate((self.rest, values))
        whole = len(rest) - len(rest) % size
        sums = np.concatenate((sums, rest[:whole].reshape(-1, size).sum(axis=1)))
        while len(sums) > MAX_SUMS and len(sums) % 2 == 0:
            sums, size = sums.reshape(-1, 2).sum(axis=1), 2 * size
        return TailMean(sums, size, rest[whole:])

    def mean(self, part: float) -> float:
        """Return the mean of the last ``part`` of the series, of one value at least."""
        count = max(round(part * (len(self.sums) * self.size + len(self.rest))), 1)
        if count <= len(self.rest):
            return float(np.mean(self.rest[-count:]))
        blocks = max(round((count - len(self.rest)) / self.size), 1)
        total = float(np.sum(self.sums[-blocks:]) + np.sum(self.rest))
        return total / (blocks * self.size + len(self.rest))
