"""Weight selection, eqs. (8) and (9): the W1 of largest ε_opt whose loop meets the specifications.

The loop that is specified: gains and crossover are those of the shaped plant Gs; times, overshoot and error
those of the closed loop with K = W1 K∞, K∞ central for γ = factor γ_opt. Fitness is ε_opt where all hold;
elsewhere it is graded by the violations, below 0, so that a search finds its way in.
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

LEAST_COMPATIBLE = 0.25
"""Below this ε_opt the weight is incompatible with robust stability (step 5 of the paper, [17])."""


@dataclass(frozen=True)
class WeightSelection:
    """A weight W1 and what it was chosen for."""

    parameters: dict[str, float]
    weight: TransferFunction
    """W1(s), num and den (n + 1,)."""
    eps_opt: float
    gamma_factor: float
    readings: tuple[Reading, ...]
    at_bounds: tuple[str, ...]
    """Parameters that ended at an end of their box: a wider one may allow more."""
    sampling: Sampling | None
    search: SearchResult

    @property
    def compatible(self) -> bool:
        """Whether ε_opt is high enough for the weight to be used."""
        return self.eps_opt >= LEAST_COMPATIBLE


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
    """The best weight over one plant, or for the worst of several. Raises DesignError.

    ``searcher`` makes one for so many parameters.
    """
    structure = IntegralWeight() if structure is None else structure
    models = loop_models(plants, sampling)
    box = SearchBounds(structure.parameters)

    def loops(G: TransferFunction, W: TransferFunction) -> tuple[ClosedLoops, Array]:
        Gs = shaped(G, W)
        K_inf, eps_opt = central_controllers(Gs, gamma_factor)
        num, den = poly.multiply(W.num, K_inf.num), poly.multiply(W.den, K_inf.den)
        batch = ClosedLoops(G, one_degree_of_freedom(num, den), W=W, sampling=sampling, desired=Gs)
        return batch, eps_opt

    def assessments(points: Array, cutoff: Array | None = None) -> list[Assessment]:
        W = structure.controller(box.decode(points)).feedback
        found = []
        for G in models:
            batch, eps_opt = loops(G, W)
            found.append(assess(batch, eps_opt, batch.stable, specifications, cutoff))
        return found

    def objective(points: Array, cutoff: Array) -> Array:
        return worst(assessments(points, cutoff)).fitness

    make = searcher or partial(DifferentialEvolution, seed=seed, evaluations=evaluations)
    search = maximise(objective, make(len(box)), on_progress)
    values = box.decode(search.best[None, :])
    W = structure.controller(values).feedback
    found = assessments(search.best[None, :])
    most_violated = int(np.argmax([one.violation[0] for one in found]))
    read = readings(specifications, loops(models[most_violated], W)[0])
    parameters = dict(zip(box.names, map(float, values[0]), strict=True))
    at_bounds = box.at_bounds(search.best)
    if search.best_fitness < 0.0:
        limits = limit_notes(plants, sampling, wanted_crossover(specifications))
        if not all(one.stable[0] for one in found):
            raise NotStabilisedError(
                "no weight within the search bounds leaves a loop that its own full-order controller "
                f"stabilises{limits}"
            )
        raise InfeasibleError(compromise("weight", parameters, at_bounds, read) + limits)
    return WeightSelection(
        parameters=parameters,
        weight=TransferFunction(*(np.ravel(p) for p in W)),
        eps_opt=float(min(one.margin[0] for one in found)),
        gamma_factor=gamma_factor,
        readings=read,
        at_bounds=at_bounds,
        sampling=sampling,
        search=search,
    )
