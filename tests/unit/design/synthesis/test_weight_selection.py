"""Weight selection: the optimum of eq. (8) on every seed, several plants, sampled loops, and refusals."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from support.paper_loop import PERIOD_S, W1

from design.closed_loop.specifications import PAPER, Specification
from design.errors import InfeasibleError
from design.models.plant import Plant, paper_plant
from design.models.sampling import Sampling
from design.search.bounds import Parameter, with_bounds
from design.search.differential_evolution import DifferentialEvolution
from design.search.genetic_algorithm import GeneticAlgorithm
from design.synthesis.structures import IntegralWeight
from design.synthesis.weight_selection import select_weight


def softer(plant: Plant, gain: float) -> Plant:
    return Plant(
        format="hil-plant",
        version=1,
        name="other",
        input_unit="V",
        output_unit="m",
        num=[gain * b for b in plant.num],
        den=plant.den,
    )


@pytest.mark.parametrize("seed", range(6))
def test_every_seed_finds_the_optimum_of_equation_8(seed: int) -> None:
    weight = select_weight(paper_plant(), seed=seed)
    assert 0.6035 <= weight.eps_opt <= 0.60358
    assert weight.parameters["kw"] == pytest.approx(15.275, rel=2e-3)
    assert weight.parameters["a"] == pytest.approx(0.4312, rel=2e-3)
    assert weight.search.evaluations <= 2000
    assert weight.is_compatible
    assert weight.at_bounds == ()
    values = {reading.quantity: reading for reading in weight.readings}
    assert all(reading.met for reading in weight.readings)
    # The gain and crossover of the shaped plant lie at their limits.
    assert values["gain_db"].value == pytest.approx(20.0, abs=0.01)
    assert values["bandwidth_rad_s"].value == pytest.approx(4.0, abs=0.01)


def test_the_papers_searcher_comes_near_the_optimum() -> None:
    parameters = IntegralWeight().parameters
    linear = {p.name: Parameter(p.name, p.low, p.high, "linear") for p in parameters}
    found = select_weight(
        paper_plant(),
        structure=with_bounds(IntegralWeight(), linear),
        searcher=partial(GeneticAlgorithm, seed=3, population=100, generations=20),
    )
    assert 0.55 < found.eps_opt <= 0.60358
    assert found.search.searcher == "genetic algorithm"


def test_the_papers_weight_meets_the_specifications() -> None:
    """With search ranges closed around eq. (16), the selection has its ε_opt and its coefficients."""
    around = {
        "kw": Parameter("kw", 15.535, 15.535001),
        "a": Parameter("a", 6.83 / 15.535, 6.83 / 15.535 + 1e-9),
    }
    weight = select_weight(paper_plant(), structure=with_bounds(IntegralWeight(), around), evaluations=80)
    assert weight.eps_opt == pytest.approx(0.601487, abs=1e-6)
    np.testing.assert_allclose(weight.weight.num, W1.num, rtol=1e-6)


def test_the_optimum_of_the_sampled_loop() -> None:
    weight = select_weight(paper_plant(), sampling=Sampling(PERIOD_S, 1))
    assert weight.eps_opt == pytest.approx(0.58828, abs=5e-5)
    assert all(reading.met for reading in weight.readings)


def test_with_several_plants_the_worst_counts() -> None:
    plants = [paper_plant(), softer(paper_plant(), 0.8)]
    both = select_weight(plants, seed=2)
    alone = [select_weight(plant, seed=2) for plant in plants]
    assert both.eps_opt <= min(one.eps_opt for one in alone) + 1e-4
    assert all(reading.met for reading in both.readings)
    # The softer plant needs more gain for the same bandwidth.
    assert both.parameters["kw"] > 1.2 * alone[0].parameters["kw"]


def test_any_set_of_specifications_can_be_used() -> None:
    plain = select_weight(
        paper_plant(), specifications=[Specification("bandwidth_rad_s", 4.0)], evaluations=800
    )
    assert plain.eps_opt > 0.6035
    limited = select_weight(
        paper_plant(),
        specifications=(
            *PAPER,
            Specification("phase_margin_deg", 60.0),
            Specification("effort_v", 1.6, at=0.1),
        ),
        evaluations=800,
    )
    assert {reading.quantity for reading in limited.readings} >= {"phase_margin_deg", "effort_v"}


def test_infeasible_specifications_are_named_at_the_best_compromise() -> None:
    with pytest.raises(InfeasibleError) as refusal:
        select_weight(
            paper_plant(),
            specifications=(*PAPER, Specification("bandwidth_rad_s", 40.0)),
            searcher=partial(DifferentialEvolution, seed=1, evaluations=600),
        )
    text = str(refusal.value)
    assert "bandwidth_rad_s" in text
    assert "NOT met (>= 40" in text
    assert "kw" in text


def test_a_parameter_at_its_search_bound_is_named() -> None:
    narrow = with_bounds(IntegralWeight(), {"kw": Parameter("kw", 15.5, 30.0)})
    assert select_weight(paper_plant(), structure=narrow, evaluations=1200).at_bounds == ("kw",)
