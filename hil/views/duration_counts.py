"""Counts of durations: quantiles and histograms in memory that does not grow with the run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hil.recording.tables import IntArray

MAX_VALUES = 262_144
"""Number of different durations that are kept. More of them are rounded down to 10 ns, 100 ns and so on."""


class DurationCounts:
    """Counts durations in ns. The largest one is exact."""

    def __init__(self) -> None:
        self._values: IntArray = np.empty(0, np.int64)
        """Different durations in ascending order."""
        self._counts: IntArray = np.empty(0, np.int64)
        self._resolution_ns = 1
        self._max_ns = 0

    def __len__(self) -> int:
        return int(self._counts.sum())

    def add(self, durations_ns: npt.NDArray[np.integer]) -> None:
        """Count further durations."""
        if len(durations_ns) == 0:
            return
        largest = int(durations_ns.max())
        self._max_ns = max(self._max_ns, largest) if len(self._values) else largest
        values, counts = np.unique(durations_ns, return_counts=True)
        self._merge(np.concatenate((self._values, values)), np.concatenate((self._counts, counts)))
        while len(self._values) > MAX_VALUES:
            self._resolution_ns *= 10
            self._merge(self._values, self._counts)

    def _merge(self, values: IntArray, counts: IntArray) -> None:
        rounded = values // self._resolution_ns * self._resolution_ns
        self._values, places = np.unique(rounded, return_inverse=True)
        self._counts = np.bincount(places, counts).astype(np.int64)

    @property
    def max_ns(self) -> int:
        """Largest duration; 0 without one."""
        return self._max_ns

    @property
    def min_ns(self) -> int:
        """Smallest duration; 0 without one."""
        return int(self._values[0]) if len(self._values) else 0

    def quantiles_ns(self, parts: Sequence[float]) -> list[int]:
        """Return the smallest durations that at least these parts of all durations do not exceed."""
        cumulated = np.cumsum(self._counts)
        places = np.searchsorted(cumulated, np.array(parts) * cumulated[-1] * (1.0 - 1e-12))
        found = self._values[np.minimum(places, len(self._values) - 1)].tolist()
        return [self._max_ns if part >= 1.0 else value for part, value in zip(parts, found, strict=True)]

    def histogram(self, bins: int, range_us: tuple[float, float]) -> tuple[IntArray, npt.NDArray[np.float64]]:
        """Return the counts in ``bins`` of equal width, and their edges in µs."""
        counts, edges = np.histogram(self._values * 1e-3, bins, range_us, weights=self._counts)
        return counts.astype(np.int64), np.asarray(edges, np.float64)
