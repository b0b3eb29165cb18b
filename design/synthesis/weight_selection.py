"""Select the weight W1, eqs. (8) and (9): the largest ε_opt whose loop meets the specifications.

Gain and crossover are read off the shaped plant Gs. Times, overshoot and error are read off the closed loop
with K = W1 K∞, where K∞ is the central controller for γ = factor γ_opt. The fitness of a weight is ε_opt if
all specifications hold, and below 0 otherwise; see ``design.closed_loop.assessment``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from design.closed_loop.assessment import Assessment, assess, worst
from design.closed_loop.loops import ClosedLoops
from design.closed_loop.specifications import (
    PAPER,
    Reading,
    Specification,
    compromise,
    readings,
    wanted_crossover,
)
from design.errors import InfeasibleError, NotStabilisedError
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array
from design.models.controller import one_degree_of_freedom
from design.models.plant import Plant
from design.models.plant_set import limit_notes, loop_models
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction
from design.robustness.central_controller import central_controllers
from design.robustness.loop_shaping import shaped
from design.search.bounds import SearchBounds
from design.search.differential_evolution import DifferentialEvolution
from design.search.searcher import Progress, Searcher, SearchResult, maximise
from design.synthesis.structures import IntegralWeight, Structure

MIN_EPS = 0.25
"""Smallest ε_opt, and smallest ε, of a robust loop (steps 5 and 9 of the paper, after its reference [17])."""


@dataclass(frozen=True)
class WeightSelection:
    """A selected weight W1, its margin and its readings."""

    parameters: dict[str, float]
    """Parameter values by name."""
    weight: TransferFunction
    """W1(s), num and den (n + 1,)."""
    eps_opt: float
    """Largest margin that any controller has with this weight; over several plants, the smallest of these."""
    gamma_factor: float
    """Ratio γ/γ_opt of the controller whose loop was read."""
    readings: tuple[Reading, ...]
    """Specifications, read off the selecting loop; over several plants, off the worst loop."""
    at_bounds: tuple[str, ...]
    """Names of the parameters that lie at a search bound; a wider search range may allow a larger ε_opt."""
    sampling: Sampling | None
    """Sampling of the loop; None for the continuous loop."""
    search: SearchResult

    @property
    def is_compatible(self) -> bool:
        """True if a loop with this weight can be robust, that is, if ε_opt is at least :data:`MIN_EPS`."""
        return self.eps_opt >= MIN_EPS


def select_weight(
    plants: Plant | Sequence[Plant],
    *,
    structure: Structure | None = None,
    specifications: Sequence[Specification] = PAPER,
    sampling: Sampling | None = None,
    gamma_factor: float = 1.1,
    searcher: Callable[[int], Searcher] | None = None,
    seed: int = 1,
    evaluations: int = 2000,
    on_progress: Callable[[Progress], None] | None = None,
) -> WeightSelection:
    """Select the best weight for one plant, or for the worst of several.

    ``searcher`` makes a searcher for a number of parameters; without it, differential evolution is used with
    ``seed`` and ``evaluations``. Raises InfeasibleError if no weight meets the specifications, and
    NotStabilisedError if no weight has a stable loop.
    """
    structure = IntegralWeight() if structure is None else structure
    models = loop_models(plants, sampling)
    bounds = SearchBounds(structure.parameters)

    def loops(G: TransferFunction, W: TransferFunction) -> tuple[ClosedLoops, Array]:
        Gs = shaped(G, W)
        K_inf, eps_opt = central_controllers(Gs, gamma_factor)
        K = one_degree_of_freedom(poly.multiply(W.num, K_inf.num), poly.multiply(W.den, K_inf.den))
        return ClosedLoops(G, K, W=W, sampling=sampling, desired=Gs), eps_opt

    def assessments(points: Array, cutoff: Array | None = None) -> list[Assessment]:
        W = structure.controller(bounds.decode(points)).feedback
        by_plant = []
        for G in models:
            batch, eps_opt = loops(G, W)
            by_plant.append(assess(batch, eps_opt, batch.stable, specifications, cutoff))
        return by_plant

    def objective(points: Array, cutoff: Array) -> Array:
        return worst(assessments(points, cutoff)).fitness

    make = searcher or partial(DifferentialEvolution, seed=seed, evaluations=evaluations)
    search = maximise(objective, make(len(bounds)), on_progress)
    values = bounds.decode(search.best[None, :])
    W = structure.controller(values).feedback
    best = assessments(search.best[None, :])
    most_violated = models[int(np.argmax([assessment.violation[0] for assessment in best]))]
    selection = WeightSelection(
        parameters=dict(zip(bounds.names, map(float, values[0]), strict=True)),
        weight=TransferFunction(*(np.ravel(p) for p in W)),
        eps_opt=min(float(assessment.margin[0]) for assessment in best),
        gamma_factor=gamma_factor,
        readings=readings(specifications, loops(most_violated, W)[0]),
        at_bounds=bounds.at_bounds(search.best),
        sampling=sampling,
        search=search,
    )
    if search.best_fitness < 0.0:
        is_stable = all(bool(assessment.stable[0]) for assessment in best)
        _refuse(selection, is_stable, limit_notes(plants, sampling, wanted_crossover(specifications)))
    return selection


def _refuse(selection: WeightSelection, is_stable: bool, plant_limits: str) -> None:
    """Raise the error of a search without a feasible weight; ``plant_limits`` says what plants prevent."""
    if not is_stable:
        raise NotStabilisedError(
            "no weight within the search bounds has a loop that its own full-order controller stabilises"
            + plant_limits
        )
    raise InfeasibleError(
        compromise("weight", selection.parameters, selection.at_bounds, selection.readings) + plant_limits
    )
