"""The interface that all searchers share, and the loop that runs one of them.

A searcher looks for the point of the unit cube with the largest fitness. It works in generations: it proposes
points (:meth:`Searcher.ask`), learns their fitness (:meth:`Searcher.update`), and says when the search is
over (:meth:`Searcher.stop_reason`). A searcher has its own seeded random generator and knows no control
engineering. :func:`maximise` runs the loop and records its convergence, which is Figs 6 and 8 of the paper.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from design.mathematics.polynomials import Array

OUT_OF_BUDGET = "evaluations used"
"""Stop reason of a search that has used up its evaluations before it converged."""

Objective = Callable[[Array, Array], Array]
"""A function of points (n, p) of the unit cube and of their cutoffs (n,) that returns their fitness (n,).

Where the fitness of a point is below its cutoff, the objective may return any value below the cutoff. This
saves the exact evaluation of candidates that the searcher will discard anyway.
"""


class Searcher(Protocol):
    """A search method that works on a population of points; all its random numbers come from its seed."""

    name: str
    seed: int

    def ask(self) -> Array:
        """Return the next points (n, p) of the unit cube to be evaluated."""
        ...

    def cutoff(self) -> Array:
        """Return the fitness (n,) below which the searcher discards each point that it last asked for."""
        ...

    def update(self, fitness: Array) -> None:
        """Take in the fitness (n,) of the points last asked for."""
        ...

    def stop_reason(self) -> str | None:
        """Return why the search is over, or None while it goes on."""
        ...


@dataclass(frozen=True)
class Progress:
    """The state of a search after one generation; ``evaluations`` counts from the beginning."""

    generation: int
    evaluations: int
    best_fitness: float


@dataclass(frozen=True)
class SearchResult:
    """The best point (p,) of the unit cube that a search found, its fitness, and how the search went."""

    best: Array
    best_fitness: float
    convergence: tuple[Progress, ...]
    """State of the search after each generation, with the best fitness so far."""
    searcher: str
    seed: int
    stop_reason: str

    @property
    def evaluations(self) -> int:
        """Number of points that were evaluated."""
        return self.convergence[-1].evaluations

    @property
    def was_still_gaining(self) -> bool:
        """True if the budget ended the search while its last fifth still gained over 0.05 %."""
        before = [p.best_fitness for p in self.convergence if p.evaluations <= 0.8 * self.evaluations]
        gained = bool(before) and self.best_fitness - before[-1] > 5e-4 * abs(self.best_fitness)
        return gained and self.stop_reason == OUT_OF_BUDGET


def maximise(
    objective: Objective, searcher: Searcher, on_progress: Callable[[Progress], None] | None = None
) -> SearchResult:
    """Run ``searcher`` on ``objective`` until it stops; call ``on_progress`` after every generation."""
    best, best_fitness, evaluations = np.zeros(0), -np.inf, 0
    convergence: list[Progress] = []
    while (stop_reason := searcher.stop_reason()) is None:
        points = searcher.ask()
        fitness = objective(points, searcher.cutoff())
        searcher.update(fitness)
        evaluations += len(points)
        chosen = int(np.argmax(fitness))
        if fitness[chosen] > best_fitness:
            best, best_fitness = points[chosen].copy(), float(fitness[chosen])
        convergence.append(Progress(len(convergence) + 1, evaluations, best_fitness))
        if on_progress is not None:
            on_progress(convergence[-1])
    return SearchResult(best, best_fitness, tuple(convergence), searcher.name, searcher.seed, stop_reason)
