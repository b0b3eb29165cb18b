"""Differential evolution (Storn and Price 1997): the default searcher.

First rand/1/bin: each point competes with a mixture of itself and a + F (b - c). Late, the mixture starts
from the point itself, drawn towards one of the best tenth (Zhang and Sanderson 2009): exploring finds the
right hill, the rest climbs it. F is drawn anew for each mixture, which keeps a small population alive.
"""

from __future__ import annotations

import numpy as np

from design.mathematics.polynomials import Array
from design.search.searcher import OUT_OF_BUDGET

_CONVERGED = 1e-8
"""Width of the population; fitness says nothing where all fail alike."""


class DifferentialEvolution:
    """Differential evolution in the unit cube, a population at a time."""

    name = "differential evolution"

    def __init__(
        self,
        dimensions: int,
        *,
        seed: int,
        evaluations: int = 6000,
        population: int | None = None,
        scale: tuple[float, float] = (0.5, 0.8),
        crossover: float = 0.9,
        exploring: float = 0.6,
    ) -> None:
        """``exploring`` is the share of the evaluations before the climb; ``population`` 15 a dimension."""
        self.seed = seed
        self._random = np.random.default_rng(seed)
        self._left = self._evaluations = evaluations
        self._scale, self._crossover, self._exploring = scale, crossover, exploring
        n = max(40, 15 * dimensions) if population is None else population
        # One point in each of n slices along every axis.
        slices = np.argsort(self._random.random((n, dimensions)), axis=0)
        self._points = (slices + self._random.random((n, dimensions))) / n
        self._fitness = np.full(n, -np.inf)
        self._trials = self._points

    def ask(self) -> Array:
        """See Searcher."""
        started = self._left < self._evaluations
        self._trials = (self._mixtures() if started else self._points)[: self._left]
        return self._trials

    def worth(self) -> Array:
        """See Searcher: a mixture replaces its point only if it is no worse."""
        return self._fitness[: len(self._trials)]

    def tell(self, fitness: Array) -> None:
        """See Searcher."""
        self._left -= len(fitness)
        kept = np.flatnonzero(fitness >= self._fitness[: len(fitness)])
        self._points = self._points.copy()
        self._points[kept] = self._trials[kept]
        self._fitness[kept] = fitness[kept]

    def stop(self) -> str | None:
        """See Searcher."""
        if self._left <= 0:
            return OUT_OF_BUDGET
        return "converged" if np.ptp(self._points, axis=0).max() < _CONVERGED else None

    def _mixtures(self) -> Array:
        points, random = self._points, self._random
        n, p = points.shape
        order = random.random((n, n))
        np.fill_diagonal(order, 2.0)
        a, b, c = np.argpartition(order, 3, axis=1)[:, :3].T
        F = random.uniform(*self._scale, size=(n, 1))
        if self._left > (1.0 - self._exploring) * self._evaluations:
            base = points[a]
        else:
            best = np.argsort(-self._fitness)[: max(1, n // 10)]
            base = points + F * (points[random.choice(best, size=n)] - points)
        mixed = base + F * (points[b] - points[c])
        # Beyond a wall: half-way between the wall and the point itself.
        mixed = np.where(mixed < 0.0, 0.5 * points, mixed)
        mixed = np.where(mixed > 1.0, 0.5 * (points + 1.0), mixed)
        taken = random.random((n, p)) < self._crossover
        taken[np.arange(n), random.integers(p, size=n)] = True
        return np.where(taken, mixed, points)
