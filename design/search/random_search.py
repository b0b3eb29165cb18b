"""Random search: the yardstick that every other searcher has to beat."""

from __future__ import annotations

import numpy as np

from design.mathematics.polynomials import Array


class RandomSearch:
    """Uniformly distributed points of the unit cube, ``population`` of them in each generation."""

    name = "random search"

    def __init__(self, dimensions: int, *, seed: int, population: int, generations: int) -> None:
        self.seed = seed
        self._random = np.random.default_rng(seed)
        self._shape, self._generations_left = (population, dimensions), generations
        self._best = -np.inf

    def ask(self) -> Array:
        """See :class:`Searcher`."""
        return self._random.random(self._shape)

    def cutoff(self) -> Array:
        """See :class:`Searcher`. Only a point that is better than all earlier ones is of use."""
        return np.full(self._shape[0], self._best)

    def update(self, fitness: Array) -> None:
        """See :class:`Searcher`."""
        self._generations_left -= 1
        self._best = max(self._best, float(fitness.max()))

    def stop_reason(self) -> str | None:
        """See :class:`Searcher`."""
        return "last generation" if self._generations_left <= 0 else None
