"""From the end of a search over simulation errors to an estimate."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from design.errors import DesignError
from design.identification.estimators.covariance import covariance
from design.identification.estimators.dynamics_problem import Candidate, DynamicsProblem
from design.identification.estimators.estimate import Estimate, Models, Parameters, offsets_of
from design.identification.estimators.levenberg_marquardt import Outcome
from design.identification.models.structures import Structure
from design.mathematics.polynomials import Array


class Assembly(NamedTuple):
    """Structure and coordinates of a model: the factors of its numerators first, then its dynamics."""

    structure: Structure
    names: tuple[str, ...]
    values: Array
    build: Callable[[Array], Models]


def check_samples(samples: int, unknowns: int, structure: str) -> None:
    """Refuse a structure with too many unknowns for the data. Raises DesignError."""
    if samples < 2 * unknowns:
        raise DesignError(
            f"{structure}: {samples} usable output samples for {unknowns} unknowns (parameters, initial "
            "states, offsets); record longer, or choose a smaller structure"
        )


def estimated(problem: DynamicsProblem, outcome: Outcome[Candidate], assembly: Assembly) -> Estimate:
    """Return the covariance, residuals and offsets at the end of a search."""
    data, simulated = problem.data, outcome.trial.simulated
    order, parameters = len(simulated.dynamics.f) - 1, len(assembly.values)
    unknowns = parameters + data.unknowns(order)
    fitted = data.fitted(simulated)
    uncertain = covariance(
        data.sensitivities(simulated, problem.parameters.slopes(outcome.theta)),
        [part.residual * part.stretch.root_weight for part in fitted],
        unknowns,
    )
    residuals = [np.full(len(experiment), np.nan) for experiment in data.experiments]
    common: dict[int, Array] = {}
    for stretch, _, values, residual in fitted:
        counts = np.flatnonzero(stretch.root_weight)
        residuals[stretch.experiment][stretch.start + counts] = residual[counts]
        common[stretch.experiment] = values
    discrete = assembly.build(assembly.values).discrete
    first_dynamic = parameters - len(outcome.theta)
    return Estimate(
        structure=assembly.structure,
        parameters=Parameters(assembly.names, assembly.values, uncertain.matrix, assembly.build),
        experiments=tuple(data.experiments),
        residuals=tuple(residuals),
        offsets=offsets_of(discrete, data.experiments, common, data.powers.start),
        noise_std=uncertain.noise_std,
        noise_order=uncertain.noise_order,
        cost=outcome.trial.cost,
        samples=data.residuals,
        unknowns=unknowns,
        converged=outcome.converged,
        at_bound=tuple(assembly.names[first_dynamic + i] for i in np.flatnonzero(outcome.at_bound)),
    )
