"""Appendix A and the controllers of eqs. (5) to (7) without a Riccati equation, batched over shaped plants.

For Gs = n/d let m be the spectral factor, m m~ = n n~ + d d~ with m Hurwitz (p~ is p(-s)). A controller p/q
gives 1/ε² = 1 + max |f/c|², where d q + n p = m c and d~ p - n~ q = m f (Lagrange's identity). So a loop of
margin 1/γ is a function F = f/c, |F| <= β = sqrt(γ² - 1), whose values at the roots of m~ are prescribed:
Nevanlinna-Pick. Its central solution, for which β² c c~ - f f~ is proportional to m m~, is the controller
that McFarlane and Glover get from two Riccati equations (``loop_shaping``), strictly proper plant or not.

Everything is written in the orthonormal basis of Takenaka and Malmquist for functions g/m, φ = (sI - A)^-1 b
with A + A* + b b* = 0 and A triangular, its diagonal the roots of m. There the prescribed values are one
matrix R, a function of A; the optimum is β = ‖R‖ and the central solution one Hermitian equation. Roots may
coincide (delays do that) or lie decades apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.mathematics import polynomials as poly
from design.mathematics.peaks import Power
from design.mathematics.polynomials import Array, ComplexArray
from design.models.plant import TransferFunction
from design.robustness.loop_shaping import check_factor

_ANGLES = np.pi / 16.0 * np.arange(16)
_NEARLY_ZERO = 1e-100
_HUGE = 1e60
"""For β where an unstable mode is hidden, and nothing stabilises."""


class _Problem(NamedTuple):
    """Monic shaped plants (B, N + 1) in scaled time, and the interpolation problem in the basis."""

    n: Array
    roots: ComplexArray
    """Of m (B, N), the fastest first: so triangular solutions divide large by large."""
    A: ComplexArray
    """(B, N, N)"""
    b: Array
    """(B, N)"""
    R: ComplexArray
    """(B, N, N)"""
    values: tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]
    """n, n~, d, d~ of A."""
    scale: Array
    """rad/s (B,)"""


def optimal_margins(Gs: TransferFunction) -> Array:
    """ε_opt (B,) of shaped plants (B, n + 1), Appendix A; 0 where an unstable mode is hidden."""
    return _margins(_problem(Gs).R)


def central_controllers(Gs: TransferFunction, factor: float = 1.1) -> tuple[TransferFunction, Array]:
    """K∞ (B, N + 1) of eq. (6) for γ = factor γ_opt, and ε_opt (B,). Negative feedback, factor > 1."""
    check_factor(factor)
    problem = _problem(Gs)
    n, roots, A, b, R, (n_A, n_mirrored_A, d_A, d_mirrored_A), scale = problem
    margins = _margins(R)
    N = roots.shape[-1]
    beta_squared = ((factor / np.maximum(margins, _NEARLY_ZERO)) ** 2 - 1.0)[:, None, None]
    # c = m (1 + k'φ), f = m l'φ, and conj(l) = -R (b + conj(k)), conj(k) = -R* conj(l)/β².
    column = b[:, :, None]
    R_star = R.conj().transpose(0, 2, 1)
    l_conj = np.linalg.solve(np.eye(N) - R @ R_star / beta_squared, -R @ column)
    k = (-R_star @ l_conj / beta_squared).conj()
    f = l_conj.conj()
    # q m~ = d~c - nf and p m~ = n~c + df; so q -> m and p -> n_N m as s -> ∞.
    eye = np.eye(N)
    at_mirror = eye + np.zeros_like(A)
    for i in range(N):
        at_mirror = at_mirror @ (-A - roots[:, i, None, None] * eye)
    right = np.concatenate(
        [
            d_mirrored_A.transpose(0, 2, 1) @ k - n_A.transpose(0, 2, 1) @ f,
            n_mirrored_A.transpose(0, 2, 1) @ k + d_A.transpose(0, 2, 1) @ f,
        ],
        axis=-1,
    )
    shares = np.linalg.solve(at_mirror.transpose(0, 2, 1), right).transpose(0, 2, 1)
    m, basis = poly.from_roots(roots).real, _basis(roots, b)
    sums = (shares @ basis).real if N else np.zeros((len(n), 2, 1))
    back = scale[:, None] ** np.arange(N + 1.0)
    q = poly.add(m, sums[:, 0]) * back
    p = poly.add(n[:, :1] * m, sums[:, 1]) * back
    return TransferFunction(p, q), margins


def _margins(R: ComplexArray) -> Array:
    if R.shape[-1] == 0:
        return np.ones(len(R))
    beta_squared = np.linalg.eigvalsh(R @ R.conj().transpose(0, 2, 1))[:, -1]
    return np.asarray(1.0 / np.sqrt(1.0 + beta_squared))


def _problem(Gs: TransferFunction) -> _Problem:
    num, den = np.atleast_2d(Gs.num), np.atleast_2d(Gs.den)
    N = den.shape[-1] - 1
    lead = den[:, :1]
    num, den = (
        poly.add(num, np.zeros((len(den), N + 1))) / lead,
        poly.add(den, np.zeros((len(num), 1))) / lead,
    )
    roots: ComplexArray = -np.sqrt(-poly.roots(Power(num, den).coefficients))
    # A hidden mode on the axis is a root of m there: any other roots will do, for nothing stabilises.
    hidden = ~(np.isfinite(roots) & (roots.real < 0.0)).all(axis=-1)
    roots[hidden] = -1.0
    roots = np.take_along_axis(roots, np.argsort(-np.abs(roots), axis=-1), axis=-1)
    scale = np.exp(np.log(np.abs(roots) + 1e-300).mean(axis=-1)) if N else np.ones(len(den))
    down = scale[:, None] ** -np.arange(N + 1.0)
    n, d, roots = num * down, den * down, roots / scale[:, None]
    b = np.sqrt(-2.0 * roots.real)
    i = np.arange(N)
    A = np.where(i[:, None] > i, -b[:, :, None] * b[:, None, :], 0.0).astype(np.complex128)
    A[:, i, i] = roots
    with np.errstate(all="ignore"):
        n_A, n_mirrored_A = _at_matrix(n, A)
        d_A, d_mirrored_A = _at_matrix(d, A)
        cos, sin = _mixture(n_mirrored_A[:, i, i], d_mirrored_A[:, i, i])
        below = cos * d_mirrored_A - sin * n_mirrored_A
        below[:, i, i] += _NEARLY_ZERO
        above = sin * d_A + cos * n_A
        below[hidden], above[hidden] = np.eye(N), _HUGE * np.eye(N)
        R = np.linalg.solve(below.transpose(0, 2, 1), above.transpose(0, 2, 1)).transpose(0, 2, 1)
        R[~(np.abs(R) < _HUGE)] = _HUGE
    return _Problem(n, roots, A, b, R.astype(np.complex128), (n_A, n_mirrored_A, d_A, d_mirrored_A), scale)


def _at_matrix(p: Array, A: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """p(A) and p(-A) (B, N, N)."""
    eye, square = np.eye(A.shape[-1]), A @ A
    parts = []
    for coefficients in (p[:, ::-1][:, ::2], p[:, ::-1][:, 1::2]):
        value = np.zeros_like(A)
        for i in range(coefficients.shape[-1] - 1, -1, -1):
            value = value @ square + coefficients[:, i, None, None] * eye
        parts.append(value)
    even, odd = parts[0], A @ parts[1]
    return even + odd, even - odd


def _mixture(at_n: ComplexArray, at_d: ComplexArray) -> tuple[Array, Array]:
    """cos, sin (B, 1, 1) of the angle that keeps cos d - sin n farthest from 0 at the roots of m~.

    The two conditions, that m~ divides d~c - nf and n~c + df, are the same unless a pole mirrors a zero (a
    delay does); then one is void. The mixture sin (first) + cos (second) never is.
    """
    size = np.abs(at_n) + np.abs(at_d) + _NEARLY_ZERO
    mixed = np.abs(np.cos(_ANGLES)[:, None, None] * at_d - np.sin(_ANGLES)[:, None, None] * at_n) / size
    angle = _ANGLES[mixed.min(axis=-1, initial=1.0).argmax(axis=0)][:, None, None]
    return np.cos(angle), np.sin(angle)


def _basis(roots: ComplexArray, b: Array) -> ComplexArray:
    """m φ_j as polynomials (B, N, N): b_j Π_{i<j} (s + conj s_i) Π_{i>j} (s - s_i)."""
    N = roots.shape[-1]
    others = np.arange(N - 1) + (np.arange(N - 1) >= np.arange(N)[:, None])
    before = others < np.arange(N)[:, None]
    chosen = roots[:, others]
    return b[:, :, None] * poly.from_roots(np.where(before, -chosen.conj(), chosen))
