"""Searchers: the common interface, seeds, budgets, stop reasons, convergence, and the paper's operators."""

from __future__ import annotations

import numpy as np
import pytest

from design.mathematics.polynomials import Array
from design.search.differential_evolution import DifferentialEvolution
from design.search.genetic_algorithm import GeneticAlgorithm
from design.search.random_search import RandomSearch
from design.search.searcher import Progress, Searcher, maximise


def valley(points: Array, _cutoff: Array) -> Array:
    """Return the height of a narrow curved ridge; its top, 1, lies at (0.7, 0.7², 0.3)."""
    x, y, z = points.T
    return 1.0 - 30.0 * (y - x * x) ** 2 - (x - 0.7) ** 2 - (z - 0.3) ** 2


SEARCHERS = {
    "differential evolution": lambda seed: DifferentialEvolution(3, seed=seed, evaluations=3000),
    "genetic algorithm": lambda seed: GeneticAlgorithm(3, seed=seed, population=100, generations=30),
    "random search": lambda seed: RandomSearch(3, seed=seed, population=100, generations=30),
}


@pytest.mark.parametrize("name", SEARCHERS)
def test_the_same_seed_gives_the_same_search(name: str) -> None:
    first, again, other = (maximise(valley, SEARCHERS[name](seed)) for seed in (5, 5, 6))
    assert first.convergence == again.convergence
    assert first.best.tolist() == again.best.tolist()
    assert first.best.tolist() != other.best.tolist()
    assert (first.searcher, first.seed) == (name, 5)


@pytest.mark.parametrize("name", SEARCHERS)
def test_convergence_is_recorded_and_reported(name: str) -> None:
    seen: list[Progress] = []
    result = maximise(valley, SEARCHERS[name](1), seen.append)
    assert tuple(seen) == result.convergence
    best = [progress.best_fitness for progress in seen]
    assert best == sorted(best)
    assert best[-1] == result.best_fitness == pytest.approx(valley(result.best[None, :], np.zeros(1))[0])
    assert [progress.generation for progress in seen] == list(range(1, len(seen) + 1))
    assert result.evaluations <= 3000
    assert result.best.min() >= 0.0
    assert result.best.max() <= 1.0


def test_the_default_finds_the_top_on_every_seed() -> None:
    found = [maximise(valley, SEARCHERS["differential evolution"](seed)).best_fitness for seed in range(20)]
    assert min(found) > 1.0 - 1e-6


def test_the_default_uses_its_evaluations_and_no_more() -> None:
    result = maximise(valley, DifferentialEvolution(3, seed=1, evaluations=333))
    assert result.evaluations == 333
    assert result.stop_reason == "evaluations used"


def test_the_default_stops_when_its_population_has_converged() -> None:
    result = maximise(
        lambda points, _: -((points - 0.5) ** 2).sum(axis=1),
        DifferentialEvolution(1, seed=1, evaluations=100000),
    )
    assert result.stop_reason == "converged"
    assert result.evaluations < 20000


def test_the_default_does_not_stop_while_all_candidates_have_the_same_fitness() -> None:
    """The objective is a plateau with one small hill, which no point of the first population hits."""

    def hill(points: Array, _cutoff: Array) -> Array:
        return np.maximum(1.0 - 400.0 * ((points - 0.83) ** 2).sum(axis=1), 0.0)

    found = [maximise(hill, DifferentialEvolution(2, seed=seed, evaluations=3000)) for seed in range(10)]
    assert min(result.best_fitness for result in found) > 0.999


def test_points_stay_in_the_cube_where_the_top_is_in_a_corner() -> None:
    searcher = DifferentialEvolution(4, seed=3, evaluations=4000)
    while searcher.stop_reason() is None:
        points = searcher.ask()
        assert points.min() >= 0.0
        assert points.max() <= 1.0
        searcher.update(points.sum(axis=1))
    assert points.sum(axis=1).max() > 3.99


def test_below_the_cutoff_the_objective_may_return_any_value_below_it() -> None:
    """The search is the same whether the objective makes use of the cutoff or not."""

    def lazy(points: Array, cutoff: Array) -> Array:
        exact = valley(points, cutoff)
        return np.where(exact < cutoff, exact + 0.9 * (cutoff - exact), exact)

    with_exact_values, with_cutoff = (
        maximise(f, SEARCHERS["differential evolution"](7)) for f in (valley, lazy)
    )
    assert with_exact_values.best.tolist() == with_cutoff.best.tolist()
    assert with_exact_values.convergence == with_cutoff.convergence


def test_the_genetic_algorithm_runs_the_papers_generations() -> None:
    result = maximise(valley, GeneticAlgorithm(3, seed=1, population=200, generations=30))
    assert len(result.convergence) == 30
    assert result.evaluations == 6000
    assert result.stop_reason == "last generation"


def test_the_best_chromosome_is_kept() -> None:
    searcher = GeneticAlgorithm(3, seed=2, population=30, generations=20, mutation=1.0)
    best = -np.inf
    while searcher.stop_reason() is None:
        points = searcher.ask()
        fitness = 2.0 + valley(points, np.zeros(len(points)))
        assert fitness.max() >= best
        best = fitness.max()
        searcher.update(fitness)


def test_chromosomes_are_binary_numbers() -> None:
    points = GeneticAlgorithm(2, seed=1, population=500, bits=4).ask()
    assert set(np.unique(np.round(points * 15.0, 9))) <= set(range(16))
    assert points.min() == 0.0
    assert points.max() == 1.0


def test_without_crossover_and_mutation_only_copies_are_made() -> None:
    searcher = GeneticAlgorithm(2, seed=1, population=20, generations=5, crossover=0.0, mutation=0.0)
    before = {tuple(point) for point in searcher.ask()}
    searcher.update(np.linspace(0.1, 1.0, 20))
    assert {tuple(point) for point in searcher.ask()} <= before


def test_the_roulette_wheel_favours_the_fit_in_proportion() -> None:
    shares = []
    for seed in range(200):
        searcher = GeneticAlgorithm(1, seed=seed, population=2, generations=5, crossover=0.0, mutation=0.0)
        points = searcher.ask()
        if points[0, 0] == points[1, 0]:
            continue
        searcher.update(np.array([0.25, 0.75]))
        # The best chromosome takes the first place; only the second is drawn.
        shares.append(searcher.ask()[1, 0] == points[1, 0])
    assert np.mean(shares) == pytest.approx(0.75, abs=0.1)


def test_failing_candidates_count_as_the_papers_small_value() -> None:
    """Eq. (14) ranks a stable loop of margin 0.005 below an unstable one, and so does the reference."""
    searcher = GeneticAlgorithm(2, seed=1, population=2, generations=5, crossover=0.0, mutation=0.0)
    points = searcher.ask()
    searcher.update(np.array([0.005, -1e4]))
    assert searcher.ask()[0].tolist() == points[1].tolist()


@pytest.mark.parametrize("name", SEARCHERS)
def test_every_searcher_follows_the_interface(name: str) -> None:
    searcher: Searcher = SEARCHERS[name](1)
    points = searcher.ask()
    assert searcher.cutoff().shape == (len(points),)
    searcher.update(np.zeros(len(points)))
