"""Synthesise a controller of fixed structure, eqs. (13) and (14): the parameters of largest margin ε.

The design is for one plant, or for the worst of several with one weight. The loop is continuous, or sampled
with hold and delay and the controller by Tustin's rule, so that the evaluated controller is the one that
runs. The fitness of a candidate is ε if all its loops are stable and meet the specifications (if any), and
below 0 otherwise; see ``design.closed_loop.assessment``.

No margin depends on the parameters that shape only the setpoint response (the setpoint weights b and c of
"pid-2dof"). These are chosen last, with the feedback fixed: the specifications are met if possible, and among
such values the integral ∫ t |e| dt after a setpoint step (ITAE) is least.
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
from design.models.controller import Controller
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
from design.synthesis.structures import Structure, setpoint_parameters, structure_name

_SETPOINT_EVALUATIONS = 600
"""Evaluations for each parameter that shapes only the setpoint response."""
_VIOLATION_WEIGHT, _MAX_ITAE = 1e6, 1e5
"""Weight of violations over ITAE in the choice of the setpoint parameters, and cap on the ITAE in s²."""


@dataclass(frozen=True)
class Synthesis:
    """A synthesised controller, its margin and its readings."""

    structure: Structure
    parameters: dict[str, float]
    """Parameter values by name, in the structure's order."""
    eps: float
    """Margin of the loop that was designed for; over several plants, the smallest."""
    eps_of_plants: tuple[float, ...]
    """Margin with each plant."""
    eps_opt: float
    """Largest margin that any controller has with this weight; over several plants, the smallest of these."""
    weight: TransferFunction
    """W1(s), num and den (n + 1,)."""
    readings: tuple[Reading, ...]
    """Imposed specifications, read off the designed loop; over several plants, off the worst loop."""
    at_bounds: tuple[str, ...]
    """Names of the parameters that lie at a search bound; a wider search range may allow a larger ε."""
    setpoint_parameters: tuple[str, ...]
    """Names of the parameters that shape only the setpoint response; no margin depends on them."""
    sampling: Sampling | None
    """Sampling of the loop; None for the continuous loop."""
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
    """Find the controller of largest margin that meets the specifications.

    ``aims`` are specifications that only the setpoint parameters try to meet, at no cost of margin.
    ``searcher`` makes a searcher for a number of parameters; without it, differential evolution is used with
    ``seed`` and ``evaluations``. Raises NotStabilisedError if no candidate stabilises every plant, and
    InfeasibleError if none meets the specifications.
    """
    candidates = _Candidates(loop_models(plants, sampling), weight, structure, sampling)
    # Setpoint parameters influence only specifications; without these, they are not searched with the others.
    searched = candidates.all if specifications else candidates.feedback
    centre = np.full(len(candidates.all), 0.5)

    def objective(points: Array, cutoff: Array) -> Array:
        return worst(candidates.assess(_placed(centre, searched, points), specifications, cutoff)).fitness

    make = searcher or partial(DifferentialEvolution, seed=seed, evaluations=evaluations)
    search = maximise(objective, make(len(searched)), on_progress)
    best = _placed(centre, searched, search.best[None, :])[0]
    if len(candidates.setpoint) and search.best_fitness > 0.0:
        best = _best_setpoint_parameters(candidates, best, (*specifications, *aims), seed)
    assessments = candidates.assess(best[None, :], specifications)
    if not all(bool(assessment.stable[0]) for assessment in assessments):
        raise NotStabilisedError(
            f'no controller of the structure "{structure_name(structure)}" within the search bounds '
            f"stabilises the plant: the best of {search.evaluations} candidates has a closed-loop pole at "
            f"Re s = {worst(assessments).growth[0]:.3g} rad/s; widen the search ranges, or choose another "
            "structure" + limit_notes(plants, sampling)
        )
    synthesis = candidates.synthesis(best, assessments, search, specifications)
    if search.best_fitness < 0.0:
        raise InfeasibleError(
            compromise("controller", synthesis.parameters, synthesis.at_bounds, synthesis.readings)
            + limit_notes(plants, sampling)
        )
    return synthesis


class _Candidates:
    """The controllers of one structure, each a point of the unit cube, in the loops with every plant."""

    def __init__(
        self,
        models: Sequence[TransferFunction],
        weight: TransferFunction,
        structure: Structure,
        sampling: Sampling | None,
    ) -> None:
        self._models, self._weight, self._structure, self._sampling = models, weight, structure, sampling
        self._bounds = SearchBounds(structure.parameters)
        self._setpoint_names = setpoint_parameters(structure)
        is_setpoint = np.array([name in self._setpoint_names for name in self._bounds.names])
        self.all: Indices = np.arange(len(self._bounds))
        """Columns of all parameters."""
        self.setpoint: Indices = np.flatnonzero(is_setpoint)
        """Columns of the parameters that shape only the setpoint response."""
        self.feedback: Indices = np.flatnonzero(~is_setpoint)
        """Columns of the parameters that the margins depend on."""

    def assess(
        self, points: Array, specifications: Sequence[Specification], cutoff: Array | None = None
    ) -> list[Assessment]:
        """Return the assessments of points (n, p), one for each plant; ``cutoff`` (n,) as for ``assess``."""
        K = self._controllers(points)
        by_plant = []
        for G in self._models:
            margin = margins.stability_margin(G, K.feedback, self._weight, cutoff)
            by_plant.append(assess(self._loops(G, K), margin, margin > 0.0, specifications, cutoff))
        return by_plant

    def setpoint_cost(self, points: Array, specifications: Sequence[Specification]) -> Array:
        """Return, for points (n, p), the cost (n,) of the setpoint response with the worst plant."""
        K = self._controllers(points)
        costs = []
        for G in self._models:
            loops = self._loops(G, K)
            violation = violations(specifications, loops)
            costs.append(_VIOLATION_WEIGHT * violation + np.minimum(loops.itae, _MAX_ITAE))
        return np.asarray(np.max(costs, axis=0))

    def synthesis(
        self,
        point: Array,
        assessments: Sequence[Assessment],
        search: SearchResult,
        specifications: Sequence[Specification],
    ) -> Synthesis:
        """Return the controller at a point (p,), whose assessment with each plant is known."""
        values = self._bounds.decode(point[None, :])[0]
        eps = tuple(float(assessment.margin[0]) for assessment in assessments)
        most_violated = self._models[int(np.argmax([one.violation[0] for one in assessments]))]
        loop = self._loops(most_violated, self._controllers(point[None, :]))
        at_bounds = self._bounds.at_bounds(point)
        return Synthesis(
            structure=self._structure,
            parameters=dict(zip(self._bounds.names, map(float, values), strict=True)),
            eps=min(eps),
            eps_of_plants=eps,
            eps_opt=min(float(optimal_margins(shaped(G, self._weight))[0]) for G in self._models),
            weight=self._weight,
            readings=readings(specifications, loop),
            at_bounds=tuple(name for name in at_bounds if name not in self._setpoint_names),
            setpoint_parameters=self._setpoint_names,
            sampling=self._sampling,
            search=search,
        )

    def _controllers(self, points: Array) -> Controller:
        return self._structure.controller(self._bounds.decode(points))

    def _loops(self, G: TransferFunction, K: Controller) -> ClosedLoops:
        return ClosedLoops(G, K, W=self._weight, sampling=self._sampling)


def _best_setpoint_parameters(
    candidates: _Candidates, point: Array, specifications: Sequence[Specification], seed: int
) -> Array:
    """Return the point (p,) with the setpoint parameters of least cost; the feedback stays."""
    columns = candidates.setpoint
    evaluations = _SETPOINT_EVALUATIONS * len(columns)
    search = maximise(
        lambda points, _cutoff: -candidates.setpoint_cost(_placed(point, columns, points), specifications),
        DifferentialEvolution(len(columns), seed=seed, evaluations=evaluations),
    )
    return np.asarray(_placed(point, columns, search.best[None, :])[0])


def _placed(point: Array, columns: Indices, values: Array) -> Array:
    """Return copies (n, p) of a point (p,) in which the given columns are replaced by ``values`` (n, k)."""
    placed = np.tile(point, (len(values), 1))
    placed[:, columns] = values
    return placed
