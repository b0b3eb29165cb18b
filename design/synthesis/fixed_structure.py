"""Fixed-structure synthesis, eqs. (13) and (14): the parameters of largest stability margin ε.

Over one plant, or the worst of several with one weight; continuous, or in the sampled loop with hold and
delay, the controller by Tustin's rule: what is judged is what runs. Fitness is ε where the loop is stable
and meets its specifications (if any); otherwise it is below 0 (see ``design.closed_loop.assessment``).

Parameters that no margin sees (setpoint weights) are chosen last, the feedback as it is: those with which
specifications hold, and among them those of least ∫ t |e| dt after a setpoint step (ITAE).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from design.closed_loop.assessment import Assessment, assess, worst
from design.closed_loop.loops import ClosedLoops
from design.closed_loop.specifications import Reading, Specification, compromise, readings, violations
from design.errors import InfeasibleError, NotStabilisedError
from design.mathematics.polynomials import Array, Indices
from design.models.plant import Plant
from design.models.plant_set import limit_notes, loop_models
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction
from design.robustness import margins
from design.robustness.central_controller import optimal_margins
from design.robustness.loop_shaping import shaped
from design.search.bounds import SearchBounds
from design.search.differential_evolution import DifferentialEvolution
from design.search.searcher import Progress, Searcher, SearchResult, maximise
from design.synthesis.structures import Structure, setpoint_parameters

_SETPOINT_EVALUATIONS = 600
"""A parameter."""


@dataclass(frozen=True)
class Synthesis:
    """A controller of the structure asked for, and how good it is."""

    structure: Structure
    parameters: dict[str, float]
    eps: float
    """Margin of the loop it was designed for; over several plants, the smallest."""
    eps_of_plants: tuple[float, ...]
    eps_opt: float
    """The best that any controller could reach with this weight; over several plants, the smallest."""
    weight: TransferFunction
    readings: tuple[Reading, ...]
    at_bounds: tuple[str, ...]
    """Parameters that ended at an end of their box: a wider one may allow more."""
    setpoint_parameters: tuple[str, ...]
    """Those that no margin sees."""
    sampling: Sampling | None
    search: SearchResult

    @property
    def values(self) -> list[float]:
        """Parameter values in the structure's order."""
        return list(self.parameters.values())


def synthesise(
    plants: Plant | Sequence[Plant],
    weight: TransferFunction,
    structure: Structure,
    *,
    specifications: Sequence[Specification] = (),
    aims: Sequence[Specification] = (),
    sampling: Sampling | None = None,
    searcher: Callable[[int], Searcher] | None = None,
    seed: int = 1,
    evaluations: int = 6000,
    on_progress: Callable[[Progress], None] | None = None,
) -> Synthesis:
    """The best controller found, the specifications held; ``aims`` are for parameters that no margin sees.

    ``searcher`` makes one for so many parameters. Raises NotStabilisedError, or InfeasibleError if
    specifications fail.
    """
    models = loop_models(plants, sampling)
    box = SearchBounds(structure.parameters)
    setpoint = setpoint_parameters(structure)
    is_setpoint = np.array([name in setpoint for name in box.names])
    # Without specifications to hold, what no margin sees need not be searched with the rest.
    searched = np.flatnonzero(~is_setpoint) if not specifications else np.arange(len(box))

    def loops(G: TransferFunction, points: Array) -> ClosedLoops:
        K = structure.controller(box.decode(points))
        return ClosedLoops(G, K, W=weight, sampling=sampling)

    def whole(points: Array) -> Array:
        return _placed(np.full(len(box), 0.5), searched, points)

    def assessments(points: Array, cutoff: Array | None = None) -> list[Assessment]:
        K = structure.controller(box.decode(points))
        found = []
        for G in models:
            batch = ClosedLoops(G, K, W=weight, sampling=sampling)
            margin = margins.stability_margin(G, K.feedback, weight, cutoff)
            found.append(assess(batch, margin, margin > 0.0, specifications, cutoff))
        return found

    def objective(points: Array, cutoff: Array) -> Array:
        return worst(assessments(whole(points), cutoff)).fitness

    make = searcher or partial(DifferentialEvolution, seed=seed, evaluations=evaluations)
    search = maximise(objective, make(len(searched)), on_progress)
    best = whole(search.best[None, :])
    if setpoint and search.best_fitness > 0.0:
        which, feedback = np.flatnonzero(is_setpoint), best[0]

        def setpoint_objective(points: Array, _cutoff: Array) -> Array:
            wanted, there = (*specifications, *aims), _placed(feedback, which, points)
            batches = [loops(G, there) for G in models]
            costs = [1e6 * violations(wanted, batch) + np.minimum(batch.itae, 1e5) for batch in batches]
            return np.asarray(-np.max(costs, axis=0))

        last = DifferentialEvolution(len(which), seed=seed, evaluations=_SETPOINT_EVALUATIONS * len(which))
        best = _placed(feedback, which, maximise(setpoint_objective, last).best[None, :])
    values = box.decode(best)[0]
    parameters = dict(zip(box.names, map(float, values), strict=True))
    at_bounds = tuple(name for name in box.at_bounds(best[0]) if name not in setpoint)
    found = assessments(best)
    if not all(one.stable[0] for one in found):
        raise NotStabilisedError(
            f"no {type(structure).__name__} within the search bounds stabilises the plant: the best of "
            f"{search.evaluations} candidates still has a closed-loop pole at Re s = "
            f"{worst(found).growth[0]:.3g} rad/s; widen the bounds, or choose another structure"
            + limit_notes(plants, sampling)
        )
    eps = [float(one.margin[0]) for one in found]
    most_violated = int(np.argmax([one.violation[0] for one in found]))
    read = readings(specifications, loops(models[most_violated], best))
    if search.best_fitness < 0.0:
        raise InfeasibleError(
            compromise("controller", parameters, at_bounds, read) + limit_notes(plants, sampling)
        )
    return Synthesis(
        structure=structure,
        parameters=parameters,
        eps=min(eps),
        eps_of_plants=tuple(eps),
        eps_opt=min(float(optimal_margins(shaped(G, weight))[0]) for G in models),
        weight=weight,
        readings=read,
        at_bounds=at_bounds,
        setpoint_parameters=setpoint,
        sampling=sampling,
        search=search,
    )


def _placed(points: Array, which: Indices, values: Array) -> Array:
    """Points (n, p), all like ``points`` (p,) but for the columns ``which``, which are ``values`` (n, k)."""
    placed = np.tile(points, (len(values), 1))
    placed[:, which] = values
    return placed
