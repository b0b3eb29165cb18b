r"""Covariance of estimated parameters, for residuals of any colour.

With the derivatives J of the model output and white residuals of variance σ² the covariance is σ² (JᵀJ)⁻¹. An
output-error model is still right where the noise is coloured, but that formula is not. There it is

    (JᵀJ)⁻¹ JᵀΛJ (JᵀJ)⁻¹,   Λ the covariance matrix of the residuals

(Ljung, System Identification, 2nd ed., section 9.5). Λ is that of an autoregression fitted to the residuals,
whose order is selected by BIC; JᵀΛJ is found by filtering the columns of J backwards in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from design.identification.estimators.correlation import autocorrelation
from design.identification.least_squares import triangle
from design.mathematics.polynomials import Array

MAX_NOISE_ORDER = 40
"""Largest order of the autoregression that describes the residuals."""


class Uncertain(NamedTuple):
    """Covariance matrix (p, p) of the parameters, and what it was computed from."""

    matrix: Array
    noise_std: float
    """Standard deviation of the residuals, corrected for the number of unknowns."""
    noise_order: int
    """Order of the autoregression that describes the residuals. 0 means that they are white."""


class Autoregression(NamedTuple):
    """Residuals e with a(q) e = white noise; ``a`` (order + 1,) begins with 1."""

    a: Array
    innovation: float
    """Variance of the white noise, as a share of the variance of e."""


def covariance(sensitivities: Sequence[Array], residuals: Sequence[Array], unknowns: int) -> Uncertain:
    """Return the covariance from weighted derivatives (p, m) and weighted residuals (m,) of each stretch.

    A residual of exactly 0 counts as missing. ``unknowns`` is the number of all estimated values.
    """
    p = len(sensitivities[0])
    count = sum(int(np.count_nonzero(e)) for e in residuals)
    variance = float(sum(e @ e for e in residuals)) / max(count - unknowns, 1)
    R = triangle(np.concatenate(list(sensitivities), axis=1))[:p]
    sizes = np.linalg.norm(R, axis=0)
    sizes[sizes == 0.0] = 1.0
    inverse = np.linalg.pinv(R / sizes, rcond=1e-13) / sizes[:, None]
    noise = noise_autoregression(residuals)
    if len(noise.a) == 1:
        return Uncertain(variance * inverse @ inverse.T, np.sqrt(variance), 0)
    coloured = [lfilter([1.0], noise.a, block[:, ::-1], axis=-1) for block in sensitivities]
    factor = inverse @ (inverse.T @ triangle(np.concatenate(coloured, axis=1)).T)
    return Uncertain(variance * noise.innovation * factor @ factor.T, np.sqrt(variance), len(noise.a) - 1)


def noise_autoregression(residuals: Sequence[Array]) -> Autoregression:
    """Return the autoregression that describes the residuals best by BIC. Order 0 if they are white."""
    longest = max((len(e) for e in residuals), default=0)
    order = min(MAX_NOISE_ORDER, longest - 1, sum(map(len, residuals)) // 20)
    chosen = Autoregression(np.ones(1), 1.0)
    if order < 1:
        return chosen
    correlation, count = autocorrelation(residuals, order)
    # Levinson's recursion gives every order on the way to the largest.
    best, a, power = 0.0, np.ones(1), 1.0
    for k in range(1, order + 1):
        reflection = -float(a @ correlation[k:0:-1]) / power
        if not abs(reflection) < 1.0:
            break
        a = np.concatenate([a, [0.0]])
        a = a + reflection * a[::-1]
        power *= 1.0 - reflection * reflection
        criterion = count * np.log(power) + k * np.log(max(count, 2))
        if criterion < best:
            best, chosen = criterion, Autoregression(a, power)
    return chosen
