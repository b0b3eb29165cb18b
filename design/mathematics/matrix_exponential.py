"""The exponential of a batch of small matrices.

scipy.linalg.expm takes one matrix at a time, and scipy takes longer to import than a whole design.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from design.mathematics.polynomials import Array

_INVERSE_FACTORIALS = [1.0 / factorial(k) for k in range(13)]
_TAYLOR_NORM = 0.5
"""Norm up to which the Taylor polynomial of degree 12 is exact to rounding."""


def exponential(M: Array) -> Array:
    """Return exp(M) of matrices M (B, n, n), by scaling, a Taylor polynomial, and repeated squaring.

    The polynomial is evaluated by the method of Paterson and Stockmeyer. exp(M) - I is squared instead of
    exp(M), so that a slow mode keeps its digits beside a fast one. Each matrix is squared as often as it
    needs to be, so that no result depends on the other matrices of the batch.
    """
    norms = np.abs(M).sum(axis=-1).max(axis=-1, initial=0.0)
    squarings = np.ceil(np.log2(np.maximum(norms, _TAYLOR_NORM) / _TAYLOR_NORM)).astype(int)
    X = M / 2.0 ** squarings[:, None, None]
    X2 = X @ X
    X3 = X2 @ X
    eye = np.eye(M.shape[-1])
    less_identity = _INVERSE_FACTORIALS[12] * X3
    for i in (9, 6, 3, 0):
        zeroth, first, second = _INVERSE_FACTORIALS[i : i + 3]
        less_identity = less_identity + first * X + second * X2
        if i:
            less_identity = (less_identity + zeroth * eye) @ X3
    for k in range(int(squarings.max(initial=0))):
        left = squarings > k
        some = less_identity if left.all() else less_identity[left]
        doubled = 2.0 * some + some @ some
        if left.all():
            less_identity = doubled
        else:
            less_identity[left] = doubled
    return np.asarray(less_identity + eye)
