"""The genetic algorithm of the paper, unchanged: the reference that the default searcher is measured against.

Sec. III.B of the paper: parameters as binary numbers in one chromosome, roulette-wheel selection, one-point
crossover with a probability for each pair, mutation of one bit with a probability for each child, a copy of
the best chromosome in the next generation, and a fixed number of generations.
"""

from __future__ import annotations

import numpy as np

from design.mathematics.polynomials import Array, Flags

_FAILING = 0.01
"""Fitness that eqs. (8) and (14) give to a candidate that fails: unstable, or a specification violated.

A stable candidate with a margin below 0.01 therefore ranks below an unstable one. The paper has this flaw,
and this reference keeps it.
"""


class GeneticAlgorithm:
    """The paper's genetic algorithm; ``crossover`` and ``mutation`` are probabilities."""

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
        """See :class:`Searcher`."""
        return np.asarray(self._genes.reshape(-1, *self._shape) @ self._weights)

    def cutoff(self) -> Array:
        """See :class:`Searcher`.

        Selection uses every positive fitness, and treats all others alike. So the cutoff is just above 0 once
        a candidate with positive fitness is known.
        """
        return np.full(len(self._genes), np.finfo(float).tiny if self._has_found else -np.inf)

    def update(self, fitness: Array) -> None:
        """See :class:`Searcher`."""
        self._generations_left -= 1
        self._has_found |= bool((fitness > 0.0).any())
        positive = np.where(fitness > 0.0, fitness, _FAILING)
        best = self._genes[int(np.argmax(positive))]
        children = self._crossed(self._selected(positive))
        self._mutate(children)
        children[0] = best
        self._genes = children

    def stop_reason(self) -> str | None:
        """See :class:`Searcher`."""
        return "last generation" if self._generations_left <= 0 else None

    def _selected(self, fitness: Array) -> Flags:
        """Draw an even number of parents by the roulette wheel."""
        n = len(self._genes)
        return self._genes[self._random.choice(n, size=n + n % 2, p=fitness / fitness.sum())]

    def _crossed(self, parents: Flags) -> Flags:
        """Cross pairs of parents at one point each; return as many children as there are chromosomes."""
        n, length = self._genes.shape
        mothers, fathers = parents[::2], parents[1::2]
        pairs = len(mothers)
        cut = self._random.integers(1, length, size=(pairs, 1))
        is_crossed = self._random.random((pairs, 1)) < self._crossover
        swapped = is_crossed & (np.arange(length) >= cut)
        daughters = np.where(swapped, fathers, mothers)
        sons = np.where(swapped, mothers, fathers)
        return np.concatenate([daughters, sons])[:n]

    def _mutate(self, children: Flags) -> None:
        """Flip one bit in some of the children, in place."""
        n, length = children.shape
        mutated = np.flatnonzero(self._random.random(n) < self._mutation)
        children[mutated, self._random.integers(length, size=len(mutated))] ^= True
