"""The bounded fit on continuous parameters: gain, zeros, poles, natural frequencies, damping and dead time.

The model is sampled exactly at every step of the search, so that its parameters are those of the plant and
not of its sampled image. The numerator enters linearly and is eliminated; poles are searched in logarithms,
within bounds that the record can show. The dead time is first tried at a few values, from none to the
largest, with the poles followed along; then it is searched together with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from design.errors import DesignError
from design.identification.estimators.assembly import Assembly, check_samples, estimated
from design.identification.estimators.dynamics_problem import (
    Candidate,
    DynamicsProblem,
    FreeNumerator,
    Parametrisation,
)
from design.identification.estimators.estimate import Estimate, Models
from design.identification.estimators.levenberg_marquardt import STATISTICAL_TOLERANCE, Outcome, minimise
from design.identification.estimators.pole_search import ROUGHLY
from design.identification.estimators.pole_sections import PoleSections
from design.identification.estimators.simulation_error import Dynamics, SimulationError, Slopes
from design.identification.estimators.start_values import start_values
from design.identification.models.held_discretisation import held_numerators, hold
from design.identification.models.model import ContinuousModel, as_polynomial
from design.identification.models.structures import ContinuousPoles
from design.identification.records.experiment import Experiment
from design.mathematics.polynomials import Array

MAX_DEAD_SHARE = 0.25
"""Largest dead time that is searched, as a share of the longest record."""
DEAD_TIMES = 16
"""Largest number of dead times that are tried before the search."""
_STEP = 1e-5
"""Step of the central differences of the sampled model by its parameters."""


@dataclass(frozen=True)
class HeldPoles:
    """Continuous poles and a dead time behind a zero-order hold. θ is that of the poles, then the dead time.

    The dead time is in samples. If it is not ``searched``, it is ``dead_samples``.
    """

    sections: PoleSections
    zeros: int
    integrators: int
    searched: bool = False
    dead_samples: float = 0.0
    max_dead_samples: float = 0.0
    max_step: float = 2.0

    def bounds(self, samples: int) -> tuple[Array, Array]:
        """Return the lower and upper bounds (p,) of θ for a record of this many samples."""
        low, high = self.sections.bounds(samples)
        if self.searched:
            low, high = np.append(low, 0.0), np.append(high, self.max_dead_samples)
        return low, high

    def dynamics(self, theta: Array) -> Dynamics:
        """Return the sampled dynamics at θ (p,)."""
        whole, rest = divmod(theta[-1] if self.searched else self.dead_samples, 1.0)
        f, numerators = self._sampled(theta[None], int(whole), np.array([rest]))
        return Dynamics(f[0], numerators[0] if self.max_dead_samples else numerators[0, :-1], int(whole) + 1)

    def slopes(self, theta: Array) -> Slopes:
        """Return the derivatives of the sampled dynamics by θ."""
        p = len(theta)
        steps = _STEP * np.eye(p)
        around = np.concatenate([theta + steps, theta - steps])
        dead = around[:, -1] if self.searched else np.full(2 * p, self.dead_samples)
        whole = int(np.floor(theta[-1] if self.searched else self.dead_samples))
        f, numerators = self._sampled(around, whole, dead - whole)
        df, dnumerators = ((part[:p] - part[p:]) / (2.0 * _STEP) for part in (f, numerators))
        if not self.max_dead_samples:
            dnumerators = dnumerators[:, :-1]
        return Slopes(df[:, 1:].T, np.moveaxis(dnumerators, 0, -1))

    def continuous_den(self, theta: Array) -> Array:
        """Return the denominator (n + 1,) in falling powers of s."""
        return as_polynomial([*self.sections.continuous(theta), *[np.array([1.0, 0.0])] * self.integrators])

    def _sampled(self, thetas: Array, whole: int, rest: Array) -> tuple[Array, Array]:
        poles = thetas[:, : self.sections.order]
        dens = np.array([self.continuous_den(theta) for theta in poles])
        f = np.array([self.sections.f(theta) for theta in poles])
        for _ in range(self.integrators):
            f = np.concatenate([f, np.zeros((len(f), 1))], axis=1) - np.concatenate(
                [np.zeros((len(f), 1)), f], axis=1
            )
        T = self.sections.sample_time_s
        return f, held_numerators(dens, f, whole, rest, self.zeros + 1, T)


def fit_continuous(
    experiments: Sequence[Experiment], structure: ContinuousPoles, *, drift: bool = False
) -> Estimate:
    """Fit continuous poles, zeros and a dead time to one or more experiments of one sample time.

    Each experiment has its own offset and initial state and, with ``drift``, a slope of its output; behind
    an integrator the slope is that of the input offset. Raises DesignError where the data cannot determine
    so many unknowns.
    """
    T = experiments[0].sample_time_s
    most = structure.max_dead_time_s / T
    longest_s = max(len(experiment) for experiment in experiments) * T
    if structure.max_dead_time_s > MAX_DEAD_SHARE * longest_s:
        raise DesignError(
            f"{structure}: max_dead_time_s is {structure.max_dead_time_s:g} s, but the longest record has "
            f"only {longest_s:g} s; at most a quarter of a record can be searched for a dead time"
        )
    skipped = int(np.ceil(most)) if most else 0
    data = SimulationError(experiments, skipped=skipped, drift=drift, integrators=structure.integrators)
    sections = PoleSections(structure.real, structure.pairs, T)
    parameters = sections.order + structure.zeros + 1 + bool(most)
    check_samples(data.residuals, parameters + data.unknowns(structure.order), str(structure))
    model = HeldPoles(sections, structure.zeros, structure.integrators, bool(most), 0.0, most)
    problem = DynamicsProblem(data, model)
    outcome = _best(
        problem,
        [_with_dead_time(data, model, theta) for theta in _starts(data, model)]
        if most
        else _starts(data, model),
    )
    if outcome is None:
        raise DesignError(
            f"{structure}: no model can be simulated on the data; check the units of the signals"
        )
    gains = outcome.trial.simulated.gains
    count = len(gains)

    def build(values: Array) -> Models:
        theta = values[count:]
        dead_time_s = float(theta[-1]) * T if most else 0.0
        continuous = ContinuousModel(
            values[count - 1 :: -1], model.continuous_den(theta[: sections.order]), max(dead_time_s, 0.0)
        )
        return Models(hold(continuous, T), continuous)

    names = [f"numerator s^{i}" for i in range(count)]
    names += [f"log real pole {i + 1}" for i in range(sections.real)]
    names += [
        f"log {part} {i + 1}" for i in range(sections.pairs) for part in ("natural frequency", "damping")
    ]
    names += ["dead time in samples"] if most else []
    if most and outcome.theta[-1] < 0.5 * most:
        # No dead time at all is an answer, not a bound of the search.
        outcome = replace(
            outcome, at_bound=outcome.at_bound & (np.arange(len(outcome.theta)) < sections.order)
        )
    return estimated(
        problem, outcome, Assembly(structure, tuple(names), np.concatenate([gains, outcome.theta]), build)
    )


def _starts(data: SimulationError, model: HeldPoles) -> list[Array]:
    """Return the start values of the poles, without dead time."""

    def family(sections: PoleSections, averaged: int = 1) -> Parametrisation:
        order = sections.order + model.integrators
        if averaged > 1 and not model.integrators:
            return FreeNumerator(sections, order + 1, 0)
        return HeldPoles(sections, min(model.zeros, order - 1), model.integrators)

    return start_values(data, model.sections, family)


def _with_dead_time(data: SimulationError, model: HeldPoles, theta: Array) -> Array:
    """Return the best of a few dead times and its poles, which are followed from one to the next."""
    most = model.max_dead_samples
    best, best_cost = np.append(theta, 0.0), np.inf
    for dead in np.linspace(0.0, most, min(DEAD_TIMES, int(np.ceil(most)) + 1)):
        fixed = HeldPoles(model.sections, model.zeros, model.integrators, False, float(dead), most)
        outcome = minimise(DynamicsProblem(data, fixed), theta, ROUGHLY)
        if outcome is None:
            continue
        theta = outcome.theta
        if outcome.trial.cost < best_cost:
            best, best_cost = np.append(theta, dead), outcome.trial.cost
    return best


def _best(problem: DynamicsProblem, starts: Sequence[Array]) -> Outcome[Candidate] | None:
    found = [
        outcome
        for theta in starts
        if (outcome := minimise(problem, theta, STATISTICAL_TOLERANCE)) is not None
    ]
    return min(found, key=lambda outcome: outcome.trial.cost, default=None)
