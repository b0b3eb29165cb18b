"""The whole course of a step response, from 0 until it is at rest, however slow the loop is.

It is followed in blocks of ever doubled length and step, from its state, until its poles and residues say
that what is left of every mode changes no reading. Where a mode that still rings turns too far between two
samples, the block is sampled finer. A sampled loop is read at its samples. Batched over loops; what is read
off is in ``step_readings``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.closed_loop.step_readings import BAND, Block, StepCourse, StepReadings
from design.mathematics import polynomials as poly
from design.mathematics.matrix_exponential import exponential
from design.mathematics.polynomials import Array, Flags, Indices
from design.models.plant import Sampling
from design.models.realisation import StateSpace, sampled

_FIRST, _MORE = 256, 128
"""Samples of the first block, and of each that follows."""
_TURN = 0.5
"""rad: the most that a mode turns, or decays, between samples; a cubic is then true to 2e-4 of the mode."""
_TRIFLE = 1e-4
"""Relative to the final value: changes no reading."""
_MOST_FINER = 10
"""Doublings of a block's samples: enough for damping of 1e-4. What rings longer has no settling time here."""
_BLURRED = 0.1 * BAND
_BLOCKS = 60
_AT_ONCE = 1 << 19
"""Samples held in memory together."""


class Modes(NamedTuple):
    """Poles of a loop as a response shows them, (B, n) each: rate of growth and speed in 1/s, and size."""

    growth: Array
    speed: Array
    size: Array

    def later(self, loops: Indices, time_s: Array) -> Modes:
        """What is left of some loops (g,) at times (g,)."""
        growth = self.growth[loops]
        size = self.size[loops] * np.exp(np.minimum(growth * time_s[:, None], 0.0))
        return Modes(growth, self.speed[loops], size)

    @property
    def longest_step_s(self) -> Array:
        """Step (B,) over which every mode turns little, or does not matter."""
        steps = np.maximum(_TURN, _TRIFLE / self.size) / self.speed
        return np.asarray(steps.min(axis=-1, initial=np.inf))


def modes(num: Array, den: Array, sampling: Sampling | None, unit: Array) -> Modes:
    """Of step responses of num/den (B, n + 1), in s or the bilinear plane; sizes relative to ``unit`` (B,).

    Poles that coincide get too large a size, never too small: they are followed longer than they need be.
    """
    with np.errstate(all="ignore"):
        p = poly.roots(den)
        apart = p[:, :, None] - p[:, None, :]
        apart[:, np.arange(p.shape[1]), np.arange(p.shape[1])] = 1.0
        residue = poly.at(num, p) / (den[:, :1] * apart.prod(axis=-1) * p)
        growth, speed = p.real, np.abs(p)
        if sampling is not None:
            # z = (1 + pT/2)/(1 - pT/2), and z - 1 for the speed.
            half = 0.5 * sampling.period_s * p
            growth = np.log(np.abs((1.0 + half) / (1.0 - half))) / sampling.period_s
            speed, residue = np.abs(p / (1.0 - half)), residue / (1.0 - half)
        size = np.abs(residue) / unit[:, None]
    return Modes(growth, speed, np.where(size < 1e100, size, 1e100))


def follow(
    loop: StateSpace, final: Array, shown: Modes, sampling: Sampling | None, *, is_effort: bool = False
) -> StepCourse:
    """Unit step responses of stable loops from r to one output, in s or the bilinear plane; B (B, n, 1).

    Output and ``final`` (B,), its last value, are in the unit of the sizes in ``shown``: y is relative to its
    final value, so ``final`` is 1. Of an effort only the extremes are wanted, from whatever it goes to.
    """
    with np.errstate(all="ignore"):
        return _Follower(loop, final, shown, sampling, is_effort).course()


class _Follower:
    """States of the responses' deviations from their final values, and what has been read so far."""

    def __init__(
        self, loop: StateSpace, final: Array, shown: Modes, sampling: Sampling | None, is_effort: bool
    ) -> None:
        A, B, _, _ = loop
        self._final, self._shown, self._is_effort = final, shown, is_effort
        self._is_sampled = sampling is not None
        self._state = _solve(A, B)
        if sampling is None:
            step_s = shown.longest_step_s
            self._step_s = np.where(np.isfinite(step_s) & (step_s > 0.0), step_s, 1.0)
            first, slope, output = exponential(A * self._step_s[:, None, None]), A, loop.C
        else:
            self._step_s = np.full(len(A), sampling.period_s)
            first, _, output, _ = sampled(loop, sampling.period_s)
            slope = (first - np.eye(A.shape[-1])) / sampling.period_s
        self._rows = np.concatenate([output, output @ slope], axis=1)
        self._live: Indices = np.arange(len(A))
        self._powers = [first]
        """M^(2^k), for the loops that are still followed."""
        self._readings = StepReadings(len(A))

    def course(self) -> StepCourse:
        for block in range(_BLOCKS):
            if not len(self._live):
                break
            self._follow_block(block)
        self._readings.untold[self._live] = True
        return self._readings.course()

    def _follow_block(self, block: int) -> None:
        live, count = self._live, _MORE if block else _FIRST
        step_s = self._step_s[live] * 2.0**block
        start_s = count * step_s if block else np.zeros(len(live))
        now = self._shown.later(live, start_s)
        wanted = np.ceil(np.log2(step_s / now.longest_step_s))
        finer = np.where(wanted > 0.0, np.minimum(wanted, block), 0.0).astype(int)
        too_fast = finer > _MOST_FINER
        if too_fast.any():
            unseen = now.speed * step_s[:, None] / 2.0**_MOST_FINER > _TURN
            blurred = np.where(unseen, now.size, 0.0).sum(axis=-1) > _BLURRED
            self._readings.untold[live[too_fast & blurred]] = True
            finer = np.minimum(finer, _MOST_FINER)
        end = self._power(block + count.bit_length() - 1) @ self._state[live]
        for level in np.unique(finer).tolist():
            samples, chosen = count << level, np.flatnonzero(finer == level)
            # A cubic through what is not resolved would be worse than none.
            straight = too_fast | (self._is_sampled and level == block)
            for some in np.array_split(chosen, -(-len(chosen) * samples // _AT_ONCE)):
                values, slopes = self._samples(some, block - level, samples, end)
                piece = Block(start_s[some], step_s[some] / 2.0**level, values, slopes, straight[some])
                if self._is_effort:
                    self._readings.extremes(live[some], piece, self._final[live[some]])
                else:
                    self._readings.read(live[some], piece)
        self._state[live] = end
        left = self._shown.later(live, start_s + count * step_s).size.sum(axis=-1)
        self._keep(~self._at_rest(left) & np.isfinite(end).all(axis=(1, 2)))

    def _at_rest(self, left: Array) -> Flags:
        """Whether nothing that is left (of the live) changes a reading."""
        live = self._live
        highest, lowest = self._readings.highest[live], self._readings.lowest[live]
        if self._is_effort:
            reached = np.maximum(np.abs(highest), np.abs(lowest))
            return np.asarray(np.abs(self._final[live]) + left <= (1.0 + _TRIFLE) * reached)
        return np.asarray((left < BAND) & (1.0 + left <= np.maximum(highest, 1.0 + _TRIFLE)))

    def _samples(self, some: Indices, level: int, count: int, end: Array) -> tuple[Array, Array]:
        """Values and slopes (g, count + 1) of some of the live, 2^level first steps apart."""
        doublings = count.bit_length() - 1
        small = (doublings + 1) // 2
        rows, states = self._rows[self._live[some]], self._state[self._live[some]]
        blocks = rows
        for k in range(doublings):
            power = self._power(level + k)
            power = power if len(some) == len(power) else power[some]
            if k < small:
                blocks = np.concatenate([blocks, blocks @ power], axis=1)
            else:
                states = np.concatenate([states, power @ states], axis=2)
        products = (blocks @ states).reshape(len(some), 1 << small, 2, -1)
        found = products.transpose(2, 0, 3, 1).reshape(2, len(some), count)
        last = (rows @ end[some]).transpose(1, 0, 2)
        values, slopes = np.concatenate([found, last], axis=2)
        return values, slopes

    def _power(self, k: int) -> Array:
        while len(self._powers) <= k:
            self._powers.append(self._powers[-1] @ self._powers[-1])
        return self._powers[k]

    def _keep(self, kept: Flags) -> None:
        if not kept.all():
            self._live = self._live[kept]
            self._powers = [power[kept] for power in self._powers]


def _solve(A: Array, B: Array) -> Array:
    """A^-1 B, the state at 0 as seen from where it comes to rest."""
    try:
        return np.asarray(np.linalg.solve(A, B))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(A) @ B)
