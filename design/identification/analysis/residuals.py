"""Residual analysis: what a model has left unexplained, with confidence bounds.

White residuals mean that the noise model is complete. Residuals that are uncorrelated with past inputs mean
that the dynamics are complete; a correlation with future inputs means that the output acts on the input, as
in a closed loop (Ljung, System Identification, 2nd ed., section 16.6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from scipy.special import chdtrc

from design.identification.estimators.correlation import Pair, correlation
from design.identification.records.experiment import Experiment
from design.mathematics.polynomials import Array

LAGS = 25
"""Largest lag of a test if none is asked for."""
LEVEL = 0.99
"""Confidence level of the bounds if none is asked for."""


@dataclass(frozen=True, eq=False)
class Correlation:
    """Correlation coefficients over lags, the bound that 0 would keep at each, and a test of all together."""

    lags: Array
    """Lags in samples. A positive lag of a cross-correlation means that the input comes first."""
    values: Array
    bounds: Array
    """Bounds of the confidence interval around 0."""
    probability: float
    """Probability of values as large as these if there is no correlation at all."""
    level: float

    @property
    def passed(self) -> bool:
        """True if correlations as large as these are expected by chance."""
        return self.probability > 1.0 - self.level


@dataclass(frozen=True, eq=False)
class ResidualAnalysis:
    """Tests of the residuals e of a model."""

    whiteness: Correlation
    """Correlation of e with its own past, lags 1 and more."""
    from_input: Correlation
    """Correlation of e with earlier inputs: dynamics that the model lacks."""
    to_input: Correlation
    """Correlation of e with later inputs, and with that of the same period: feedback."""


def analyse_residuals(
    experiments: Sequence[Experiment], residuals: Sequence[Array], *, lags: int = LAGS, level: float = LEVEL
) -> ResidualAnalysis:
    """Test residuals (N,) of each experiment, NaN where a sample does not count."""
    longest = max(map(len, residuals))
    lags = max(1, min(lags, longest // 4))
    e_known = [np.isfinite(e) for e in residuals]
    u_known = [np.isfinite(experiment.u) for experiment in experiments]
    e = [_centred(values, known) for values, known in zip(residuals, e_known, strict=True)]
    u = [_centred(x.u, known) for x, known in zip(experiments, u_known, strict=True)]
    own = _coefficients([Pair(a, a, k, k) for a, k in zip(e, e_known, strict=True)], lags)
    past = _coefficients([Pair(b, a, j, k) for a, b, k, j in zip(e, u, e_known, u_known, strict=True)], lags)
    future = _coefficients(
        [Pair(a, b, k, j) for a, b, k, j in zip(e, u, e_known, u_known, strict=True)], lags
    )
    wide = max(1, min(4 * lags, longest // 4))
    e_colour = _coefficients([Pair(a, a, k, k) for a, k in zip(e, e_known, strict=True)], wide)[0]
    u_colour = _coefficients([Pair(a, a, k, k) for a, k in zip(u, u_known, strict=True)], wide)[0]
    return ResidualAnalysis(
        whiteness=_tested(np.arange(1.0, lags + 1), own[0][1:], own[1][1:], np.eye(1, lags)[0], level),
        from_input=_tested(np.arange(lags + 1.0), *past, _joint(e_colour, u_colour, lags + 1), level),
        to_input=_tested(-np.arange(lags + 1.0), *future, _joint(e_colour, u_colour, lags + 1), level),
    )


def _centred(values: Array, known: Array) -> Array:
    mean = float(values[known].mean()) if known.any() else 0.0
    return np.where(known, values - mean, 0.0)


def _coefficients(pairs: Sequence[Pair], lags: int) -> tuple[Array, Array]:
    """Return the correlation coefficients (lags + 1,) and the number of terms of each."""
    sums, counts = correlation(pairs, lags)
    power = [
        sum(float(x @ x) for x in side) for side in zip(*((p.first, p.second) for p in pairs), strict=True)
    ]
    known = [
        sum(int(np.count_nonzero(k)) for k in side) for side in zip(*(p[2:] for p in pairs), strict=True)
    ]
    scale = np.sqrt(power[0] / max(known[0], 1) * power[1] / max(known[1], 1))
    if scale == 0.0:
        return np.zeros(lags + 1), counts
    return sums / np.maximum(counts, 1.0) / scale, counts


def _joint(first: Array, second: Array, count: int) -> Array:
    """Return the covariance (count,) of a cross-correlation over lag differences, times the samples.

    It is that of independent signals by Bartlett's formula, Σ over j of r_first(j) r_second(j + difference).
    """
    both = [np.concatenate([r[:0:-1], r]) for r in (first, second)]
    full = np.correlate(both[0], both[1], mode="full")
    middle = len(full) // 2
    return full[middle : middle + count]


def _tested(lags: Array, values: Array, counts: Array, joint: Array, level: float) -> Correlation:
    """Return the bounds at each lag, and a chi-squared test over all lags with their covariance."""
    counts = np.maximum(counts, 1.0)
    variance = max(float(joint[0]), 1e-12)
    bounds = NormalDist().inv_cdf(0.5 + 0.5 * level) * np.sqrt(variance / counts)
    offsets = np.abs(np.arange(len(values))[:, None] - np.arange(len(values)))
    padded = np.concatenate([joint, np.zeros(max(0, len(values) - len(joint)))])
    eigenvalues, axes = np.linalg.eigh(padded[offsets])
    # Directions in which the estimated covariance is small are uncertain themselves, and do not count.
    kept = eigenvalues > 0.05 * eigenvalues.max()
    scores = (axes.T @ (values * np.sqrt(counts)))[kept] ** 2 / eigenvalues[kept]
    probability = float(chdtrc(int(kept.sum()), float(scores.sum())))
    return Correlation(lags, values, bounds, probability, level)
