"""Polynomials of a noise model as the prediction-error estimators search them.

A polynomial 1 + p_1 z^-1 + … is written 1 + z^-1 Σ θ_i (1 - z^-1)^i. Its roots must lie inside the unit
circle.
"""

from __future__ import annotations

import numpy as np

from design.identification.models.difference_basis import basis
from design.identification.models.model import rooted
from design.mathematics.polynomials import Array

_INSIDE = 0.9999
"""Largest modulus of a root to which an unstable polynomial is moved."""


def monic(theta: Array) -> Array:
    """Return the polynomial (n + 1,) in rising powers of z^-1."""
    return np.concatenate([[1.0], basis(len(theta)) @ theta])


def coordinates(polynomial: Array) -> Array:
    """Return the coordinates θ (n,) of a polynomial in rising powers of z^-1."""
    return np.asarray(basis(len(polynomial) - 1) @ polynomial[1:])


def is_stable(polynomial: Array) -> bool:
    """Return True if all roots in z lie inside the unit circle."""
    return bool((np.abs(rooted(polynomial)) < 1.0).all())


def stabilised(polynomial: Array) -> Array:
    """Return the polynomial with its roots reflected into the unit circle."""
    z = np.roots(polynomial)
    sizes = np.abs(z)
    outside = sizes > _INSIDE
    if not outside.any():
        return polynomial
    z[outside] = z[outside] / sizes[outside] * np.minimum(1.0 / sizes[outside], _INSIDE)
    return np.concatenate([np.poly(z).real, np.zeros(len(polynomial) - 1 - len(z))])


def past(signal: Array, count: int) -> Array:
    """Return the signal (m,) one to ``count`` samples before, as rows (count, m). NaN at first."""
    padded = np.concatenate([np.full(count, np.nan), signal])
    rows = [padded[count - j : len(padded) - j] for j in range(1, count + 1)]
    return np.array(rows).reshape(count, len(signal))
