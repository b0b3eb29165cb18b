"""The paper's two searches on many seeds, by its genetic algorithm and by random search of the same budget.

The paper shows one run of each and tells no seed; what such a run is worth, only many of them say.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np

from design.errors import InfeasibleError
from design.mathematics.polynomials import Array
from design.models.plant import Plant
from design.models.transfer_function import TransferFunction
from design.search.random_search import RandomSearch
from design.search.searcher import Searcher, SearchResult
from design.synthesis.design_file import DesignFile
from design.synthesis.fixed_structure import Synthesis, synthesise
from design.synthesis.procedure import OnProgress, stage_progress
from design.synthesis.weight_selection import WeightSelection, select_weight

SEEDS = range(1, 21)
GENETIC, RANDOM = "genetic algorithm", "random search"
WEIGHT_BUDGET, CONTROLLER_BUDGET = (100, 20), (200, 30)
"""Sec. IV: chromosomes, generations."""


@dataclass(frozen=True)
class Runs:
    """What a search came to on each seed: the best margin (seeds, generations), 0 where nothing met all."""

    best: Array

    def after(self, generation: int) -> Array:
        """Best margins (seeds,) after so many generations; -1 is the last."""
        return np.asarray(self.best[:, generation - 1 if generation > 0 else -1])

    def reaching(self, margin: float, generation: int = -1) -> int:
        """On how many seeds a margin is reached."""
        return int((self.after(generation) >= margin).sum())

    def beats(self, other: Runs) -> float:
        """How often a run of this search ends higher than a run of the other, 0 to 1."""
        return float((self.after(-1)[:, None] > other.after(-1)[None, :]).mean())

    def __len__(self) -> int:
        return len(self.best)


@dataclass(frozen=True)
class PaperSearches:
    """Of W1, eqs. (8) and (9), and of the PID with eq. (16), eqs. (13) and (14)."""

    genetic_weights: Runs
    random_weights: Runs
    genetic_controllers: Runs
    random_controllers: Runs
    typical_weight: WeightSelection | None
    """The median of those that the genetic algorithm found; None if it found none."""
    typical_controller: Synthesis


def run_searches(
    asked: DesignFile, plant: Plant, weight: TransferFunction, on_progress: OnProgress | None = None
) -> PaperSearches:
    """Every search on every seed; ``asked`` is the paper's design file, ``weight`` its eq. (16)."""
    specifications, weight_structure = asked.specifications.asked_for(), asked.weight_structure()
    structure = asked.controller_structure()
    files = {seed: asked.with_seed(seed) for seed in SEEDS}

    def weights(name: str, searcher: Callable[[int], Callable[[int], Searcher]]) -> list[WeightSelection]:
        found = []
        for i, seed in enumerate(SEEDS):
            budget = int(np.prod(WEIGHT_BUDGET))
            with suppress(InfeasibleError):
                found.append(
                    select_weight(
                        plant,
                        structure=weight_structure,
                        specifications=specifications,
                        searcher=searcher(seed),
                        on_progress=stage_progress(
                            on_progress, f"{name}, W1", budget * len(SEEDS), budget * i
                        ),
                    )
                )
        return sorted(found, key=lambda one: one.eps_opt)

    def controllers(name: str, searcher: Callable[[int], Callable[[int], Searcher]]) -> list[Synthesis]:
        found = []
        for i, seed in enumerate(SEEDS):
            budget = int(np.prod(CONTROLLER_BUDGET))
            told = stage_progress(on_progress, f"{name}, PID", budget * len(SEEDS), budget * i)
            found.append(synthesise(plant, weight, structure, searcher=searcher(seed), on_progress=told))
        return sorted(found, key=lambda one: one.eps)

    genetic_weights = weights(GENETIC, lambda seed: files[seed].weight_searcher)
    random_weights = weights(RANDOM, partial(_random, WEIGHT_BUDGET))
    genetic_controllers = controllers(GENETIC, lambda seed: files[seed].controller_searcher)
    random_controllers = controllers(RANDOM, partial(_random, CONTROLLER_BUDGET))
    return PaperSearches(
        _runs([one.search for one in genetic_weights], WEIGHT_BUDGET),
        _runs([one.search for one in random_weights], WEIGHT_BUDGET),
        _runs([one.search for one in genetic_controllers], CONTROLLER_BUDGET),
        _runs([one.search for one in random_controllers], CONTROLLER_BUDGET),
        genetic_weights[len(genetic_weights) // 2] if genetic_weights else None,
        genetic_controllers[len(genetic_controllers) // 2],
    )


def _random(budget: tuple[int, int], seed: int) -> Callable[[int], Searcher]:
    return partial(RandomSearch, seed=seed, population=budget[0], generations=budget[1])


def _runs(searches: Sequence[SearchResult], budget: tuple[int, int]) -> Runs:
    """One row a seed; those that found nothing are 0 throughout."""
    best = np.zeros((len(SEEDS), budget[1]))
    for row, search in zip(best, searches, strict=False):
        row[:] = [max(progress.best_fitness, 0.0) for progress in search.convergence]
    return Runs(best)
