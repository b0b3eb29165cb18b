"""Start values for the poles of a model: poles are added where they lower the simulation error most.

The error for given poles is found by linear least squares, so that a grid of poles costs little. A model of
order 1 or 2 is searched on a grid over all frequencies that the record can show, and improved; then pairs
are added, one at a time, in the same way. A few candidates are carried along, for the best model of low
order is not always part of the best one of high order. From order 4 on, or where the residuals are coloured,
each section of the result is finally taken out and searched again. No step needs an output sample that is
missing, and none can become unstable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from design.identification.estimators.correlation import autocorrelation
from design.identification.estimators.dynamics_problem import DynamicsProblem, Parametrisation
from design.identification.estimators.levenberg_marquardt import minimise
from design.identification.estimators.pole_sections import PoleSections, regrouped
from design.identification.estimators.simulation_error import SimulationError
from design.mathematics.polynomials import Array

FREQUENCIES = 10
"""Grid points from one period in the record to half the sampling frequency."""
DAMPINGS = (0.1, 0.8)
"""Damping ratios of the pairs on the grid."""
KEPT = 2
"""Candidates that are carried to the next order."""
IMPROVED = 3
"""Grid points that are improved before the best are kept."""
ROUGHLY = 1e-3
"""Tolerance of the improvement of a start value, in units of one residual's variance."""
SEARCHED_AGAIN_FROM = 4
"""Order from which each section is searched a second time, whatever the residuals."""
MAX_COLOUR = 0.2
"""Correlation of neighbouring residuals above which each section is searched a second time."""

Family = Callable[[PoleSections], Parametrisation]
"""The models that are compared with the data, for given numbers of poles. θ is that of the poles."""


class Start(NamedTuple):
    """Poles in logarithms, with the cost of the best model that has them."""

    cost: float
    theta: Array


def search_poles(data: SimulationError, sections: PoleSections, family: Family) -> list[Start]:
    """Return start values for the poles, best first. Empty where no candidate is admissible."""
    found = [Start(np.inf, np.zeros(0))]
    for smaller in _growing(sections):
        problem = DynamicsProblem(data, family(smaller))
        longer = (grown for start in found for grown in _with_one_more(start.theta, smaller, problem))
        found = _improved(problem, smaller, _evaluated(problem, longer)[:IMPROVED])[:KEPT]
    problem = DynamicsProblem(data, family(sections))
    if found and (sections.order >= SEARCHED_AGAIN_FROM or _colour(problem, found[0]) > MAX_COLOUR):
        found = [_searched_again(problem, sections, found[0]), *found[1:]]
    return found


def _colour(problem: DynamicsProblem, start: Start) -> float:
    """Return the correlation of neighbouring residuals. Dynamics that were missed make it large."""
    trial = problem.trial(start.theta)
    if trial is None:
        return 0.0
    fitted = problem.data.fitted(trial.simulated)
    return abs(float(autocorrelation([part.residual * part.stretch.root_weight for part in fitted], 1)[0][1]))


def _growing(sections: PoleSections) -> Iterable[PoleSections]:
    """Yield the smaller sets of poles that lead to ``sections``: real poles first, then pair after pair."""
    for real in range(1, sections.real + 1):
        yield PoleSections(real, 0, sections.sample_time_s)
    for pairs in range(1, sections.pairs + 1):
        yield PoleSections(sections.real, pairs, sections.sample_time_s)


def _grid(problem: DynamicsProblem, pair: bool) -> list[Array]:
    """Return the values of one section, over the frequencies that the record can show."""
    T = problem.sample_time_s
    logs = np.log(np.geomspace(1.0 / problem.longest, 2.5, FREQUENCIES) / T)
    if not pair:
        return [np.array([log]) for log in logs]
    return [np.array([log, np.log(zeta)]) for log in logs for zeta in DAMPINGS]


def _with_one_more(theta: Array, sections: PoleSections, problem: DynamicsProblem) -> Iterable[Array]:
    for section in _grid(problem, pair=sections.pairs > 0):
        yield np.concatenate([theta, section])


def _evaluated(problem: DynamicsProblem, thetas: Iterable[Array]) -> list[Start]:
    """Return the admissible candidates, best first."""
    trials = [(problem.trial(theta), theta) for theta in thetas]
    found = [Start(trial.cost, theta) for trial, theta in trials if trial is not None]
    return sorted(found, key=lambda start: start.cost)


def _improved(problem: DynamicsProblem, sections: PoleSections, starts: Iterable[Start]) -> list[Start]:
    """Return the different optima that are reached from the starts, best first."""
    found: list[Start] = []
    for start in starts:
        best = improved(problem, sections, start.theta, ROUGHLY)
        if best is not None and not any(abs(best.cost - other.cost) <= 1e-5 * other.cost for other in found):
            found.append(best)
    return sorted(found, key=lambda start: start.cost)


def improved(
    problem: DynamicsProblem, sections: PoleSections, theta: Array, tolerance: float
) -> Start | None:
    """Return the optimum that is reached from θ, if need be through a new grouping of the real poles.

    Two equal poles in different sections cannot become a complex pair, and the slope there is 0.
    """
    best: Start | None = None
    for _ in range(3):
        outcome = minimise(problem, theta, tolerance)
        if outcome is None or (best is not None and outcome.trial.cost >= best.cost * (1.0 - 1e-9)):
            return best
        best = Start(outcome.trial.cost, outcome.theta)
        theta = regrouped(sections, best.theta)
        if np.allclose(theta, best.theta, rtol=0.0, atol=1e-9):
            return best
    return best


def _searched_again(problem: DynamicsProblem, sections: PoleSections, best: Start) -> Start:
    """Return the best result of taking out one section after the other and searching it on the grid."""
    for span in sections.spans:
        thetas = []
        for values in _grid(problem, pair=span.stop - span.start == 2):
            theta = best.theta.copy()
            theta[span] = values
            thetas.append(theta)
        for candidate in _improved(problem, sections, _evaluated(problem, thetas)[:IMPROVED]):
            best = min(best, candidate, key=lambda start: start.cost)
    return best
