"""Appendix A and the controllers of eqs. (5) to (7) without a Riccati equation, batched over shaped plants.

For Gs = n/d let m be the spectral factor, m m~ = n n~ + d d~ with m Hurwitz (p~ is p(-s)). A controller p/q
gives 1/ε² = 1 + max |f/c|², where d q + n p = m c and d~ p - n~ q = m f (Lagrange's identity). So a loop of
margin 1/γ is a function F = f/c, |F| <= β = sqrt(γ² - 1), whose values at the roots of m~ are prescribed:
Nevanlinna-Pick. At the optimum F = β c~/c, an eigenproblem; the central solution has β² c c~ - f f~
proportional to m m~, one linear equation. It is the controller that McFarlane and Glover get from two Riccati
equations (``loop_shaping``), for strictly proper plants and others.

With c and f as partial fractions over the roots s_i of m both problems are built of the Cauchy matrix
1/(s_i + s_j), so roots may lie decades apart. Where two of them nearly coincide, ``loop_shaping`` is asked.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design import loop_shaping
from design import polynomials as poly
from design.peaks import Power
from design.plant import TransferFunction
from design.polynomials import Array, ComplexArray, Flags
from design.realisation import realise, transfer_function

_ANGLES = np.pi / 16.0 * np.arange(16)
_COINCIDENT = 1e-5


class _Conditions(NamedTuple):
    """Monic shaped plants (B, N + 1) in scaled time, roots s (B, N) of m, and what F must be at them."""

    n: Array
    d: Array
    s: ComplexArray
    ratio: ComplexArray
    """-f/c at -s, in the mixture that no mirrored pole or zero makes 0/0."""
    scale: Array
    """rad/s (B,)"""
    coincident: Flags


def optimal_margins(Gs: TransferFunction) -> Array:
    """ε_opt (B,) of shaped plants (B, n + 1), Appendix A."""
    return _margins(_conditions(Gs))


def central_controllers(Gs: TransferFunction, factor: float = 1.1) -> tuple[TransferFunction, Array]:
    """K∞ (B, N + 1) of eq. (6) for γ = factor γ_opt, and ε_opt (B,). Negative feedback, factor > 1."""
    n, d, s, ratio, scale, coincident = conditions = _conditions(Gs)
    margins = _margins(conditions)
    N = s.shape[-1]
    beta_squared = (factor / margins) ** 2 - 1.0
    # c = m (1 + Σ k_j/(s - s_j)), f = m Σ l_j/(s - s_j).
    # Then q and p are such sums too, with q -> m and p -> n as s -> ∞.
    sums = s[:, :, None] + s[:, None, :]
    pick = 1.0 / sums - ratio[:, :, None] / sums * ratio[:, None, :] / beta_squared[:, None, None]
    pick[coincident] = np.eye(N)
    f_residues = np.linalg.solve(pick, ratio[..., None])[..., 0]
    c_residues = -ratio * f_residues / beta_squared[:, None]
    at_mirror = (-1.0) ** N * sums.prod(axis=-1)
    q_residues = (poly.at(d, -s) * c_residues - poly.at(n, s) * f_residues) / at_mirror
    p_residues = (poly.at(n, -s) * c_residues + poly.at(d, s) * f_residues) / at_mirror
    m, others = poly.from_roots(s), poly.from_roots(_all_but_one(s))
    q = poly.add(m.real, _combined(q_residues, others))
    p = poly.add(n[:, :1] * m.real, _combined(p_residues, others))
    back = scale[:, None] ** np.arange(N + 1.0)
    K = TransferFunction(p * back, q * back)
    for i in np.flatnonzero(coincident):
        some = loop_shaping.synthesise(_one(Gs, int(i)), factor).controller
        K.num[i], K.den[i] = transfer_function(some)
    return K, margins


def _margins(conditions: _Conditions) -> Array:
    n, d, s, ratio, scale, coincident = conditions
    N = s.shape[-1]
    if N == 0:
        return np.ones(len(s))
    # k of c = m Σ k_j/(s - s_j) at the optimum: β k_i = ratio_i m(-s_i)/m'(s_i) Σ_j k_j/(s_i + s_j).
    differences = s[:, :, None] - s[:, None, :]
    sums = s[:, :, None] + s[:, None, :]
    differences[:, np.arange(N), np.arange(N)] = 1.0
    differences[coincident] = 1.0
    weights = (-1.0) ** N * ratio * (sums / differences).prod(axis=-1)
    root = np.sqrt(weights)
    beta = np.abs(np.linalg.eigvals(root[:, :, None] / sums * root[:, None, :])).max(axis=-1)
    margins = np.asarray(1.0 / np.sqrt(1.0 + beta**2))
    for i in np.flatnonzero(coincident):
        back = scale[i] ** np.arange(N + 1.0)
        one = TransferFunction(n[i] * back, d[i] * back)
        margins[i] = 1.0 / loop_shaping.gamma_opt(realise(one))
    return margins


def _conditions(Gs: TransferFunction) -> _Conditions:
    num, den = np.atleast_2d(Gs.num), np.atleast_2d(Gs.den)
    N = den.shape[-1] - 1
    lead = den[:, :1]
    num, den = (
        poly.add(num, np.zeros((len(den), N + 1))) / lead,
        poly.add(den, np.zeros((len(num), 1))) / lead,
    )
    s: ComplexArray = -np.sqrt(-poly.roots(Power(num, den).coefficients))
    scale = np.exp(np.log(np.abs(s) + 1e-300).mean(axis=-1)) if N else np.ones(len(den))
    down = scale[:, None] ** -np.arange(N + 1.0)
    n, d, s = num * down, den * down, s / scale[:, None]
    with np.errstate(all="ignore"):
        distance = np.abs(s[:, :, None] / s[:, None, :] - 1.0) + np.eye(N)
    coincident = ~(distance.min(axis=(1, 2), initial=1.0) > _COINCIDENT)
    a, b = _mixture(n, d, -s)
    above = a * poly.at(d, s) + b * poly.at(n, s)
    below = b * poly.at(d, -s) - a * poly.at(n, -s)
    return _Conditions(n, d, s, above / below, scale, coincident)


def _mixture(n: Array, d: Array, s: ComplexArray) -> tuple[Array, Array]:
    """a, b (B, 1), a² + b² = 1, with b d - a n far from 0 at ``s``, the roots of m~.

    The two conditions, that m~ divides d~c - nf and n~c + df, are the same unless a pole mirrors a zero (a
    delay does); then one is void. The mixture a (first) + b (second) never is.
    """
    at_n, at_d = poly.at(n, s), poly.at(d, s)
    size = np.abs(at_n) + np.abs(at_d)
    mixed = np.abs(np.cos(_ANGLES)[:, None, None] * at_d - np.sin(_ANGLES)[:, None, None] * at_n) / size
    angle = _ANGLES[mixed.min(axis=-1, initial=1.0).argmax(axis=0)][:, None]
    return np.sin(angle), np.cos(angle)


def _all_but_one(s: ComplexArray) -> ComplexArray:
    """(B, N, N - 1): row j has all of ``s`` (B, N) but s_j."""
    N = s.shape[-1]
    index = np.arange(N - 1) + (np.arange(N - 1) >= np.arange(N)[:, None])
    return s[:, index]


def _one(Gs: TransferFunction, i: int) -> TransferFunction:
    num, den = np.atleast_2d(Gs.num), np.atleast_2d(Gs.den)
    return TransferFunction(num[min(i, len(num) - 1)], den[min(i, len(den) - 1)])


def _combined(residues: ComplexArray, others: ComplexArray) -> Array:
    """Σ residue_j m/(s - s_j) (B, N)."""
    return (residues[:, None, :] @ others)[:, 0].real
