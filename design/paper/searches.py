"""Run the paper's two searches on many seeds: its genetic algorithm, and random search of the same size.

The paper shows one run of each search and gives no seed. Only many runs show whether that run is typical.
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
from design.paper.printed import CONTROLLER_GENERATIONS, WEIGHT_GENERATIONS
from design.search.random_search import RandomSearch
from design.search.searcher import Progress, Searcher, SearchResult
from design.synthesis.design_file import CONTROLLER_CHROMOSOMES, WEIGHT_CHROMOSOMES, DesignFile
from design.synthesis.fixed_structure import Synthesis, synthesise
from design.synthesis.procedure import OnProgress, stage_progress
from design.synthesis.weight_selection import WeightSelection, select_weight

SEEDS = range(1, 21)
GENETIC, RANDOM = "genetic algorithm", "random search"

MakeSearcher = Callable[[int], Searcher]
"""Function that makes a searcher for a number of parameters."""


@dataclass(frozen=True)
class Runs:
    """Convergence of one search on every seed."""

    best: Array
    """Best margin so far (seeds, generations); 0 while no candidate meets all specifications."""

    def after(self, generation: int) -> Array:
        """Return the best margins (seeds,) after a number of generations; -1 means after the last."""
        return np.asarray(self.best[:, generation - 1 if generation > 0 else -1])

    def number_reaching(self, margin: float, generation: int = -1) -> int:
        """Return the number of seeds that reach a margin by a generation; -1 means by the last."""
        return int((self.after(generation) >= margin).sum())

    def share_above(self, other: Runs) -> float:
        """Return the share (0 to 1) of pairs of runs in which this search ends above the other."""
        return float((self.after(-1)[:, None] > other.after(-1)[None, :]).mean())

    def __len__(self) -> int:
        return len(self.best)


@dataclass(frozen=True)
class PaperSearches:
    """Runs for the weight, eqs. (8) and (9), and for the PID with the weight of eq. (16), eqs. (13), (14)."""

    genetic_weights: Runs
    random_weights: Runs
    genetic_controllers: Runs
    random_controllers: Runs
    typical_weight: WeightSelection | None
    """Median of the weights that the genetic algorithm found; None if it found none."""
    typical_controller: Synthesis
    """Median of the controllers that the genetic algorithm found."""


def run_searches(
    design_file: DesignFile, plant: Plant, weight: TransferFunction, on_progress: OnProgress | None = None
) -> PaperSearches:
    """Run every search on every seed; ``design_file`` is the paper's, ``weight`` that of eq. (16)."""
    specifications, weight_structure = design_file.specifications.requested(), design_file.weight_structure()
    structure = design_file.controller_structure()
    seeded = {seed: design_file.with_seed(seed) for seed in SEEDS}
    weight_size = WEIGHT_CHROMOSOMES, WEIGHT_GENERATIONS
    controller_size = CONTROLLER_CHROMOSOMES, CONTROLLER_GENERATIONS

    def find_weights(name: str, searcher_of_seed: Callable[[int], MakeSearcher]) -> list[WeightSelection]:
        weights = []
        for progress, seed in _stages(on_progress, f"{name}, W1", weight_size):
            with suppress(InfeasibleError):
                weights.append(
                    select_weight(
                        plant,
                        structure=weight_structure,
                        specifications=specifications,
                        searcher=searcher_of_seed(seed),
                        on_progress=progress,
                    )
                )
        return sorted(weights, key=lambda selection: selection.eps_opt)

    def find_controllers(name: str, searcher_of_seed: Callable[[int], MakeSearcher]) -> list[Synthesis]:
        controllers = [
            synthesise(plant, weight, structure, searcher=searcher_of_seed(seed), on_progress=progress)
            for progress, seed in _stages(on_progress, f"{name}, PID", controller_size)
        ]
        return sorted(controllers, key=lambda synthesis: synthesis.eps)

    genetic_weights = find_weights(GENETIC, lambda seed: seeded[seed].weight_searcher)
    random_weights = find_weights(RANDOM, partial(_random_searcher, weight_size))
    genetic_controllers = find_controllers(GENETIC, lambda seed: seeded[seed].controller_searcher)
    random_controllers = find_controllers(RANDOM, partial(_random_searcher, controller_size))
    return PaperSearches(
        _runs([one.search for one in genetic_weights], WEIGHT_GENERATIONS),
        _runs([one.search for one in random_weights], WEIGHT_GENERATIONS),
        _runs([one.search for one in genetic_controllers], CONTROLLER_GENERATIONS),
        _runs([one.search for one in random_controllers], CONTROLLER_GENERATIONS),
        genetic_weights[len(genetic_weights) // 2] if genetic_weights else None,
        genetic_controllers[len(genetic_controllers) // 2],
    )


def _stages(
    on_progress: OnProgress | None, name: str, size: tuple[int, int]
) -> list[tuple[Callable[[Progress], None] | None, int]]:
    """Return, for every seed, what reports the progress of its search, all in one stage."""
    evaluations = size[0] * size[1]
    return [
        (stage_progress(on_progress, name, evaluations * len(SEEDS), evaluations * i), seed)
        for i, seed in enumerate(SEEDS)
    ]


def _random_searcher(size: tuple[int, int], seed: int) -> MakeSearcher:
    return partial(RandomSearch, seed=seed, population=size[0], generations=size[1])


def _runs(searches: Sequence[SearchResult], generations: int) -> Runs:
    """Collect one row for every seed; the rows of seeds that found nothing are 0."""
    best = np.zeros((len(SEEDS), generations))
    for row, search in zip(best, searches, strict=False):
        row[:] = [max(progress.best_fitness, 0.0) for progress in search.convergence]
    return Runs(best)
