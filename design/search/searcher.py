"""One interface to all searchers: ask for points of the unit cube, tell their fitness, stop.

Fitness is to be made as large as possible. A searcher holds its own seeded generator and knows nothing of
control; ``maximise`` drives one and records its convergence (Figs 6 and 8).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from design.mathematics.polynomials import Array

OUT_OF_BUDGET = "evaluations used"
"""Why a search stops whose evaluations, not its generations, are limited."""

Objective = Callable[[Array, Array], Array]
"""Fitness (n,) of points (n, p) of the unit cube, given what each must reach to be of any use (n,): where it
does not, any value below that will do."""


class Searcher(Protocol):
    """A population searcher; every random choice comes from its seed."""

    name: str
    seed: int

    def ask(self) -> Array:
        """The next points (n, p) of the unit cube to be judged."""
        ...

    def worth(self) -> Array:
        """The fitness (n,) below which the points last asked for are discarded, whatever theirs is."""
        ...

    def tell(self, fitness: Array) -> None:
        """Fitness (n,) of the points last asked for."""
        ...

    def stop(self) -> str | None:
        """Why the search is over, or None."""
        ...


@dataclass(frozen=True)
class Progress:
    """Where a search stands after a generation."""

    generation: int
    evaluations: int
    best_fitness: float


@dataclass(frozen=True)
class SearchResult:
    """The best point (p,), its fitness, and how the search came there."""

    best: Array
    best_fitness: float
    convergence: tuple[Progress, ...]
    """One entry a generation, with the best fitness so far."""
    searcher: str
    seed: int
    stopped: str

    @property
    def evaluations(self) -> int:
        """Points judged."""
        return self.convergence[-1].evaluations

    @property
    def was_still_gaining(self) -> bool:
        """Whether the last fifth of its evaluations, the budget being used up, gained over 0.05 %."""
        before = [p.best_fitness for p in self.convergence if p.evaluations <= 0.8 * self.evaluations]
        gained = bool(before) and self.best_fitness - before[-1] > 5e-4 * abs(self.best_fitness)
        return gained and self.stopped == OUT_OF_BUDGET


def maximise(
    objective: Objective, searcher: Searcher, on_progress: Callable[[Progress], None] | None = None
) -> SearchResult:
    """Drive ``searcher`` until it stops; ``on_progress`` is called after every generation."""
    best, best_fitness, evaluations = np.zeros(0), -np.inf, 0
    convergence: list[Progress] = []
    while (stopped := searcher.stop()) is None:
        points = searcher.ask()
        fitness = objective(points, searcher.worth())
        searcher.tell(fitness)
        evaluations += len(points)
        chosen = int(np.argmax(fitness))
        if fitness[chosen] > best_fitness:
            best, best_fitness = points[chosen].copy(), float(fitness[chosen])
        convergence.append(Progress(len(convergence) + 1, evaluations, best_fitness))
        if on_progress is not None:
            on_progress(convergence[-1])
    return SearchResult(best, best_fitness, tuple(convergence), searcher.name, searcher.seed, stopped)
