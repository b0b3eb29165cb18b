"""Vinnicombe's ν-gap between plants: how far apart they are for any feedback, exactly.

Vinnicombe 1993 and 2001: δ(G1, G2) is the largest chordal distance on the axis if
n2~ n1 + d2~ d1 winds right (as many roots in Re s > 0 as G2 has states, the others in Re s < 0), and 1
otherwise. A controller with ε(G1, K) > δ(G1, G2) stabilises G2. The sampled gap is that of the bilinear
plane. No grid: the largest distance comes from ``peaks``.
"""

from __future__ import annotations

import numpy as np

from design.mathematics import polynomials as poly
from design.mathematics.peaks import Power, peak
from design.mathematics.polynomials import Array
from design.models.plant import TransferFunction


def chordal_distance(G1: TransferFunction, G2: TransferFunction, omega: Array) -> Array:
    """Distance (k,) of the two frequency responses on the Riemann sphere at ``omega`` (k,) in rad/s."""
    w = np.asarray(omega, dtype=float)[None, :]
    above, below = _distance(G1, G2)
    return np.asarray(np.sqrt(above.at(w) / (below[0].at(w) * below[1].at(w)))[0])


def nu_gap(G1: TransferFunction, G2: TransferFunction) -> float:
    """δ in [0, 1] between two plants (with the weights already on them, for margins with weights)."""
    winding = poly.add(poly.multiply(poly.mirror(G2.num), G1.num), poly.multiply(poly.mirror(G2.den), G1.den))
    full = len(G1.den) + len(G2.den) - 1
    winding = np.concatenate([np.zeros(full - len(winding)), winding])
    roots = poly.roots(winding)
    if winding[0] == 0.0 or np.count_nonzero(roots.real > 0.0) != len(G2.den) - 1:
        return 1.0
    above, below = _distance(G1, G2)
    squared, _ = peak([above], list(below))
    return float(min(1.0, np.sqrt(squared[0])))


def _distance(G1: TransferFunction, G2: TransferFunction) -> tuple[Power, tuple[Power, Power]]:
    difference = poly.add(poly.multiply(G1.num, G2.den), -poly.multiply(G2.num, G1.den))
    return Power(difference), (Power(*_padded(G1)), Power(*_padded(G2)))


def _padded(G: TransferFunction) -> tuple[Array, Array]:
    return poly.add(G.num, np.zeros(len(G.den))), G.den
