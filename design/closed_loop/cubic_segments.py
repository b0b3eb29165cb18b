"""Cubic interpolation between two samples of a response: its value, its turning point, and its crossings.

All functions work on batches of segments, each given by the values and slopes at both ends.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from design.mathematics.polynomials import Array, Indices


class Segments(NamedTuple):
    """Cubics (B,) between neighbouring samples, and the part of each in which a crossing is looked for."""

    time_s: Array
    """Time at which the segment begins."""
    length_s: Array
    v0: Array
    v1: Array
    """Values at the beginning and at the end."""
    d0: Array
    d1: Array
    """Slopes at the beginning and at the end, times the length."""
    begin: Array
    end: Array
    """Bounds of the part in which a crossing is looked for, as shares of the length (0 to 1)."""

    @classmethod
    def zeros(cls, count: int) -> Segments:
        """Return ``count`` segments to be filled in by :meth:`replace`."""
        return cls(*np.zeros((8, count)))

    def replace(self, rows: Indices, segments: Segments) -> None:
        """Replace the segments ``rows`` (k,) by others (k,), in place."""
        for part, values in zip(self, segments, strict=True):
            part[rows] = values

    def at(self, share: Array) -> Array:
        """Return the values (B,) at shares (B,) of the length."""
        rise = self.v1 - self.v0
        bend, twist = 3.0 * rise - 2.0 * self.d0 - self.d1, self.d0 + self.d1 - 2.0 * rise
        return np.asarray(self.v0 + share * (self.d0 + share * (bend + share * twist)))

    def turning_share(self) -> Array:
        """Return the share (B,) of the length at which the slope is 0; its sign must differ at both ends."""
        rise = self.v1 - self.v0
        a, b = 3.0 * (self.d0 + self.d1 - 2.0 * rise), 2.0 * (3.0 * rise - 2.0 * self.d0 - self.d1)
        q = -0.5 * (b + np.copysign(np.sqrt(np.maximum(b * b - 4.0 * a * self.d0, 0.0)), b))
        share = self.d0 / q
        return np.asarray(np.clip(np.where((share >= 0.0) & (share <= 1.0), share, q / a), 0.0, 1.0))

    def crossing_s(self, size: Callable[[Array], Array], limit: float) -> Array:
        """Return the times (B,) at which ``size`` of the value falls to ``limit``, between begin and end.

        ``size`` must be over the limit at the beginning of that part, and not over it at the end. The time is
        found by bisection, and by a straight line over the last interval.
        """
        low, high = self.begin, self.end
        for _ in range(9):
            middle = 0.5 * (low + high)
            is_inside = size(self.at(middle)) <= limit
            low, high = np.where(is_inside, low, middle), np.where(is_inside, middle, high)
        over, under = size(self.at(low)) - limit, limit - size(self.at(high))
        share = np.clip(np.where(over > 0.0, over / (over + under), 0.0), 0.0, 1.0)
        return np.asarray(self.time_s + self.length_s * (low + share * (high - low)))
