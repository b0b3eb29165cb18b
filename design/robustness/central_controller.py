"""The optimal margin and the loop-shaping controller of many shaped plants at once.

:mod:`design.robustness.loop_shaping` solves two Riccati equations for each plant. A search needs the same
results for thousands of weights, so this module gets them by interpolation, in batches (Appendix A and eqs.
(5) to (7) of the paper).

Let the shaped plant be Gs = n/d, and let m be its spectral factor: m m~ = n n~ + d d~, with all roots of m in
Re s < 0 and p~(s) = p(-s).

1. A controller p/q has the margin ε for which 1/ε² = 1 + max |f/c|², where d q + n p = m c and d~ p - n~ q =
   m f (Lagrange's identity).
2. So a controller of margin 1/γ corresponds to a function F = f/c with |F| <= β = sqrt(γ² - 1) on the axis.
   Its values at the roots of m~ are prescribed by the plant: this is a Nevanlinna-Pick interpolation problem.
3. The optimum is β = ‖R‖, where the matrix R holds the prescribed values.
4. The central solution, for which β² c c~ - f f~ is proportional to m m~, is the controller of McFarlane and
   Glover, for strictly proper and other plants. It follows from one linear equation in R.

Functions g/m are written in the orthonormal basis of Takenaka and Malmquist, φ = (sI - A)^-1 b, with A + A* +
b b* = 0 and A triangular; the diagonal of A holds the roots of m. In this basis the roots may coincide
(delays cause that) or lie decades apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.mathematics import polynomials as poly
from design.mathematics.peaks import SquaredMagnitude
from design.mathematics.polynomials import Array, ComplexArray
from design.models.transfer_function import TransferFunction
from design.robustness.loop_shaping import check_factor

_ANGLES = np.pi / 16.0 * np.arange(16)
"""Angles among which the mixture of both divisibility conditions is chosen."""
_NEARLY_ZERO = 1e-100
"""Number added to avoid a division by 0."""
_HUGE = 1e60
"""Entry of R where the plant hides an unstable mode, so that no controller stabilises it."""


class _Problem(NamedTuple):
    """The interpolation problem of B monic shaped plants of order N, in scaled time."""

    n: Array
    """Numerators (B, N + 1)."""
    roots: ComplexArray
    """Roots (B, N) of m, the fastest first, so that triangular solutions divide large by large numbers."""
    A: ComplexArray
    """State matrix (B, N, N) of the basis."""
    b: Array
    """Input vector (B, N) of the basis."""
    R: ComplexArray
    """Prescribed values (B, N, N)."""
    values: tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]
    """The polynomials n, n~, d and d~ at the matrix A, each (B, N, N)."""
    scale: Array
    """Unit of the scaled frequency in rad/s (B,)."""


def optimal_margins(Gs: TransferFunction) -> Array:
    """Return ε_opt (B,) of shaped plants (B, n + 1), the largest margin of any controller (Appendix A).

    It is 0 where the plant hides an unstable mode.
    """
    return _margins(_problem(Gs).R)


def central_controllers(Gs: TransferFunction, factor: float = 1.1) -> tuple[TransferFunction, Array]:
    """Return the controllers K∞ (B, N + 1) of eq. (6) for γ = factor γ_opt, and ε_opt (B,).

    The controllers are for negative feedback. Raises DesignError unless ``factor`` is over 1.
    """
    check_factor(factor)
    problem = _problem(Gs)
    margins = _margins(problem.R)
    k, f = _central_solution(problem, margins, factor)
    return _controller(problem, k, f), margins


def _margins(R: ComplexArray) -> Array:
    if R.shape[-1] == 0:
        return np.ones(len(R))
    beta_squared = np.linalg.eigvalsh(R @ R.conj().transpose(0, 2, 1))[:, -1]
    return np.asarray(1.0 / np.sqrt(1.0 + beta_squared))


def _central_solution(problem: _Problem, margins: Array, factor: float) -> tuple[ComplexArray, ComplexArray]:
    """Return k and l (B, N, 1) of the central solution c = m (1 + k'φ), f = m l'φ.

    They solve conj(l) = -R (b + conj(k)) and conj(k) = -R* conj(l)/β².
    """
    R, column = problem.R, problem.b[:, :, None]
    N = problem.roots.shape[-1]
    beta_squared = ((factor / np.maximum(margins, _NEARLY_ZERO)) ** 2 - 1.0)[:, None, None]
    R_star = R.conj().transpose(0, 2, 1)
    l_conj = np.linalg.solve(np.eye(N) - R @ R_star / beta_squared, -R @ column)
    k = np.asarray((-R_star @ l_conj / beta_squared).conj(), dtype=np.complex128)
    return k, np.asarray(l_conj.conj())


def _controller(problem: _Problem, k: ComplexArray, f: ComplexArray) -> TransferFunction:
    """Return p/q with q m~ = d~ c - n f and p m~ = n~ c + d f.

    As s goes to infinity, q approaches m, and p approaches n_N m with the leading coefficient n_N of n.
    """
    n, roots, A, b, _, (n_A, n_mirrored_A, d_A, d_mirrored_A), scale = problem
    N = roots.shape[-1]
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
    to_true_time = scale[:, None] ** np.arange(N + 1.0)
    q = poly.add(m, sums[:, 0]) * to_true_time
    p = poly.add(n[:, :1] * m, sums[:, 1]) * to_true_time
    return TransferFunction(p, q)


def _problem(Gs: TransferFunction) -> _Problem:
    num, den = np.atleast_2d(Gs.num), np.atleast_2d(Gs.den)
    N = den.shape[-1] - 1
    lead = den[:, :1]
    num, den = (
        poly.add(num, np.zeros((len(den), N + 1))) / lead,
        poly.add(den, np.zeros((len(num), 1))) / lead,
    )
    roots: ComplexArray = -np.sqrt(-poly.roots(SquaredMagnitude(num, den).coefficients))
    # A hidden mode on the axis is a root of m there. Nothing stabilises such a plant, so any roots will do.
    hidden = ~(np.isfinite(roots) & (roots.real < 0.0)).all(axis=-1)
    roots[hidden] = -1.0
    roots = np.take_along_axis(roots, np.argsort(-np.abs(roots), axis=-1), axis=-1)
    scale = np.exp(np.log(np.abs(roots) + 1e-300).mean(axis=-1)) if N else np.ones(len(den))
    to_scaled_time = scale[:, None] ** -np.arange(N + 1.0)
    n, d, roots = num * to_scaled_time, den * to_scaled_time, roots / scale[:, None]
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
    """Return p(A) and p(-A), each (B, N, N)."""
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
    """Return cos and sin (B, 1, 1) of the angle that keeps cos d - sin n away from 0 at the roots of m~.

    R has to make two polynomials divisible by m~: d~ c - n f and n~ c + d f. Both conditions are equivalent
    unless a pole of the plant mirrors a zero, as a delay does; then one of them is void. The mixture of
    sin times the first and cos times the second never is.
    """
    size = np.abs(at_n) + np.abs(at_d) + _NEARLY_ZERO
    mixed = np.abs(np.cos(_ANGLES)[:, None, None] * at_d - np.sin(_ANGLES)[:, None, None] * at_n) / size
    angle = _ANGLES[mixed.min(axis=-1, initial=1.0).argmax(axis=0)][:, None, None]
    return np.cos(angle), np.sin(angle)


def _basis(roots: ComplexArray, b: Array) -> ComplexArray:
    """Return the polynomials m φ_j (B, N, N): b_j Π_{i<j} (s + conj s_i) Π_{i>j} (s - s_i)."""
    N = roots.shape[-1]
    others = np.arange(N - 1) + (np.arange(N - 1) >= np.arange(N)[:, None])
    before = others < np.arange(N)[:, None]
    chosen = roots[:, others]
    return b[:, :, None] * poly.from_roots(np.where(before, -chosen.conj(), chosen))
