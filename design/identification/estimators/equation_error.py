"""ARX and ARMAX models, A y = q^-nk B u + C e, by the prediction error.

For given C the prediction error (A y - B u - offset) / C is linear in A, B and the offset; they are
eliminated, and C alone is searched. A row counts only if every value in it was measured, so a gap begins a
new run, with an initial state of 1/C of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from design.errors import DesignError
from design.identification.estimators.assembly import check_samples
from design.identification.estimators.covariance import covariance
from design.identification.estimators.dynamics_problem import eliminated
from design.identification.estimators.elimination import Layout, Reduced, projected, reduce
from design.identification.estimators.estimate import Estimate, Models, Offsets, Parameters
from design.identification.estimators.levenberg_marquardt import minimise
from design.identification.estimators.noise_filters import coordinates, is_stable, monic, past, stabilised
from design.identification.least_squares import solved
from design.identification.models.difference_basis import basis, differences
from design.identification.models.model import DiscreteModel
from design.identification.models.structures import Armax, Arx
from design.identification.records.experiment import Experiment, runs
from design.mathematics.polynomials import Array

LONG_AUTOREGRESSION = 20
"""Order of the ARX model whose residuals give the start values of C."""


class Run(NamedTuple):
    """Consecutive rows of A y - B u - offset = C e; arrays over m rows."""

    experiment: int
    start: int
    common: Array
    """Powers of the relative time (c, m) that the offset and the drift multiply."""
    regressors: Array
    """Columns (na + nb, m) of A's and B's coordinates, with the sign that they have in y = …"""
    y: Array
    root_weight: Array


@dataclass(frozen=True)
class Predicted:
    """A candidate C with the best A and B."""

    cost: float
    theta: Array
    linear: Array
    columns: list[Array]
    reduced: Reduced


class EquationError:
    """The prediction error of ARX and ARMAX models as a function of C, for :func:`minimise`."""

    max_step = np.inf

    def __init__(
        self, experiments: Sequence[Experiment], na: int, nb: int, nc: int, nk: int, drift: bool
    ) -> None:
        self.na, self.nb, self.nc, self.drift = na, nb, nc, drift
        self.runs = [run for i, e in enumerate(experiments) for run in _runs(i, e, na, nb, nk, drift, nc + 1)]
        self.residuals = sum(len(run.y) for run in self.runs)
        self.scale = float(sum(np.sum((run.root_weight * run.y) ** 2) for run in self.runs))
        self.lower, self.upper = np.full(nc, -np.inf), np.full(nc, np.inf)
        offsets = len({run.experiment for run in self.runs}) * (1 + drift)
        self.unknowns = na + nb + nc + offsets + nc * len(self.runs)

    def trial(self, theta: Array) -> Predicted | None:
        """Find the best A and B for C at θ. None where C is not stable."""
        c = monic(theta)
        if not is_stable(c):
            return None
        columns = []
        for run in self.runs:
            impulse = np.zeros(len(run.y))
            impulse[0] = 1.0
            block = np.concatenate([run.common, run.regressors, run.y[None]])
            if self.nc:
                block = lfilter([1.0], c, block, axis=-1)
            columns.append(np.concatenate([differences(lfilter([1.0], c, impulse), self.nc, 0), block]))
        reduced = self._reduce(columns)
        A, right = reduced.shared[:, :-1], reduced.shared[:, -1]
        linear = solved(A, right)
        return Predicted(float(np.sum((right - A @ linear) ** 2)), theta, linear, columns, reduced)

    def linearised(self, trial: Predicted) -> tuple[Array, Array]:
        """Return J (r, p) and e (r,): the residuals near the trial are e - J δ, up to an orthogonal part."""
        R = self._reduce(self._with_slopes(trial)).shared
        linear = self.na + self.nb
        return eliminated(R[:, :linear], R[:, linear:-1], R[:, -1])

    def sensitivities(self, trial: Predicted) -> list[Array]:
        """Return the weighted derivatives (p, m) of the prediction on each run, nuisances eliminated."""
        columns = self._with_slopes(trial)
        experiments = [run.experiment for run in self.runs]
        found = projected(columns, experiments, self._reduce(columns))
        return [block * run.root_weight for block, run in zip(found, self.runs, strict=True)]

    def errors(self, trial: Predicted) -> list[Array]:
        """Return the prediction error e (m,) on each run."""
        shared = np.concatenate([trial.linear, [-1.0]])
        values = {i: trial.reduced.common_values(i, shared) for i in {run.experiment for run in self.runs}}
        common = [values[run.experiment] for run in self.runs]
        local = trial.reduced.local_values(common, shared)
        return [
            -np.concatenate([*unknowns, shared]) @ block
            for block, *unknowns in zip(trial.columns, local, common, strict=True)
        ]

    def offset(self, trial: Predicted, experiment: int) -> Array:
        """Return the offset and drift (c,) of an experiment on the right side of A y = B u + …"""
        return trial.reduced.common_values(experiment, np.concatenate([trial.linear, [-1.0]]))

    def _with_slopes(self, trial: Predicted) -> list[Array]:
        c = monic(trial.theta)
        blocks = []
        for block, e in zip(trial.columns, self.errors(trial), strict=True):
            slopes = differences(lfilter([1.0], c, e), self.nc, 1)
            blocks.append(np.concatenate([block[:-1], slopes, e[None]]))
        return blocks

    def _reduce(self, columns: list[Array]) -> Reduced:
        common = 1 + self.drift
        weighted = [block * run.root_weight for block, run in zip(columns, self.runs, strict=True)]
        layout = Layout(self.nc, common, len(columns[0]) - self.nc - common)
        return reduce(weighted, [run.experiment for run in self.runs], layout)


def fit_equation_error(
    experiments: Sequence[Experiment], structure: Arx | Armax, *, drift: bool = False
) -> Estimate:
    """Fit an ARX or ARMAX model to one or more experiments of one sample time.

    Raises DesignError where the data cannot determine so many unknowns.
    """
    na, nb, nk = structure.na, structure.nb, structure.nk
    nc = structure.nc if isinstance(structure, Armax) else 0
    problem = EquationError(experiments, na, nb, nc, nk, drift)
    check_samples(problem.residuals, problem.unknowns, str(structure))
    found = [
        outcome
        for start in (
            [np.zeros(0)] if not nc else [_noise_start(experiments, structure, nc, drift), np.zeros(nc)]
        )
        if (outcome := minimise(problem, start)) is not None
    ]
    if not found:
        raise DesignError(
            f"{structure}: no model can be computed on the data; check the units of the signals"
        )
    outcome = min(found, key=lambda outcome: outcome.trial.cost)
    trial, T = outcome.trial, experiments[0].sample_time_s

    def build(values: Array) -> Models:
        a, c = monic(values[:na]), monic(values[na + nb :])
        return Models(DiscreteModel(basis(nb) @ values[na : na + nb], a, nk, T, c, a))

    values = np.concatenate([trial.linear, outcome.theta])
    errors = problem.errors(trial)
    uncertain = covariance(
        problem.sensitivities(trial),
        [e * run.root_weight for e, run in zip(errors, problem.runs, strict=True)],
        problem.unknowns,
    )
    residuals = [np.full(len(experiment), np.nan) for experiment in experiments]
    for run, e in zip(problem.runs, errors, strict=True):
        residuals[run.experiment][run.start : run.start + len(e)] = e
    names = [
        f"{letter} in (1 - 1/z)^{i}" for letter, n in (("a", na), ("b", nb), ("c", nc)) for i in range(n)
    ]
    return Estimate(
        structure=structure,
        parameters=Parameters(tuple(names), values, uncertain.matrix, build),
        experiments=tuple(experiments),
        residuals=tuple(residuals),
        offsets=tuple(
            _offsets(problem, trial, i, e, build(values).discrete) for i, e in enumerate(experiments)
        ),
        noise_std=uncertain.noise_std,
        noise_order=uncertain.noise_order,
        cost=trial.cost,
        samples=problem.residuals,
        unknowns=problem.unknowns,
        converged=outcome.converged,
    )


def _runs(
    index: int, experiment: Experiment, na: int, nb: int, nk: int, drift: bool, shortest: int
) -> list[Run]:
    """Return the runs of rows in which every value is known."""
    pad = np.full(max(na, nk + nb), np.nan)
    y = np.concatenate([pad, np.where(experiment.observed, experiment.y, np.nan)])
    u = np.concatenate([pad, experiment.u])
    regressors = np.concatenate([-differences(y, na, 1), differences(u, nb, nk)])[:, len(pad) :]
    y = y[len(pad) :]
    t = np.arange(len(y)) / max(len(y) - 1, 1) - 0.5
    common = np.stack([t**power for power in range(1 + drift)])
    found = []
    for first, last in runs(np.isfinite(y) & np.isfinite(regressors).all(axis=0)):
        if last - first >= shortest:
            part = slice(first, last)
            root = np.sqrt(experiment.weights[part])
            found.append(Run(index, first, common[:, part], regressors[:, part], y[part], root))
    return found


def _noise_start(experiments: Sequence[Experiment], structure: Arx | Armax, nc: int, drift: bool) -> Array:
    """Return the coordinates of C from the residuals of a long ARX model (Hannan and Rissanen)."""
    na, nb, nk = structure.na, structure.nb, structure.nk
    long = EquationError(experiments, LONG_AUTOREGRESSION + na, LONG_AUTOREGRESSION + nb, 0, nk, drift)
    if long.residuals < 4 * long.unknowns:
        return np.zeros(nc)
    trial = long.trial(np.zeros(0))
    if trial is None:
        return np.zeros(nc)
    innovations = [np.full(len(experiment), np.nan) for experiment in experiments]
    for run, e in zip(long.runs, long.errors(trial), strict=True):
        innovations[run.experiment][run.start : run.start + len(e)] = e
    rows, right = [], []
    for run in EquationError(experiments, na, nb, 0, nk, drift).runs:
        e = innovations[run.experiment][run.start : run.start + len(run.y)]
        block = np.concatenate([run.regressors, past(e, nc), run.common])
        complete = np.isfinite(block).all(axis=0)
        rows.append(block[:, complete].T)
        right.append(run.y[complete])
    stacked = np.concatenate(rows)
    if len(stacked) < 2 * stacked.shape[1]:
        return np.zeros(nc)
    values = solved(stacked, np.concatenate(right))
    c = np.concatenate([[1.0], values[na + nb : na + nb + nc]])
    return coordinates(stabilised(c))


def _offsets(
    problem: EquationError, trial: Predicted, index: int, experiment: Experiment, model: DiscreteModel
) -> Offsets:
    if not any(run.experiment == index for run in problem.runs):
        return Offsets(None, None, 0.0)
    values = problem.offset(trial, index)
    with np.errstate(divide="ignore", invalid="ignore"):
        rest, held = values[0] / model.f.sum(), -values[0] / model.b.sum()
        slope = values[1] / model.f.sum() if problem.drift else 0.0
    duration = max(len(experiment) - 1, 1) * experiment.sample_time_s
    return Offsets(
        float(rest) if np.isfinite(rest) else None,
        float(held) if np.isfinite(held) else None,
        float(slope) / duration if np.isfinite(slope) else 0.0,
    )
