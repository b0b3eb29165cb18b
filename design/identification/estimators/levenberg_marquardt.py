"""Nonlinear least squares within bounds, for problems that give their residuals in reduced form.

A problem reduces its residuals, which may be a million, to a handful of rows with the same normal equations.
The search then works on those rows: Levenberg and Marquardt's damping, adapted as Nielsen proposes, with
the parameters kept inside their bounds by projection. It ends where the predicted improvement is small
beside what the noise of the data would cause anyway, so that no time goes into digits that mean nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from design.mathematics.polynomials import Array, Flags

MAX_ROUNDS = 60
"""Linearisations after which a search ends without having converged."""
MAX_TRIALS = 14
"""Damping values that are tried in one round."""
STATISTICAL_TOLERANCE = 1e-6
"""Predicted decrease of the cost, in units of one residual's variance, at which the search ends.

The parameters are then within a thousandth of their standard deviation of the optimum.
"""
EXACT = 1e-26
"""Share of the data's own sum of squares below which a cost counts as 0."""

ROUNDING = 1e-18
"""Share of the data's sum of squares below which a cost that no step lowers is taken for rounding."""

TrialT = TypeVar("TrialT", bound="Trial")


class Trial(Protocol):
    """A candidate with the sum of its squared residuals."""

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        ...


class Problem(Protocol[TrialT]):
    """A least-squares problem in p parameters."""

    lower: Array
    upper: Array
    max_step: float
    """Largest change of one parameter in one step."""
    residuals: int
    """Number of residuals."""
    scale: float
    """Sum of squares of the data, the cost of an empty model."""

    def trial(self, theta: Array) -> TrialT | None:
        """Evaluate a candidate (p,). None where it is not admissible."""
        ...

    def linearised(self, trial: TrialT) -> tuple[Array, Array]:
        """Return J (r, p) and e (r,): the residuals near the trial are e - J δ, up to an orthogonal part."""
        ...


@dataclass(frozen=True)
class Outcome(Generic[TrialT]):
    """Where a search ended."""

    theta: Array
    trial: TrialT
    converged: bool
    at_bound: Flags
    """Parameters (p,) that a bound holds."""
    rounds: int


def minimise(
    problem: Problem[TrialT],
    start: Array,
    tolerance: float = STATISTICAL_TOLERANCE,
    max_rounds: int = MAX_ROUNDS,
) -> Outcome[TrialT] | None:
    """Search the parameters of least cost from ``start`` (p,). None where the start is not admissible."""
    theta = np.clip(start, problem.lower, problem.upper)
    trial = problem.trial(theta)
    if trial is None:
        return None
    damping, growth = 1e-3, 2.0
    held: Flags = np.zeros(len(theta), dtype=bool)
    for done in range(max_rounds):
        J, e = problem.linearised(trial)
        held = _held(theta, J.T @ e, problem)
        free = J[:, ~held]
        improvement = _explained(free, e)
        if improvement <= tolerance * trial.cost / problem.residuals or trial.cost <= EXACT * problem.scale:
            return Outcome(theta, trial, True, held, done)
        sizes = np.linalg.norm(free, axis=0)
        sizes = np.maximum(sizes, 1e-9 * sizes.max(initial=0.0))
        at_edge = False
        for _ in range(MAX_TRIALS):
            step = np.zeros(len(theta))
            step[~held] = _damped(free, e, np.sqrt(damping) * sizes)
            step *= min(1.0, problem.max_step / max(float(np.abs(step).max()), 1e-300))
            reached = np.clip(theta + step, problem.lower, problem.upper)
            predicted = float(e @ e - np.sum((e - J @ (reached - theta)) ** 2))
            candidate = problem.trial(reached)
            if candidate is not None and candidate.cost < trial.cost:
                ratio = min((trial.cost - candidate.cost) / max(predicted, 1e-300), 2.0)
                damping = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3), 1e-12)
                theta, trial, growth = reached, candidate, 2.0
                break
            at_edge |= candidate is None
            damping, growth = damping * growth, 2.0 * growth
        else:
            # No step along the slope lowers the cost: the optimum to the accuracy of the arithmetic, or a
            # point at the edge of what is admissible.
            rounding = trial.cost <= ROUNDING * problem.scale or improvement < 1e-4 * trial.cost
            return Outcome(theta, trial, at_edge or rounding, held, done)
    return Outcome(theta, trial, False, held, max_rounds)


def _held(theta: Array, descent: Array, problem: Problem[TrialT]) -> Flags:
    """Return the parameters (p,) at a bound which the descent direction leads out of."""
    width = 1e-9 * (1.0 + np.abs(theta))
    low = (theta <= problem.lower + width) & (descent < 0.0)
    high = (theta >= problem.upper - width) & (descent > 0.0)
    return np.asarray(low | high)


def _explained(J: Array, e: Array) -> float:
    """Return the part of the sum of squares of e that a linear combination of J's columns explains."""
    if not J.size:
        return 0.0
    sizes = np.linalg.norm(J, axis=0)
    left, singular, _ = np.linalg.svd(J / np.where(sizes > 0.0, sizes, 1.0), full_matrices=False)
    kept = left[:, singular > 1e-10 * singular.max(initial=0.0)]
    return float(np.sum((kept.T @ e) ** 2))


def _damped(J: Array, e: Array, damping: Array) -> Array:
    """Return the step (p,) that minimises |e - J δ|² + |damping δ|²."""
    rows = np.concatenate([J, np.diag(damping)])
    return np.asarray(np.linalg.lstsq(rows, np.concatenate([e, np.zeros(len(damping))]), rcond=None)[0])
