"""The paper's genetic algorithm, faithful: the reference that the default searcher is measured against.

Sec. III.B: binary chromosomes, roulette wheel selection, per-pair crossover and per-child mutation by their
probabilities, the best chromosome copied to the next generation, a fixed number of generations.
"""

from __future__ import annotations

import numpy as np

from design.mathematics.polynomials import Array

_FAILING = 0.01
"""Eqs. (8) and (14): the fitness of what fails. (So a stable loop of less margin ranks below it.)"""


class GeneticAlgorithm:
    """Binary coding, roulette wheel, one-point crossover, one-bit mutation, elitist copy."""

    name = "genetic algorithm"

    def __init__(
        self,
        dimensions: int,
        *,
        seed: int,
        population: int = 200,
        generations: int = 30,
        crossover: float = 0.7,
        mutation: float = 0.1,
        bits: int = 16,
    ) -> None:
        self.seed = seed
        self._random = np.random.default_rng(seed)
        self._generations_left = generations
        self._crossover, self._mutation = crossover, mutation
        self._weights = 2.0 ** np.arange(bits - 1, -1, -1) / (2.0**bits - 1.0)
        self._shape = (dimensions, bits)
        self._has_found = False
        self._genes = self._random.random((population, dimensions * bits)) < 0.5

    def ask(self) -> Array:
        """See Searcher."""
        return np.asarray(self._genes.reshape(-1, *self._shape) @ self._weights)

    def worth(self) -> Array:
        """See Searcher: the wheel turns on every fitness, but what fails counts alike."""
        return np.full(len(self._genes), np.finfo(float).tiny if self._has_found else -np.inf)

    def tell(self, fitness: Array) -> None:
        """See Searcher."""
        self._generations_left -= 1
        n, length = self._genes.shape
        self._has_found |= bool((fitness > 0.0).any())
        judged = np.where(fitness > 0.0, fitness, _FAILING)
        best = self._genes[int(np.argmax(judged))]
        parents = self._genes[self._random.choice(n, size=n + n % 2, p=judged / judged.sum())]
        mothers, fathers = parents[::2], parents[1::2]
        pairs = len(mothers)
        cut = self._random.integers(1, length, size=(pairs, 1))
        crossed = self._random.random((pairs, 1)) < self._crossover
        swapped = crossed & (np.arange(length) >= cut)
        children = np.concatenate([np.where(swapped, fathers, mothers), np.where(swapped, mothers, fathers)])[
            :n
        ]
        mutated = np.flatnonzero(self._random.random(n) < self._mutation)
        children[mutated, self._random.integers(length, size=len(mutated))] ^= True
        children[0] = best
        self._genes = children

    def stop(self) -> str | None:
        """See Searcher."""
        return "last generation" if self._generations_left <= 0 else None
