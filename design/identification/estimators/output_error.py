"""The output-error estimator OE(nb, nf, nk), by the simulation error of a free run.

Searched in the logarithms of continuous poles, from start values that a grid gives (``pole_search``). Poles
that no continuous system has, such as one on the negative real axis, are reached by a last search in the
coefficients of F themselves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from design.errors import DesignError
from design.identification.estimators.assembly import Assembly, check_samples, estimated
from design.identification.estimators.dynamics_problem import (
    Candidate,
    DynamicsProblem,
    FreeCoefficients,
    FreeNumerator,
)
from design.identification.estimators.estimate import Estimate, Models
from design.identification.estimators.levenberg_marquardt import STATISTICAL_TOLERANCE, Outcome, minimise
from design.identification.estimators.pole_search import improved
from design.identification.estimators.pole_sections import PoleSections
from design.identification.estimators.simulation_error import Dynamics, SimulationError
from design.identification.estimators.start_values import start_values
from design.identification.models.difference_basis import basis
from design.identification.models.model import DiscreteModel
from design.identification.models.structures import OutputError
from design.identification.records.experiment import Experiment
from design.mathematics.polynomials import Array


def fit_output_error(
    experiments: Sequence[Experiment], structure: OutputError, *, drift: bool = False
) -> Estimate:
    """Fit an output-error model to one or more experiments of one sample time.

    Each experiment has its own offset and initial state and, with ``drift``, a slope of its output. Raises
    DesignError where the data cannot determine so many unknowns.
    """
    nb, nf, nk = structure.nb, structure.nf, structure.nk
    data = SimulationError(experiments, skipped=max(0, nk + nb - 1 - nf), drift=drift)
    unknowns = nb + nf + data.unknowns(nf)
    check_samples(data.residuals, unknowns, str(structure))
    family = FreeCoefficients(nb, nf, nk)
    problem = DynamicsProblem(data, family)
    outcome = _polished(problem, family, _start(data, structure), str(structure))
    gains = outcome.trial.simulated.gains
    T = experiments[0].sample_time_s

    def build(values: Array) -> Models:
        f = np.concatenate([[1.0], basis(nf) @ values[nb:]])
        return Models(DiscreteModel(basis(nb) @ values[:nb], f, nk, T))

    names = (*(f"b in (1 - 1/z)^{i}" for i in range(nb)), *(f"f in (1 - 1/z)^{i}" for i in range(nf)))
    return estimated(
        problem, outcome, Assembly(structure, names, np.concatenate([gains, outcome.theta]), build)
    )


def _polished(
    problem: DynamicsProblem, family: FreeCoefficients, f: Array, structure: str
) -> Outcome[Candidate]:
    """Return the end of a search in the coefficients of F, or its start where rounding forbids one."""
    theta = basis(len(f) - 1) @ f[1:]
    outcome = minimise(problem, theta)
    if outcome is not None:
        return outcome
    simulated = problem.data.simulate(Dynamics(f, basis(family.nb), family.lag))
    if simulated is None:
        raise DesignError(
            f"{structure}: no model can be simulated on the data; check the units of the signals"
        )
    return Outcome(theta, Candidate(theta, simulated), True, np.zeros(len(theta), dtype=bool), 0)


def _start(data: SimulationError, structure: OutputError) -> Array:
    """Return F (nf + 1,) from the search in logarithms of the poles."""
    nb, nf, nk = structure.nb, structure.nf, structure.nk
    if nf == 0:
        return np.ones(1)
    sections = PoleSections.of_order(nf, data.experiments[0].sample_time_s)

    def family(smaller: PoleSections, averaged: int = 1) -> FreeNumerator:
        if averaged > 1:
            return FreeNumerator(smaller, smaller.order + 1, nk // averaged)
        return FreeNumerator(smaller, min(nb, smaller.order) if smaller.order < nf else nb, nk)

    problem = DynamicsProblem(data, family(sections))
    found = [
        improved(problem, sections, theta, STATISTICAL_TOLERANCE)
        for theta in start_values(data, sections, family)
    ]
    best = min(
        (result for result in found if result is not None), key=lambda result: result.cost, default=None
    )
    if best is None:
        raise DesignError(
            f"{structure}: no model can be simulated on the data; check the units of the signals"
        )
    return sections.f(best.theta)
