"""Differential evolution (Storn and Price 1997): the default searcher.

Every point of the population competes with one trial point. The trial mixes the point's own coordinates with
those of a mutant, each coordinate being taken from the mutant with the probability ``crossover``.

- In the first part of the search (``exploring``) the mutant is a + F (b - c), with a, b and c drawn from the
  population (the variant rand/1/bin). This finds the region of the optimum.
- Afterwards the mutant is x + F (best - x) + F (b - c), where x is the point itself and best is drawn from
  the best tenth of the population (Zhang and Sanderson 2009). This converges quickly.

The factor F is drawn anew for each mutant, which keeps a small population from becoming uniform too early.
"""

from __future__ import annotations

import numpy as np

from design.mathematics.polynomials import Array
from design.search.searcher import OUT_OF_BUDGET

_CONVERGED = 1e-8
"""Width of the population, in each dimension, below which the search has converged.

The width is used rather than the spread of the fitness, since the fitness may be the same everywhere at
first.
"""


class DifferentialEvolution:
    """Differential evolution in the unit cube, one population in each generation."""

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
        """Make a searcher that evaluates at most ``evaluations`` points.

        ``population`` is max(40, 15 * dimensions) unless given. ``scale`` is the range from which F is drawn.
        ``exploring`` is the share of the evaluations that belong to the first part of the search.
        """
        self.seed = seed
        self._random = np.random.default_rng(seed)
        self._left = self._evaluations = evaluations
        self._scale, self._crossover, self._exploring = scale, crossover, exploring
        n = max(40, 15 * dimensions) if population is None else population
        # Latin hypercube: along every axis, each of n equal slices holds one point.
        slices = np.argsort(self._random.random((n, dimensions)), axis=0)
        self._points = (slices + self._random.random((n, dimensions))) / n
        self._fitness = np.full(n, -np.inf)
        self._trials = self._points

    def ask(self) -> Array:
        """See :class:`Searcher`."""
        started = self._left < self._evaluations
        self._trials = (self._trial_points() if started else self._points)[: self._left]
        return self._trials

    def cutoff(self) -> Array:
        """See :class:`Searcher`. A trial replaces its point only if it is at least as good."""
        return self._fitness[: len(self._trials)]

    def update(self, fitness: Array) -> None:
        """See :class:`Searcher`."""
        self._left -= len(fitness)
        kept = np.flatnonzero(fitness >= self._fitness[: len(fitness)])
        self._points = self._points.copy()
        self._points[kept] = self._trials[kept]
        self._fitness[kept] = fitness[kept]

    def stop_reason(self) -> str | None:
        """See :class:`Searcher`."""
        if self._left <= 0:
            return OUT_OF_BUDGET
        return "converged" if np.ptp(self._points, axis=0).max() < _CONVERGED else None

    def _trial_points(self) -> Array:
        points, random = self._points, self._random
        n, p = points.shape
        # Three different partners for every point, none of them the point itself.
        order = random.random((n, n))
        np.fill_diagonal(order, 2.0)
        a, b, c = np.argpartition(order, 3, axis=1)[:, :3].T
        F = random.uniform(*self._scale, size=(n, 1))
        if self._left > (1.0 - self._exploring) * self._evaluations:
            base = points[a]
        else:
            best = np.argsort(-self._fitness)[: max(1, n // 10)]
            base = points + F * (points[random.choice(best, size=n)] - points)
        mutants = base + F * (points[b] - points[c])
        # A coordinate beyond a search bound comes to lie half-way between the bound and the point itself.
        mutants = np.where(mutants < 0.0, 0.5 * points, mutants)
        mutants = np.where(mutants > 1.0, 0.5 * (points + 1.0), mutants)
        taken = random.random((n, p)) < self._crossover
        taken[np.arange(n), random.integers(p, size=n)] = True
        return np.where(taken, mutants, points)
