"""Linear least squares for a few columns of very different size and very many rows.

Tall matrices are triangularised piece by piece. A piece is so small that linear algebra libraries do not
share it out between threads, which would cost more time than the work itself.
"""

from __future__ import annotations

import numpy as np

from design.mathematics.polynomials import Array

_PIECE = 4500
"""Number of matrix elements in a piece."""
_WITHOUT_EFFECT = 1e-200
"""Norm of a column below which it counts as 0."""


def triangle(columns: Array) -> Array:
    """Return R (min(m, k), k) of the QR factorisation of a matrix that is given by its columns (k, m)."""
    k = len(columns)
    rows = max(4 * k, _PIECE // max(k, 1))
    while columns.shape[1] > rows:
        pieces = columns.shape[1] // rows
        whole = columns[:, : pieces * rows].reshape(k, pieces, rows).transpose(1, 2, 0)
        factors = np.asarray(np.linalg.qr(whole, mode="r")).reshape(-1, k)
        columns = np.concatenate([factors.T, columns[:, pieces * rows :]], axis=1)
    return np.asarray(np.linalg.qr(columns.T, mode="r"))


def triangles(blocks: Array) -> Array:
    """Return R (s, min(m, k), k) of the QR factorisation of s matrices, given by their columns (s, k, m)."""
    if len(blocks) == 1:
        return triangle(blocks[0])[None]
    return np.asarray(np.linalg.qr(blocks.swapaxes(-1, -2), mode="r"))


def solved_each(rows: Array, right: Array) -> Array:
    """Return the least-squares solutions (s, n, r) of s small systems (s, m, n) with right sides (s, m, r).

    See :func:`solved`, which is used for one system.
    """
    if len(rows) == 1:
        return solved(rows[0], right[0])[None]
    scale = np.linalg.norm(rows, axis=1, keepdims=True)
    scale[scale < _WITHOUT_EFFECT] = np.inf
    return np.asarray(np.linalg.pinv(rows / scale, rcond=1e-13) @ right / scale.swapaxes(-1, -2))


def solved(rows: Array, right: Array) -> Array:
    """Return the least-squares solution, of least norm where the rows (m, k) do not determine it.

    ``right`` is (m,) or (m, r).
    """
    if len(rows) * rows.shape[1] > _PIECE and right.ndim == 1:
        R = triangle(np.concatenate([rows.T, right[None]]))
        rows, right = R[:, :-1], R[:, -1]
    scale = np.linalg.norm(rows, axis=0)
    # An unknown without effect is 0.
    scale[scale < _WITHOUT_EFFECT] = np.inf
    return np.asarray((np.linalg.lstsq(rows / scale, right, rcond=1e-13)[0].T / scale).T)
