"""What is read off step responses that come block by block as samples: peaks, settling, rise, error area.

Between samples a response is the cubic of its values and slopes. All is in deviations from the final value,
relative to it. Batched over loops; how a response is followed is in ``step_course``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from design.mathematics.polynomials import Array, Flags, Indices

BAND = 0.02 * (1.0 - 2e-4)
"""Of settling: 2 %, less what a cubic may be off. A search that goes up to a limit lets a late peak touch the
band's edge, and then the peak has to be inside, not the cubic alone."""
_RISE = (0.1, 0.9)


class StepCourse(NamedTuple):
    """Readings (B,) of responses relative to their final values; ∞ where none is or can be told."""

    highest: Array
    lowest: Array
    settled_s: Array
    rise_s: Array
    """From 10 to 90 %."""
    itae: Array
    """∫ t |1 - y| dt in s²."""


class Block(NamedTuple):
    """Evenly spaced samples of some loops; the last sample is the first of the next block."""

    start_s: Array
    """(g,)"""
    spacing_s: Array
    """(g,)"""
    values: Array
    """(g, k)"""
    slopes: Array
    """(g, k), per second."""
    straight: Flags
    """(g,) whether lines are drawn between samples, not cubics."""


class _Piece(NamedTuple):
    """The cubic (B,) from a sample to the next, and the part of it in which a level is crossed, as shares."""

    time_s: Array
    """Where it begins."""
    step_s: Array
    """How long it is."""
    v0: Array
    v1: Array
    """Values at its ends."""
    d0: Array
    d1: Array
    """Slopes there, times its length."""
    begin: Array
    end: Array

    def at(self, share: Array) -> Array:
        """Values (B,) at shares of the length."""
        rise = self.v1 - self.v0
        bend, twist = 3.0 * rise - 2.0 * self.d0 - self.d1, self.d0 + self.d1 - 2.0 * rise
        return np.asarray(self.v0 + share * (self.d0 + share * (bend + share * twist)))


class _Turning(NamedTuple):
    """Turning points between samples (t,): row, sample before, share of the piece after it, and value."""

    row: Indices
    k: Indices
    share: Array
    top: Array


class StepReadings:
    """What has been read so far of B responses that go to 1."""

    def __init__(self, count: int) -> None:
        self.highest, self.lowest = np.full(count, -np.inf), np.full(count, np.inf)
        """Of the response itself, not of its deviation."""
        self.untold = np.zeros(count, dtype=bool)
        """Where settling cannot be told."""
        self._itae = np.zeros(count)
        # Where the band is entered for good, and where 10 and 90 % are first reached.
        self._entered, *self._reached = (_Piece(*np.zeros((8, count))) for _ in range(3))
        self._was_outside = np.zeros(count, dtype=bool)
        self._has_reached = np.zeros((2, count), dtype=bool)

    def course(self) -> StepCourse:
        """The readings, once every response is at rest."""
        settled = np.where(self._was_outside, _crossing(self._entered, np.abs, BAND), 0.0)
        low, high = (
            _crossing(piece, np.negative, 1.0 - level)
            for piece, level in zip(self._reached, _RISE, strict=True)
        )
        rise = np.where(self._has_reached.all(axis=0), high - low, np.inf)
        lost = ~np.isfinite(self.highest) | ~np.isfinite(self.lowest)
        return StepCourse(
            np.where(lost, np.inf, self.highest),
            np.where(lost, -np.inf, self.lowest),
            np.where(self.untold | lost, np.inf, settled),
            np.where(lost, np.inf, rise),
            np.where(self.untold | lost, np.inf, self._itae),
        )

    def extremes(self, loops: Indices, block: Block, final: Array | float) -> _Turning:
        """Raise and lower the extremes by a block of ``loops`` (g,); ``final`` (g,) is what 0 stands for."""
        v, d = block.values, block.slopes * block.spacing_s[:, None]
        highest, lowest = v.max(axis=-1), v.min(axis=-1)
        # Few, so each is found alone.
        row, k = np.nonzero((d[:, :-1] * d[:, 1:] < 0.0) & ~block.straight[:, None])
        piece = self._pieces(block, row, k, 0.0, 1.0)
        share = _turning_share(piece)
        top = piece.at(share)
        np.maximum.at(highest, row, top)
        np.minimum.at(lowest, row, top)
        self.highest[loops] = np.maximum(self.highest[loops], highest + final)
        self.lowest[loops] = np.minimum(self.lowest[loops], lowest + final)
        return _Turning(row, k, share, top)

    def read(self, loops: Indices, block: Block) -> None:
        """Take a block of ``loops`` (g,) into every reading."""
        row, k, share, top = self.extremes(loops, block, 1.0)
        v = block.values
        samples = np.arange(v.shape[-1])
        time_s = block.start_s[:, None] + block.spacing_s[:, None] * samples[:-1]
        self._itae[loops] += (time_s * np.abs(v[:, :-1])).sum(axis=-1) * block.spacing_s

        last = np.where(np.abs(v[:, :-1]) > BAND, samples[:-1], -1).max(axis=-1)
        begin = np.zeros(len(loops))
        later = np.flatnonzero((np.abs(top) > BAND) & (k >= last[row]))
        # In rising order, so that the last of a row stays.
        last[row[later]], begin[row[later]] = k[later], share[later]
        found = np.flatnonzero(last >= 0)
        _keep(self._entered, loops[found], self._pieces(block, found, last[found], begin[found], 1.0))
        self._was_outside[loops[found]] = True

        for reached, has, level in zip(self._reached, self._has_reached, _RISE, strict=True):
            never = len(samples)
            first = np.where(v >= level - 1.0, samples, never).min(axis=-1)
            first, end = np.where(first < never, np.maximum(first - 1, 0), never), np.ones(len(loops))
            sooner = np.flatnonzero((top >= level - 1.0) & (k < first[row]))[::-1]
            first[row[sooner]], end[row[sooner]] = k[sooner], share[sooner]
            found = np.flatnonzero((first < never) & ~has[loops])
            _keep(reached, loops[found], self._pieces(block, found, first[found], 0.0, end[found]))
            has[loops[found]] = True

    @staticmethod
    def _pieces(block: Block, row: Indices, k: Indices, begin: Array | float, end: Array | float) -> _Piece:
        """From sample k of each row on."""
        v0, v1 = block.values[row, k], block.values[row, k + 1]
        spacing_s, straight = block.spacing_s[row], block.straight[row]
        d0, d1 = (np.where(straight, v1 - v0, spacing_s * block.slopes[row, i]) for i in (k, k + 1))
        shares = (share + np.zeros(len(row)) for share in (begin, end))
        return _Piece(block.start_s[row] + k * spacing_s, spacing_s, v0, v1, d0, d1, *shares)


def _keep(kept: _Piece, loops: Indices, found: _Piece) -> None:
    for part, value in zip(kept, found, strict=True):
        part[loops] = value


def _turning_share(piece: _Piece) -> Array:
    """Share (k,) of a piece at which its slope, of different sign at its ends, is 0."""
    rise = piece.v1 - piece.v0
    a, b = 3.0 * (piece.d0 + piece.d1 - 2.0 * rise), 2.0 * (3.0 * rise - 2.0 * piece.d0 - piece.d1)
    q = -0.5 * (b + np.copysign(np.sqrt(np.maximum(b * b - 4.0 * a * piece.d0, 0.0)), b))
    share = piece.d0 / q
    return np.asarray(np.clip(np.where((share >= 0.0) & (share <= 1.0), share, q / a), 0.0, 1.0))


def _crossing(piece: _Piece, size: Callable[[Array], Array], limit: float) -> Array:
    """When (B,), in s, ``size`` falls to the limit in the piece's part, by bisection and a last line."""
    low, high = piece.begin, piece.end
    for _ in range(9):
        middle = 0.5 * (low + high)
        inside = size(piece.at(middle)) <= limit
        low, high = np.where(inside, low, middle), np.where(inside, middle, high)
    over, under = size(piece.at(low)) - limit, limit - size(piece.at(high))
    share = np.clip(np.where(over > 0.0, over / (over + under), 0.0), 0.0, 1.0)
    return np.asarray(piece.time_s + piece.step_s * (low + share * (high - low)))
