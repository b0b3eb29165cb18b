"""Step responses followed from time 0 until they are at rest, however slow the loop is.

A response is computed in blocks. The first block has 256 samples; each later block has 128 samples, twice as
far apart, and lasts as long as all blocks before it. The state at the end of a block is carried over exactly.
Where a mode that still matters turns too far between two samples, the block is sampled more finely. A
response is at rest when its poles and residues say that what is left of every mode changes no reading.

A sampled loop is read at its samples only. Everything is batched over loops; what is read off the samples is
in :mod:`design.closed_loop.step_readings`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.closed_loop.step_readings import BAND, ReadingCollector, SampleBlock, StepReadings
from design.mathematics import polynomials as poly
from design.mathematics.matrix_exponential import exponential
from design.mathematics.polynomials import Array, Flags, Indices
from design.models.realisation import StateSpace, tustin
from design.models.sampling import Sampling

_FIRST_SAMPLES, _LATER_SAMPLES = 256, 128
"""Samples of the first block, and of each later block."""
_MAX_TURN = 0.5
"""Largest angle in rad by which a mode may turn, or decay, between samples.

The cubic between samples is then within 2e-4 of the mode.
"""
_NEGLIGIBLE = 1e-4
"""Size of a mode, relative to the final value, below which it changes no reading."""
_MAX_REFINEMENT = 10
"""Largest number of times that the samples of a block are doubled.

This resolves modes with a damping ratio of 1e-4 or more. A mode with less damping has no settling time here.
"""
_UNRESOLVED = 0.1 * BAND
"""Size of the unresolved modes together beyond which a settling time cannot be determined."""
_MAX_BLOCKS = 60
"""Largest number of blocks, each of which doubles the time that has been simulated."""
_MAX_SAMPLES = 1 << 19
"""Largest number of samples in memory at a time."""


class Modes(NamedTuple):
    """The modes of B step responses, each array (B, n)."""

    growth: Array
    """Rates of growth in 1/s; negative for a decaying mode."""
    speed: Array
    """Moduli of the poles in 1/s."""
    size: Array
    """Sizes at time 0, relative to the final value."""

    def later(self, loops: Indices, time_s: Array) -> Modes:
        """Return the modes of some loops (g,) as they are at times (g,)."""
        growth = self.growth[loops]
        size = self.size[loops] * np.exp(np.minimum(growth * time_s[:, None], 0.0))
        return Modes(growth, self.speed[loops], size)

    @property
    def longest_step_s(self) -> Array:
        """Longest time (B,) between samples in which every mode turns little, or is negligible."""
        steps = np.maximum(_MAX_TURN, _NEGLIGIBLE / self.size) / self.speed
        return np.asarray(steps.min(axis=-1, initial=np.inf))


def modes(num: Array, den: Array, sampling: Sampling | None, unit: Array) -> Modes:
    """Return the modes of the step responses of num/den (B, n + 1), in s or in the bilinear plane.

    Sizes are relative to ``unit`` (B,). Poles that coincide get sizes that are too large, never too small, so
    that they are followed for longer than necessary.
    """
    with np.errstate(all="ignore"):
        p = poly.roots(den)
        apart = p[:, :, None] - p[:, None, :]
        apart[:, np.arange(p.shape[1]), np.arange(p.shape[1])] = 1.0
        residue = poly.at(num, p) / (den[:, :1] * apart.prod(axis=-1) * p)
        growth, speed = p.real, np.abs(p)
        if sampling is not None:
            # The pole in z is (1 + pT/2)/(1 - pT/2); its distance from 1 is the speed.
            half = 0.5 * sampling.period_s * p
            growth = np.log(np.abs((1.0 + half) / (1.0 - half))) / sampling.period_s
            speed, residue = np.abs(p / (1.0 - half)), residue / (1.0 - half)
        size = np.abs(residue) / unit[:, None]
    return Modes(growth, speed, np.where(size < 1e100, size, 1e100))


def simulate_steps(
    loop: StateSpace,
    final: Array,
    loop_modes: Modes,
    sampling: Sampling | None,
    *,
    extremes_only: bool = False,
) -> StepReadings:
    """Return the readings (B,) of the unit step responses of stable loops.

    ``loop`` leads from r to one output, in s or in the bilinear plane, with B (B, n, 1). The output and its
    last value ``final`` (B,) are in the unit of the sizes in ``loop_modes``. For y, this unit is the final
    value, so that ``final`` is 1. With ``extremes_only``, for the manipulated variable, only ``highest`` and
    ``lowest`` are read, and ``final`` may be anything.
    """
    with np.errstate(all="ignore"):
        return _Simulation(loop, final, loop_modes, sampling, extremes_only).run()


class _Span(NamedTuple):
    """The time that a block covers, for the g loops that are still simulated."""

    start_s: Array
    step_s: Array
    """Time between samples (g,) before any refinement."""
    samples: int

    @property
    def end_s(self) -> Array:
        return self.start_s + self.samples * self.step_s


class _Refinement(NamedTuple):
    """How much more finely g loops are sampled than their block provides."""

    doublings: Indices
    """How often (g,) the number of samples is doubled."""
    is_limited: Flags
    """True (g,) where more doublings are needed than are made."""


class _Simulation:
    """The states of all responses, as deviations from their final values, and the readings so far."""

    def __init__(
        self,
        loop: StateSpace,
        final: Array,
        loop_modes: Modes,
        sampling: Sampling | None,
        extremes_only: bool,
    ) -> None:
        A, B, _, _ = loop
        self._final, self._modes, self._extremes_only = final, loop_modes, extremes_only
        self._is_sampled = sampling is not None
        self._state = _solve(A, B)
        if sampling is None:
            step_s = loop_modes.longest_step_s
            self._step_s = np.where(np.isfinite(step_s) & (step_s > 0.0), step_s, 1.0)
            step, slope, output = exponential(A * self._step_s[:, None, None]), A, loop.C
        else:
            self._step_s = np.full(len(A), sampling.period_s)
            step, _, output, _ = tustin(loop, sampling.period_s)
            slope = (step - np.eye(A.shape[-1])) / sampling.period_s
        self._rows = np.concatenate([output, output @ slope], axis=1)
        """Rows (B, 2, n) that take a state to the output's value and slope."""
        self._live: Indices = np.arange(len(A))
        """The loops that are still simulated."""
        self._powers = [step]
        """Step matrices of the live loops over 1, 2, 4, … steps."""
        self._collector = ReadingCollector(len(A))

    def run(self) -> StepReadings:
        for number in range(_MAX_BLOCKS):
            if not len(self._live):
                break
            self._simulate_block(number)
        self._collector.mark_unresolved(self._live)
        return self._collector.readings()

    def _simulate_block(self, number: int) -> None:
        span = self._span(number)
        refinement = self._refinement(number, span)
        end = self._power(number + span.samples.bit_length() - 1) @ self._state[self._live]
        for doublings in np.unique(refinement.doublings).tolist():
            chosen = np.flatnonzero(refinement.doublings == doublings)
            samples = span.samples << doublings
            for some in np.array_split(chosen, -(-len(chosen) * samples // _MAX_SAMPLES)):
                values, slopes = self._samples(some, number - doublings, samples, end)
                # A cubic through samples that do not resolve a mode would be worse than straight lines. A
                # sampled loop has nothing to be resolved between its samples.
                is_linear = refinement.is_limited | (self._is_sampled and doublings == number)
                spacing_s = span.step_s[some] / 2.0**doublings
                self._read(some, SampleBlock(span.start_s[some], spacing_s, values, slopes, is_linear[some]))
        self._state[self._live] = end
        self._keep(~self._is_at_rest(span.end_s) & np.isfinite(end).all(axis=(1, 2)))

    def _span(self, number: int) -> _Span:
        step_s = self._step_s[self._live] * 2.0**number
        if number == 0:
            return _Span(np.zeros(len(self._live)), step_s, _FIRST_SAMPLES)
        return _Span(_LATER_SAMPLES * step_s, step_s, _LATER_SAMPLES)

    def _refinement(self, number: int, span: _Span) -> _Refinement:
        """Return how finely the block must be sampled; mark the loops that this does not resolve."""
        now = self._modes.later(self._live, span.start_s)
        wanted = np.ceil(np.log2(span.step_s / now.longest_step_s))
        # Samples are never closer together than in the first block.
        doublings = np.where(wanted > 0.0, np.minimum(wanted, number), 0.0).astype(int)
        is_limited = doublings > _MAX_REFINEMENT
        if is_limited.any():
            is_unresolved = now.speed * span.step_s[:, None] / 2.0**_MAX_REFINEMENT > _MAX_TURN
            unresolved_size = np.where(is_unresolved, now.size, 0.0).sum(axis=-1)
            self._collector.mark_unresolved(self._live[is_limited & (unresolved_size > _UNRESOLVED)])
            doublings = np.minimum(doublings, _MAX_REFINEMENT)
        return _Refinement(doublings, is_limited)

    def _read(self, some: Indices, block: SampleBlock) -> None:
        """Pass the samples of some of the live loops on to the collector."""
        loops = self._live[some]
        if self._extremes_only:
            self._collector.add_extremes(loops, block, self._final[loops])
        else:
            self._collector.add(loops, block)

    def _is_at_rest(self, time_s: Array) -> Flags:
        """Return for the live loops (g,) if no mode that is left after ``time_s`` changes a reading."""
        live = self._live
        left = self._modes.later(live, time_s).size.sum(axis=-1)
        highest, lowest = self._collector.highest[live], self._collector.lowest[live]
        if self._extremes_only:
            reached = np.maximum(np.abs(highest), np.abs(lowest))
            return np.asarray(np.abs(self._final[live]) + left <= (1.0 + _NEGLIGIBLE) * reached)
        return np.asarray((left < BAND) & (1.0 + left <= np.maximum(highest, 1.0 + _NEGLIGIBLE)))

    def _samples(self, some: Indices, level: int, count: int, end: Array) -> tuple[Array, Array]:
        """Return values and slopes (g, count + 1) of some of the live loops, 2^level first steps apart.

        ``end`` holds the states at the end of the block. A sample is row · M^(i + small j) · state: the
        powers up to ``small`` are applied to the rows, and the others to the state.
        """
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
        """Return the step matrices of the live loops over 2^k steps."""
        while len(self._powers) <= k:
            self._powers.append(self._powers[-1] @ self._powers[-1])
        return self._powers[k]

    def _keep(self, kept: Flags) -> None:
        """Drop the live loops that are not ``kept``."""
        if not kept.all():
            self._live = self._live[kept]
            self._powers = [power[kept] for power in self._powers]


def _solve(A: Array, B: Array) -> Array:
    """Return A^-1 B, the state at time 0 as a deviation from the state at rest."""
    try:
        return np.asarray(np.linalg.solve(A, B))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(A) @ B)
