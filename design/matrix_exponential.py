"""exp(M) of a batch of small matrices, in numpy alone: scipy's takes one at a time and long to import."""

from __future__ import annotations

from math import factorial

import numpy as np

from design.polynomials import Array

_INVERSE_FACTORIALS = [1.0 / factorial(k) for k in range(13)]
_LARGEST = 0.5
"""Norm under which the Taylor polynomial of degree 12 is exact to rounding."""


def exponential(M: Array) -> Array:
    """exp(M) of M (..., n, n), by scaling, a Taylor polynomial (Paterson and Stockmeyer's), and squaring."""
    norm = float(np.abs(M).sum(axis=-1).max(initial=0.0))
    squarings = max(0, int(np.ceil(np.log2(max(norm, _LARGEST) / _LARGEST))))
    X = M / 2.0**squarings
    X2 = X @ X
    X3 = X2 @ X
    eye = np.eye(M.shape[-1])
    result = _INVERSE_FACTORIALS[12] * X3
    for i in (9, 6, 3, 0):
        zeroth, first, second = _INVERSE_FACTORIALS[i : i + 3]
        result = result + zeroth * eye + first * X + second * X2
        if i:
            result = result @ X3
    for _ in range(squarings):
        result = result @ result
    return np.asarray(result)
