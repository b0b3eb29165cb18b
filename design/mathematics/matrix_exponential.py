"""exp(M) of a batch of small matrices, in numpy alone: scipy's takes one at a time and long to import."""

from __future__ import annotations

from math import factorial

import numpy as np

from design.mathematics.polynomials import Array

_INVERSE_FACTORIALS = [1.0 / factorial(k) for k in range(13)]
_LARGEST = 0.5
"""Norm under which the Taylor polynomial of degree 12 is exact to rounding."""


def exponential(M: Array) -> Array:
    """exp(M) of M (B, n, n), by scaling, a Taylor polynomial (Paterson and Stockmeyer's), and squaring.

    What is squared is exp - 1, so that slow modes keep their digits beside fast ones; each matrix as often
    as it needs, so that none depends on its neighbours.
    """
    norms = np.abs(M).sum(axis=-1).max(axis=-1, initial=0.0)
    squarings = np.ceil(np.log2(np.maximum(norms, _LARGEST) / _LARGEST)).astype(int)
    X = M / 2.0 ** squarings[:, None, None]
    X2 = X @ X
    X3 = X2 @ X
    eye = np.eye(M.shape[-1])
    less_one = _INVERSE_FACTORIALS[12] * X3
    for i in (9, 6, 3, 0):
        zeroth, first, second = _INVERSE_FACTORIALS[i : i + 3]
        less_one = less_one + first * X + second * X2
        if i:
            less_one = (less_one + zeroth * eye) @ X3
    for k in range(int(squarings.max(initial=0))):
        left = squarings > k
        some = less_one if left.all() else less_one[left]
        doubled = 2.0 * some + some @ some
        if left.all():
            less_one = doubled
        else:
            less_one[left] = doubled
    return np.asarray(less_one + eye)
