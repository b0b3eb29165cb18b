"""Vinnicombe's ν-gap: the distance between two plants as feedback sees it, exactly.

The ν-gap δ(G1, G2) is the largest chordal distance of both frequency responses, provided that the winding
condition holds; otherwise it is 1. The condition is that n2~ n1 + d2~ d1 has as many roots in Re s > 0 as G2
has states, and all others in Re s < 0. A controller with ε(G1, K) > δ(G1, G2) stabilises G2 too. The gap of
sampled plants is that of their models in the bilinear plane. The largest distance comes from
:mod:`design.mathematics.peaks`, without a frequency grid.

Source: Vinnicombe, IEEE Transactions on Automatic Control 38 (1993), and Uncertainty and Feedback, 2001.
"""

from __future__ import annotations

import numpy as np

from design.mathematics import polynomials as poly
from design.mathematics.peaks import SquaredMagnitude, peak
from design.mathematics.polynomials import Array
from design.models.transfer_function import TransferFunction


def chordal_distance(G1: TransferFunction, G2: TransferFunction, omega: Array) -> Array:
    """Return the distance (k,), 0 to 1, of both frequency responses on the Riemann sphere at ``omega`` (k,).

    Frequencies are in rad/s.
    """
    w = np.asarray(omega, dtype=float)[None, :]
    above, below = _distance(G1, G2)
    return np.asarray(np.sqrt(above.at(w) / (below[0].at(w) * below[1].at(w)))[0])


def nu_gap(G1: TransferFunction, G2: TransferFunction) -> float:
    """Return the ν-gap, 0 to 1, between two plants (n + 1,).

    For margins with a weight, give the shaped plants.
    """
    winding = poly.add(poly.multiply(poly.mirror(G2.num), G1.num), poly.multiply(poly.mirror(G2.den), G1.den))
    full = len(G1.den) + len(G2.den) - 1
    winding = np.concatenate([np.zeros(full - len(winding)), winding])
    roots = poly.roots(winding)
    if winding[0] == 0.0 or np.count_nonzero(roots.real > 0.0) != len(G2.den) - 1:
        return 1.0
    above, below = _distance(G1, G2)
    squared, _ = peak([above], list(below))
    return float(min(1.0, np.sqrt(squared[0])))


def _distance(
    G1: TransferFunction, G2: TransferFunction
) -> tuple[SquaredMagnitude, tuple[SquaredMagnitude, SquaredMagnitude]]:
    """Return the numerator and both factors of the denominator of the squared chordal distance."""
    difference = poly.add(poly.multiply(G1.num, G2.den), -poly.multiply(G2.num, G1.den))
    return SquaredMagnitude(difference), (SquaredMagnitude(*_padded(G1)), SquaredMagnitude(*_padded(G2)))


def _padded(G: TransferFunction) -> tuple[Array, Array]:
    return poly.add(G.num, np.zeros(len(G.den))), G.den
