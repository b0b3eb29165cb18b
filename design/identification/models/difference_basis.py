"""Delayed signals as backward differences.

A polynomial in z^-1 is written in powers of 1 - z^-1. Where a record is sampled fast, the delayed copies of a
signal are nearly equal and least squares on them loses digits; its differences are of different size, but
independent. The coefficients in either basis follow from the other by the same matrix.
"""

from __future__ import annotations

from functools import lru_cache
from math import comb

import numpy as np

from design.mathematics.polynomials import Array


@lru_cache
def basis(count: int) -> Array:
    """Return the matrix V (n, n) from coefficients of (1 - z^-1)^i to those of z^-i. V is its own inverse."""
    V = np.array([[(-1.0) ** i * comb(j, i) for j in range(count)] for i in range(count)]).reshape(
        count, count
    )
    V.flags.writeable = False
    return V


def differences(signal: Array, count: int, lag: int) -> Array:
    """Return signals (..., m), delayed by ``lag`` samples, and their first ``count - 1`` differences.

    The result has the shape (..., count, m). A signal is 0 before its first sample.
    """
    length = signal.shape[-1]
    found = np.zeros((*signal.shape[:-1], count, length))
    if count and lag < length:
        found[..., 0, lag:] = signal[..., : length - lag]
    for i in range(1, count):
        found[..., i, 0] = found[..., i - 1, 0]
        np.subtract(found[..., i - 1, 1:], found[..., i - 1, :-1], out=found[..., i, 1:])
    return found
