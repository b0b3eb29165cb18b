"""Readings of step responses: extremes, settling time, rise time and time-weighted error.

Responses arrive block by block, as samples with slopes (from :mod:`design.closed_loop.step_simulation`).
Between two samples a response is the cubic of their values and slopes. All values are deviations from the
final value, relative to it: the response itself begins at -1 and ends at 0. Everything is batched over loops.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.closed_loop.cubic_segments import Segments
from design.mathematics.polynomials import Array, Flags, Indices

BAND = 0.02 * (1.0 - 2e-4)
"""Half-width of the settling band, relative to the final value: 2 %, less the error of the cubic.

A search drives a late peak to the edge of the band. The peak itself must then lie inside, not only its cubic.
"""
_RISE_LEVELS = (0.1, 0.9)
"""Shares of the final value between which the rise time is measured."""


class StepReadings(NamedTuple):
    """Readings (B,) of responses, relative to their final values; ∞ where a reading does not exist."""

    highest: Array
    """Largest value of the response; 1 is its final value."""
    lowest: Array
    """Smallest value of the response."""
    settling_s: Array
    """Time after which the response stays within 2 % of its final value."""
    rise_s: Array
    """Time from 10 % to 90 % of the final value."""
    itae: Array
    """Integral of t |1 - y| dt in s² (integral of time-weighted absolute error)."""


class SampleBlock(NamedTuple):
    """Evenly spaced samples of g responses; the last sample is the first of the next block."""

    start_s: Array
    """Time of the first sample (g,)."""
    spacing_s: Array
    """Time between samples (g,)."""
    values: Array
    """Deviations from the final value (g, k)."""
    slopes: Array
    """Slopes (g, k) per second."""
    is_linear: Flags
    """True (g,) where straight lines connect the samples instead of cubics."""

    def segments(self, row: Indices, k: Indices, begin: Array | float, end: Array | float) -> Segments:
        """Return the segments (t,) that begin at sample ``k`` (t,) of response ``row`` (t,)."""
        v0, v1 = self.values[row, k], self.values[row, k + 1]
        spacing_s, is_linear = self.spacing_s[row], self.is_linear[row]
        d0, d1 = (np.where(is_linear, v1 - v0, spacing_s * self.slopes[row, i]) for i in (k, k + 1))
        shares = (share + np.zeros(len(row)) for share in (begin, end))
        return Segments(self.start_s[row] + k * spacing_s, spacing_s, v0, v1, d0, d1, *shares)


class _TurningPoints(NamedTuple):
    """Extremes (t,) between samples."""

    row: Indices
    """Response in which the turning point lies."""
    k: Indices
    """Sample before the turning point."""
    share: Array
    """Share of the segment after that sample at which the turning point lies."""
    value: Array


class ReadingCollector:
    """The readings of B responses, brought up to date with each block of samples."""

    def __init__(self, count: int) -> None:
        self.highest, self.lowest = np.full(count, -np.inf), np.full(count, np.inf)
        """Extremes (B,) of the responses so far; 1 is the final value."""
        self._is_unresolved = np.zeros(count, dtype=bool)
        self._itae = np.zeros(count)
        self._band_entry = Segments.zeros(count)
        self._has_left_band = np.zeros(count, dtype=bool)
        self._level_crossings = tuple(Segments.zeros(count) for _ in _RISE_LEVELS)
        self._has_crossed = np.zeros((len(_RISE_LEVELS), count), dtype=bool)

    def mark_unresolved(self, loops: Indices) -> None:
        """Record that the settling time and the ITAE of ``loops`` cannot be determined."""
        self._is_unresolved[loops] = True

    def add_extremes(self, loops: Indices, block: SampleBlock, final: Array | float) -> _TurningPoints:
        """Bring the extremes of ``loops`` (g,) up to date; ``final`` (g,) is the value at deviation 0."""
        v, d = block.values, block.slopes * block.spacing_s[:, None]
        highest, lowest = v.max(axis=-1), v.min(axis=-1)
        row, k = np.nonzero((d[:, :-1] * d[:, 1:] < 0.0) & ~block.is_linear[:, None])
        segments = block.segments(row, k, 0.0, 1.0)
        share = segments.turning_share()
        value = segments.at(share)
        np.maximum.at(highest, row, value)
        np.minimum.at(lowest, row, value)
        self.highest[loops] = np.maximum(self.highest[loops], highest + final)
        self.lowest[loops] = np.minimum(self.lowest[loops], lowest + final)
        return _TurningPoints(row, k, share, value)

    def add(self, loops: Indices, block: SampleBlock) -> None:
        """Bring every reading of ``loops`` (g,) up to date with a block of their samples."""
        turning = self.add_extremes(loops, block, 1.0)
        self._add_error(loops, block)
        self._find_band_entry(loops, block, turning)
        for i in range(len(_RISE_LEVELS)):
            self._find_level_crossing(i, loops, block, turning)

    def readings(self) -> StepReadings:
        """Return the readings, once every response has been followed to its end."""
        settling = np.where(self._has_left_band, self._band_entry.crossing_s(np.abs, BAND), 0.0)
        low, high = (
            segments.crossing_s(np.negative, 1.0 - level)
            for segments, level in zip(self._level_crossings, _RISE_LEVELS, strict=True)
        )
        rise = np.where(self._has_crossed.all(axis=0), high - low, np.inf)
        is_lost = ~np.isfinite(self.highest) | ~np.isfinite(self.lowest)
        return StepReadings(
            np.where(is_lost, np.inf, self.highest),
            np.where(is_lost, -np.inf, self.lowest),
            np.where(self._is_unresolved | is_lost, np.inf, settling),
            np.where(is_lost, np.inf, rise),
            np.where(self._is_unresolved | is_lost, np.inf, self._itae),
        )

    def _add_error(self, loops: Indices, block: SampleBlock) -> None:
        """Add the block's part of the ITAE, as a sum over its samples."""
        before_end = np.abs(block.values[:, :-1])
        time_s = block.start_s[:, None] + block.spacing_s[:, None] * np.arange(before_end.shape[-1])
        self._itae[loops] += (time_s * before_end).sum(axis=-1) * block.spacing_s

    def _find_band_entry(self, loops: Indices, block: SampleBlock, turning: _TurningPoints) -> None:
        """Remember where a response was last outside the settling band, if it was so in this block."""
        outside = np.abs(block.values[:, :-1]) > BAND
        last = np.where(outside, np.arange(outside.shape[-1]), -1).max(axis=-1)
        begin = np.zeros(len(loops))
        # A turning point outside the band counts too. They come in rising order, so that the last one
        # remains.
        later = np.flatnonzero((np.abs(turning.value) > BAND) & (turning.k >= last[turning.row]))
        last[turning.row[later]], begin[turning.row[later]] = turning.k[later], turning.share[later]
        found = np.flatnonzero(last >= 0)
        self._band_entry.replace(loops[found], block.segments(found, last[found], begin[found], 1.0))
        self._has_left_band[loops[found]] = True

    def _find_level_crossing(
        self, i: int, loops: Indices, block: SampleBlock, turning: _TurningPoints
    ) -> None:
        """Remember where a response first reaches the rise level ``i``, if it does so in this block."""
        deviation = _RISE_LEVELS[i] - 1.0
        count = block.values.shape[-1]
        first = np.where(block.values >= deviation, np.arange(count), count).min(axis=-1)
        first, end = np.where(first < count, np.maximum(first - 1, 0), count), np.ones(len(loops))
        # A turning point may reach the level sooner. In falling order, the first one remains.
        sooner = np.flatnonzero((turning.value >= deviation) & (turning.k < first[turning.row]))[::-1]
        first[turning.row[sooner]], end[turning.row[sooner]] = turning.k[sooner], turning.share[sooner]
        found = np.flatnonzero((first < count) & ~self._has_crossed[i, loops])
        self._level_crossings[i].replace(loops[found], block.segments(found, first[found], 0.0, end[found]))
        self._has_crossed[i, loops[found]] = True
