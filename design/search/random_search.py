"""Points drawn at random: what a searcher has to beat to have searched at all."""

from __future__ import annotations

import numpy as np

from design.mathematics.polynomials import Array


class RandomSearch:
    """Uniform points of the unit cube, a generation at a time."""

    name = "random search"

    def __init__(self, dimensions: int, *, seed: int, population: int, generations: int) -> None:
        self.seed = seed
        self._random = np.random.default_rng(seed)
        self._shape, self._generations_left = (population, dimensions), generations
        self._best = -np.inf

    def ask(self) -> Array:
        """See Searcher."""
        return self._random.random(self._shape)

    def worth(self) -> Array:
        """See Searcher: only what is better than all before it is kept."""
        return np.full(self._shape[0], self._best)

    def tell(self, fitness: Array) -> None:
        """See Searcher."""
        self._generations_left -= 1
        self._best = max(self._best, float(fitness.max()))

    def stop(self) -> str | None:
        """See Searcher."""
        return "last generation" if self._generations_left <= 0 else None
