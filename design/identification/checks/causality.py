"""Does the output answer before its input? Then the columns are shifted in time, or a controller acts.

The output is predicted from its own past and past inputs, and once more with inputs that come too late to
act. In a causal record these add nothing.
"""

from __future__ import annotations

import numpy as np

from design.identification.least_squares import solved
from design.identification.records.experiment import Experiment
from design.mathematics.polynomials import Array

PAST = 8
"""Number of past outputs and inputs in a prediction."""
LATER = 8
"""Number of inputs that come too late."""
SURPRISING = 1e-2
"""Relative error of an input's prediction from its past, up to which it counts as known in advance.

Later values of a multisine or a chirp say nothing new, so they are not tested.
"""
MAX_ROWS = 20_000
"""Number of rows of a prediction."""


def later_input_share(experiment: Experiment, nk: int) -> float:
    """Return the share of the error's variance that inputs explain which come too late for nk.

    0 where too few rows are complete, where the error is rounding, or where the input is known in advance.
    """
    part = experiment.part(0, 2 * MAX_ROWS)
    y = np.where(part.observed, part.y, np.nan)
    past = [_shifted(y, lag) for lag in range(1, PAST + 1)]
    past += [_shifted(part.u, lag) for lag in range(nk, nk + PAST)]
    later = [_shifted(part.u, lag) for lag in range(nk - LATER, nk)]
    rows = np.stack([np.ones(len(y)), *past, *later], axis=1)
    complete = np.flatnonzero(np.isfinite(rows).all(axis=1) & np.isfinite(y))[:MAX_ROWS]
    if len(complete) < 10 * rows.shape[1]:
        return 0.0
    rows, right, u = rows[complete], y[complete], part.u[complete]
    inputs = np.stack([np.ones(len(y)), *(_shifted(part.u, lag) for lag in range(1, PAST + 1))], axis=1)[
        complete
    ]
    known = np.isfinite(inputs).all(axis=1)
    if _error(inputs[known], u[known]) <= SURPRISING**2 * float(np.sum((u[known] - u[known].mean()) ** 2)):
        return 0.0
    without, with_later = (_error(rows[:, :count], right) for count in (1 + len(past), rows.shape[1]))
    if without <= 1e-12 * float(np.sum((right - right.mean()) ** 2)):
        return 0.0
    # Later inputs explain their share of pure noise, too.
    freedom = (len(right) - rows.shape[1]) / (len(right) - 1 - len(past))
    return float(max(0.0, 1.0 - with_later / without / freedom))


def _error(rows: Array, right: Array) -> float:
    return float(np.sum((right - rows @ solved(rows, right)) ** 2))


def _shifted(signal: Array, lag: int) -> Array:
    """Return the signal ``lag`` samples later, or earlier for a negative lag. NaN where there is none."""
    empty = np.full(min(abs(lag), len(signal)), np.nan)
    return (
        np.concatenate([empty, signal[: len(signal) - lag]])
        if lag > 0
        else np.concatenate([signal[-lag:], empty])
    )
