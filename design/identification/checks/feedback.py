"""Does the output act on the input? A record of a closed loop is found by its input's own arithmetic.

In open loop the recorded output adds nothing to what the input's own past says about it. In a closed loop
the controller computes the input from the output: between changes of the setpoint, the noise of the sensor
is found in the input again, to the last digit. So the input is predicted twice, from its own past alone and
with the output added; least absolute values are used, so that a few jumps of a setpoint do not matter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.identification.least_squares import solved
from design.identification.records.experiment import Experiment
from design.mathematics.polynomials import Array

PAST = 8
"""Number of past samples of input and output in a prediction."""
MAX_ROWS = 20_000
"""Number of rows of a prediction."""
PREDICTABLE = 1e-6
"""Relative error of an input's prediction from its past, below which it is exact."""
_ROUNDS = 12


class Feedback(NamedTuple):
    """How well the input is predicted."""

    alone: float
    """Median error of the prediction from its own past, as a share of the input's standard deviation."""
    with_output: float
    """Median error with present and past outputs added, as a share of the first. 1 without feedback."""


def feedback(experiment: Experiment) -> Feedback | None:
    """Predict the input of a record. None where too few rows are complete."""
    experiment = experiment.part(0, 2 * MAX_ROWS)
    y = np.where(experiment.observed, experiment.y, np.nan)
    u = experiment.u
    columns = [*(_delayed(u, lag) for lag in range(1, PAST + 1)), np.ones(len(u))]
    outputs = [_delayed(y, lag) for lag in range(PAST + 1)]
    rows = np.stack([*columns, *outputs], axis=1)
    complete = np.flatnonzero(np.isfinite(rows).all(axis=1) & np.isfinite(u))[:MAX_ROWS]
    if len(complete) < 10 * rows.shape[1]:
        return None
    spread = float(np.std(u[complete]))
    if spread == 0.0:
        return None
    alone = _median_error(rows[complete, : len(columns)], u[complete]) / spread
    if alone < PREDICTABLE:
        return Feedback(alone, 1.0)
    return Feedback(alone, _median_error(rows[complete], u[complete]) / spread / alone)


def _delayed(signal: Array, lag: int) -> Array:
    return np.concatenate([np.full(lag, np.nan), signal[: len(signal) - lag]]) if lag else signal


def _median_error(rows: Array, right: Array) -> float:
    """Return the median of |right - rows x| for the x of least absolute error (reweighted squares)."""
    floor = 1e-9 * float(np.std(right))
    weights = np.ones(len(right))
    error = np.abs(right)
    for _ in range(_ROUNDS):
        x = solved(rows * weights[:, None], right * weights)
        error = np.abs(right - rows @ x)
        weights = 1.0 / np.sqrt(np.maximum(error, max(1e-2 * float(np.median(error)), floor)))
    return float(np.median(error))
