"""Differential evolution, rand/1/bin (Storn and Price 1997): the default searcher."""

from __future__ import annotations

import numpy as np

from design.polynomials import Array


class DifferentialEvolution:
    """Each point competes with a mixture of itself and a + F (b - c), a, b, c other points at random."""

    name = "differential evolution"

    def __init__(
        self,
        dimensions: int,
        *,
        seed: int,
        evaluations: int = 6000,
        population: int = 40,
        scale: float = 0.5,
        crossover: float = 0.9,
    ) -> None:
        self.seed = seed
        self._random = np.random.default_rng(seed)
        self._left = evaluations
        self._scale, self._crossover = scale, crossover
        self._points = self._random.random((population, dimensions))
        self._fitness = np.full(population, -np.inf)
        self._trials = self._points

    def ask(self) -> Array:
        """See Searcher."""
        if np.isneginf(self._fitness).all():
            self._trials = self._points
        else:
            n, p = self._points.shape
            order = self._random.random((n, n))
            np.fill_diagonal(order, 2.0)
            a, b, c = np.argpartition(order, 3, axis=1)[:, :3].T
            mutants = self._points[a] + self._scale * (self._points[b] - self._points[c])
            # Beyond a wall: between the wall and the point itself.
            mutants = np.where(mutants < 0.0, 0.5 * self._points, mutants)
            mutants = np.where(mutants > 1.0, 0.5 * (self._points + 1.0), mutants)
            taken = self._random.random((n, p)) < self._crossover
            taken[np.arange(n), self._random.integers(p, size=n)] = True
            self._trials = np.where(taken, mutants, self._points)
        self._trials = self._trials[: self._left]
        return self._trials

    def tell(self, fitness: Array) -> None:
        """See Searcher."""
        self._left -= len(fitness)
        better = np.flatnonzero(fitness >= self._fitness[: len(fitness)])
        self._points = self._points.copy()
        self._points[better] = self._trials[better]
        self._fitness[better] = fitness[better]

    def stop(self) -> str | None:
        """See Searcher."""
        return "evaluations used" if self._left <= 0 else None
