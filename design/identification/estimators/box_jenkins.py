"""Box-Jenkins models, y = q^-nk B/F u + C/D e, by the prediction error.

For given F, C and D the prediction error D/C (y - B/F u - offset) is linear in B, the offset and all
initial states, which are eliminated. The plant's part runs through samples that are missing; the noise
filter D/C, which works on measured outputs, begins anew after each gap.
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
from design.identification.estimators.estimate import Estimate, Models, Parameters, offsets_of
from design.identification.estimators.levenberg_marquardt import Outcome, minimise
from design.identification.estimators.noise_filters import coordinates, is_stable, monic, past, stabilised
from design.identification.estimators.output_error import fit_output_error
from design.identification.least_squares import solved
from design.identification.models.difference_basis import basis, differences
from design.identification.models.model import DiscreteModel
from design.identification.models.structures import BoxJenkins, OutputError
from design.identification.records.experiment import Experiment, Stretch, runs, stretches
from design.mathematics.polynomials import Array

LONG_AUTOREGRESSION = 20
"""Order of the autoregression whose residuals give the start values of C and D."""


class Run(NamedTuple):
    """Consecutive measured samples ``first`` to ``last`` (exclusive) of one stretch of known inputs."""

    stretch: int
    first: int
    last: int


@dataclass(frozen=True)
class Predicted:
    """Candidate C, D and F with the best B."""

    cost: float
    theta: Array
    linear: Array
    plant: list[Array]
    """Columns (nf + common + nb + 1, m) of each stretch before the noise filter."""
    columns: list[Array]
    """Columns of each run behind the noise filter, the noise filter's own initial states first."""
    reduced: Reduced


class BoxJenkinsError:
    """The prediction error of a Box-Jenkins model as a function of C, D and F, for :func:`minimise`."""

    max_step = np.inf

    def __init__(self, experiments: Sequence[Experiment], structure: BoxJenkins, drift: bool) -> None:
        self.structure, self.experiments, self.drift = structure, list(experiments), drift
        s = structure
        self.states = max(s.nc, s.nd)
        self.stretches = stretches(self.experiments, max(0, s.nk + s.nb - 1 - s.nf))
        self.runs = [
            Run(i, first, last)
            for i, stretch in enumerate(self.stretches)
            for first, last in runs(stretch.root_weight > 0.0)
            if last - first > self.states + 1
        ]
        parts = [(self.stretches[run.stretch], slice(run.first, run.last)) for run in self.runs]
        self.residuals = sum(run.last - run.first for run in self.runs)
        self.scale = float(sum(np.sum((s.root_weight[part] * s.y[part]) ** 2) for s, part in parts))
        count = s.nc + s.nd + s.nf
        self.lower, self.upper = np.full(count, -np.inf), np.full(count, np.inf)
        used = len({run.stretch for run in self.runs})
        self.unknowns = s.nb + count + self.states * len(self.runs) + (s.nf + 1 + drift) * used

    def polynomials(self, theta: Array) -> tuple[Array, Array, Array]:
        """Return C, D and F at θ."""
        s = self.structure
        c, d, f = np.split(theta, [s.nc, s.nc + s.nd])
        return monic(c), monic(d), monic(f)

    def trial(self, theta: Array) -> Predicted | None:
        """Find the best B for C, D and F at θ. None where one of them is not stable."""
        c, d, f = self.polynomials(theta)
        if not all(map(is_stable, (c, d, f))):
            return None
        plant = [self._plant_columns(stretch, f) for stretch in self.stretches]
        columns = [
            np.concatenate(
                [self._noise_states(run, c), lfilter(d, c, plant[run.stretch][:, run.first : run.last])]
            )
            for run in self.runs
        ]
        reduced = self._reduce(columns)
        A, right = reduced.shared[:, :-1], reduced.shared[:, -1]
        linear = solved(A, right)
        return Predicted(float(np.sum((right - A @ linear) ** 2)), theta, linear, plant, columns, reduced)

    def linearised(self, trial: Predicted) -> tuple[Array, Array]:
        """Return J (r, p) and e (r,): the residuals near the trial are e - J δ, up to an orthogonal part."""
        R, nb = self._reduce(self._with_slopes(trial)).shared, self.structure.nb
        return eliminated(R[:, :nb], R[:, nb:-1], R[:, -1])

    def sensitivities(self, trial: Predicted) -> list[Array]:
        """Return the weighted derivatives (p, m) of the prediction on each run, nuisances eliminated."""
        columns = self._with_slopes(trial)
        found = projected(columns, [run.stretch for run in self.runs], self._reduce(columns))
        return [block * self._weight(run) for block, run in zip(found, self.runs, strict=True)]

    def errors(self, trial: Predicted) -> list[Array]:
        """Return the prediction error e (m,) on each run."""
        shared, values = self._shared(trial), self._common(trial)
        common = [values[run.stretch] for run in self.runs]
        local = trial.reduced.local_values(common, shared)
        return [
            -np.concatenate([*unknowns, shared]) @ block
            for block, *unknowns in zip(trial.columns, local, common, strict=True)
        ]

    def offsets(self, trial: Predicted) -> dict[int, Array]:
        """Return the offset and drift (c,) of each experiment."""
        return {
            self.stretches[stretch].experiment: common[self.structure.nf :]
            for stretch, common in self._common(trial).items()
        }

    def _plant_columns(self, stretch: Stretch, f: Array) -> Array:
        s = self.structure
        impulse = np.zeros(len(stretch))
        impulse[0] = 1.0
        t = np.arange(stretch.start, stretch.start + len(stretch)) / max(
            len(self.experiments[stretch.experiment]) - 1, 1
        )
        return np.concatenate(
            [
                differences(lfilter([1.0], f, impulse), s.nf, 0),
                np.stack([(t - 0.5) ** power for power in range(1 + self.drift)]),
                differences(lfilter([1.0], f, stretch.u), s.nb, s.nk),
                stretch.y[None],
            ]
        )

    def _noise_states(self, run: Run, c: Array) -> Array:
        impulse = np.zeros(run.last - run.first)
        impulse[0] = 1.0
        return differences(lfilter([1.0], c, impulse), self.states, 0)

    def _with_slopes(self, trial: Predicted) -> list[Array]:
        s = self.structure
        c, d, f = self.polynomials(trial.theta)
        shared, values = self._shared(trial), self._common(trial)
        blocks = []
        for run, block, e in zip(self.runs, trial.columns, self.errors(trial), strict=True):
            plant, common = trial.plant[run.stretch], values[run.stretch]
            motion = common[: s.nf] @ plant[: s.nf] + shared[:-1] @ plant[s.nf + 1 + self.drift : -1]
            part = slice(run.first, run.last)
            noise = (
                plant[-1, part] - motion[part] - common[s.nf :] @ plant[s.nf : s.nf + 1 + self.drift, part]
            )
            by_c = differences(lfilter([1.0], c, e), s.nc, 1)
            by_d = -differences(lfilter([1.0], c, noise), s.nd, 1)
            by_f = -differences(lfilter([1.0], f, motion), s.nf, 1)[:, part]
            blocks.append(np.concatenate([block[:-1], by_c, by_d, lfilter(d, c, by_f), e[None]]))
        return blocks

    def _shared(self, trial: Predicted) -> Array:
        return np.concatenate([trial.linear, [-1.0]])

    def _common(self, trial: Predicted) -> dict[int, Array]:
        """Return the initial state of the plant, offset and drift on each stretch that has a run."""
        shared = self._shared(trial)
        stretches = sorted({run.stretch for run in self.runs})
        return {stretch: trial.reduced.common_values(stretch, shared) for stretch in stretches}

    def _weight(self, run: Run) -> Array:
        return self.stretches[run.stretch].root_weight[run.first : run.last]

    def _reduce(self, columns: list[Array]) -> Reduced:
        common = self.structure.nf + 1 + self.drift
        layout = Layout(self.states, common, len(columns[0]) - self.states - common)
        weighted = [block * self._weight(run) for block, run in zip(columns, self.runs, strict=True)]
        return reduce(weighted, [run.stretch for run in self.runs], layout)


def fit_box_jenkins(
    experiments: Sequence[Experiment], structure: BoxJenkins, *, drift: bool = False
) -> Estimate:
    """Fit a Box-Jenkins model to one or more experiments of one sample time.

    Raises DesignError where the data cannot determine so many unknowns.
    """
    s = structure
    problem = BoxJenkinsError(experiments, s, drift)
    check_samples(problem.residuals, problem.unknowns, str(s))
    outcome = _searched(problem, fit_output_error(experiments, OutputError(s.nb, s.nf, s.nk), drift=drift))
    if outcome is None:
        raise DesignError(f"{s}: no stable model follows the data; is the plant unstable?")
    trial, T, nb = outcome.trial, experiments[0].sample_time_s, s.nb

    def build(values: Array) -> Models:
        c, d, f = problem.polynomials(values[nb:])
        return Models(DiscreteModel(basis(nb) @ values[:nb], f, s.nk, T, c, d))

    values = np.concatenate([trial.linear, outcome.theta])
    errors = problem.errors(trial)
    weighted = [e * problem._weight(run) for e, run in zip(errors, problem.runs, strict=True)]
    uncertain = covariance(problem.sensitivities(trial), weighted, problem.unknowns)
    residuals = [np.full(len(experiment), np.nan) for experiment in experiments]
    for run, e in zip(problem.runs, errors, strict=True):
        stretch = problem.stretches[run.stretch]
        residuals[stretch.experiment][stretch.start + run.first : stretch.start + run.last] = e
    counts = (("b", nb), ("c", s.nc), ("d", s.nd), ("f", s.nf))
    return Estimate(
        structure=s,
        parameters=Parameters(
            tuple(f"{letter} in (1 - 1/z)^{i}" for letter, n in counts for i in range(n)),
            values,
            uncertain.matrix,
            build,
        ),
        experiments=tuple(experiments),
        residuals=tuple(residuals),
        offsets=offsets_of(build(values).discrete, experiments, problem.offsets(trial), 0),
        noise_std=uncertain.noise_std,
        noise_order=uncertain.noise_order,
        cost=trial.cost,
        samples=problem.residuals,
        unknowns=problem.unknowns,
        converged=outcome.converged,
    )


def _searched(problem: BoxJenkinsError, plant: Estimate) -> Outcome[Predicted] | None:
    """Return the better result of two starts: a noise model of the plant's residuals, and white noise."""
    s = problem.structure
    f = coordinates(plant.discrete.f)
    starts = [np.concatenate([np.zeros(s.nc + s.nd), f])]
    noise = noise_start(plant.residuals, s.nc, s.nd)
    if noise is not None:
        starts.append(np.concatenate([*noise, f]))
    found = [outcome for start in starts if (outcome := minimise(problem, start)) is not None]
    return min(found, key=lambda outcome: outcome.trial.cost, default=None)


def noise_start(residuals: Sequence[Array], nc: int, nd: int) -> tuple[Array, Array] | None:
    """Return the coordinates of C and D for residuals C/D e, from the innovations of a long autoregression.

    None where there are too few residuals (Hannan and Rissanen).
    """
    rows, right = [], []
    for v in residuals:
        before = past(v, LONG_AUTOREGRESSION)
        complete = np.isfinite(before).all(axis=0) & np.isfinite(v)
        if np.count_nonzero(complete) < 4 * LONG_AUTOREGRESSION:
            continue
        e = np.full(len(v), np.nan)
        e[complete] = v[complete] - solved(before[:, complete].T, v[complete]) @ before[:, complete]
        block = np.concatenate([past(e, nc), -past(v, nd)])
        complete &= np.isfinite(block).all(axis=0)
        rows.append(block[:, complete].T)
        right.append(v[complete])
    if not rows or sum(map(len, rows)) < 4 * (nc + nd):
        return None
    values = solved(np.concatenate(rows), np.concatenate(right))
    c, d = (stabilised(np.concatenate([[1.0], part])) for part in np.split(values, [nc]))
    return coordinates(c), coordinates(d)
