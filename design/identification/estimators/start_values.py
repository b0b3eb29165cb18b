"""Start values from a part of a long record.

A grid of poles costs one simulation a point, too much for a million samples. Then the poles are searched
twice: on an excerpt, which shows the fast ones, and on averages over several samples, which show the slow
ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from design.identification.estimators.dynamics_problem import DynamicsProblem, Parametrisation
from design.identification.estimators.pole_search import Start, search_poles
from design.identification.estimators.pole_sections import PoleSections
from design.identification.estimators.simulation_error import SimulationError
from design.identification.records.experiment import Experiment
from design.mathematics.polynomials import Array

SEARCH_SAMPLES = 12_000
"""Number of samples on which poles are searched."""


class Family(Protocol):
    """Models that differ in their poles, as functions of the number of poles."""

    def __call__(self, sections: PoleSections, averaged: int = 1, /) -> Parametrisation:
        """Return the model with these poles, for data of which ``averaged`` samples each were averaged."""
        ...


def start_values(data: SimulationError, sections: PoleSections, family: Family) -> list[Array]:
    """Return start values of the poles: a few candidates, or the best one alone if the record is long."""
    total = sum(map(len, data.experiments))
    if total <= SEARCH_SAMPLES:
        return [start.theta for start in search_poles(data, sections, family)]
    drift, integrators = len(data.powers) > 1, data.powers.start
    factor = -(-total // SEARCH_SAMPLES)
    found: list[Start] = []
    for averaged, parts in ((1, excerpts(data.experiments)), (factor, averages(data.experiments, factor))):
        short = SimulationError(parts, drift=drift, integrators=integrators)
        if short.residuals > 8 * sections.order + 8:
            own = replace(sections, sample_time_s=parts[0].sample_time_s)

            def coarse(smaller: PoleSections, averaged: int = averaged) -> Parametrisation:
                return family(smaller, averaged)

            found += search_poles(short, own, coarse)
    problem = DynamicsProblem(data, family(sections))
    trials = [
        (problem.trial(np.clip(start.theta, problem.lower, problem.upper)), start.theta) for start in found
    ]
    ranked = sorted(((trial.cost, i) for i, (trial, _) in enumerate(trials) if trial is not None))
    return [trials[i][1] for _, i in ranked[:1]]


def excerpts(experiments: Sequence[Experiment]) -> list[Experiment]:
    """Return the same share of each experiment, from where its input moves most."""
    total = sum(map(len, experiments))
    return [
        _liveliest(experiment, max(1, len(experiment) * SEARCH_SAMPLES // total))
        for experiment in experiments
    ]


def _liveliest(experiment: Experiment, samples: int) -> Experiment:
    known = np.isfinite(experiment.u) & experiment.observed
    moves = np.concatenate([[0.0], np.abs(np.diff(np.where(known, experiment.u, 0.0)))])
    total = np.cumsum(moves * known)
    starts = np.arange(0, len(experiment) - samples + 1, max(samples // 2, 1))
    best = int(starts[np.argmax(total[starts + samples - 1] - total[starts])])
    return experiment.part(best, best + samples)


def averages(experiments: Sequence[Experiment], factor: int) -> list[Experiment]:
    """Return averages over ``factor`` samples each. An average over an unknown sample is unknown."""
    found = []
    for experiment in experiments:
        rows = len(experiment) // factor
        if rows:
            u = experiment.u[: rows * factor].reshape(rows, factor).mean(axis=1)
            y = (
                np.where(experiment.observed, experiment.y, np.nan)[: rows * factor]
                .reshape(rows, factor)
                .mean(axis=1)
            )
            found.append(
                Experiment(
                    u, y, factor * experiment.sample_time_s, name=experiment.name, names=experiment.names
                )
            )
    return found
