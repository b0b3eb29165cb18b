"""Linear least squares for columns of very different size."""

from __future__ import annotations

import numpy as np

from design.mathematics.polynomials import Array


def solved(rows: Array, right: Array) -> Array:
    """Least-squares solution, of least norm where the rows do not determine it."""
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0.0] = 1.0
    return np.asarray((np.linalg.lstsq(rows / scale, right, rcond=1e-13)[0].T / scale).T)
