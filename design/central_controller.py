"""Appendix A and the controllers of eqs. (5) to (7) without a Riccati equation, batched over shaped plants.

For Gs = n/d and its spectral factor, m m~ = n n~ + d d~ with m Hurwitz (p~ is p(-s)), a controller p/q gives
1/ε² = 1 + max |f/c|² where d q + n p = m c and d~ p - n~ q = m f (Lagrange's identity). So a loop with
margin 1/γ is a function F = f/c with |F| <= β = sqrt(γ² - 1) whose values at the roots of m~ are prescribed:
Nevanlinna-Pick. The optimum is F = β c~/c, an eigenproblem in the remainders modulo m; the central solution
has β² c c~ - f f~ proportional to m m~, one linear equation. It is the controller that McFarlane and Glover
get from two Riccati equations (``loop_shaping``), for strictly proper plants and others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design import polynomials as poly
from design.peaks import Power
from design.plant import TransferFunction
from design.polynomials import Array

_ANGLES = np.pi / 16.0 * np.arange(16)


class _Remainders(NamedTuple):
    """The shaped plant in scaled time and its arithmetic modulo m."""

    n: Array
    d: Array
    m: Array
    mixing: Array
    """R (B, N, N); its eigenvalues are ±β at which F is all-pass."""
    scale: Array


def optimal_margins(Gs: TransferFunction) -> Array:
    """ε_opt (B,) of shaped plants (B, n + 1), Appendix A."""
    return _margin_of(_remainders(Gs))


def central_controllers(Gs: TransferFunction, factor: float = 1.1) -> tuple[TransferFunction, Array]:
    """K∞ (B, N + 1) of eq. (6) for γ = factor γ_opt, and ε_opt (B,). Negative feedback, factor > 1."""
    n, d, m, R, scale = remainders = _remainders(Gs)
    margin = _margin_of(remainders)
    N = m.shape[-1] - 1
    if N == 0:
        # A constant plant: the best controller is the plant's own gain.
        return TransferFunction(n.copy(), d.copy()), margin
    beta_squared = ((factor / margin) ** 2 - 1.0)[:, None]
    signs = (-1.0) ** np.arange(N - 1, -1, -1)
    s_to_N = -m[:, 1:]
    # c = s^N + low; (β² - R²) low = ±R Q s^N - β² s^N with Q = R J.
    right = (-1.0) ** N * _apply(R, _apply(R, signs * s_to_N)) - beta_squared * s_to_N
    low = np.linalg.solve(beta_squared[:, :, None] * np.eye(N) - R @ R, right[..., None])[..., 0]
    c = np.concatenate([np.ones((len(low), 1)), low], axis=-1)
    f = -signs * _apply(R, low + (-1.0) ** N * signs * s_to_N)
    m_mirrored, n_mirrored, d_mirrored = poly.mirror(m), poly.mirror(n), poly.mirror(d)
    q = _divide(poly.add(poly.multiply(d_mirrored, c), -poly.multiply(n, f)), m_mirrored)
    p = _divide(poly.add(poly.multiply(n_mirrored, c), poly.multiply(d, f)), m_mirrored)
    back = scale[:, None] ** np.arange(N + 1.0) / q[:, :1]
    return TransferFunction(p * back, q * back), margin


def _margin_of(remainders: _Remainders) -> Array:
    R = remainders.mixing
    if R.shape[-1] == 0:
        return np.ones(len(remainders.m))
    beta = np.abs(np.linalg.eigvals(R)).max(axis=-1)
    return np.asarray(1.0 / np.sqrt(1.0 + beta**2))


def _remainders(Gs: TransferFunction) -> _Remainders:
    num, den = np.atleast_2d(Gs.num), np.atleast_2d(Gs.den)
    N = den.shape[-1] - 1
    num = poly.add(num, np.zeros((len(den), N + 1)))
    den = poly.add(den, np.zeros((len(num), N + 1)))
    lead = den[:, :1].copy()
    num, den = num / lead, den / lead
    roots = _stable_roots(num, den)
    scale = np.exp(np.log(np.abs(roots) + 1e-300).mean(axis=-1)) if N else np.ones(len(den))
    down = scale[:, None] ** -np.arange(N + 1.0)
    n, d, roots = num * down, den * down, roots / scale[:, None]
    m = _refined(poly.from_roots(roots), n, d)
    # s^N + … is m up to a constant, which leaves remainders and divisibility as they are.
    a, b = _weights(n, d, -roots)
    alpha = a * d + b * n
    phi = b * poly.mirror(d) - a * poly.mirror(n)
    Q = np.linalg.solve(_multiplication(phi, m), _multiplication(alpha, m)) if N else np.zeros((len(d), 0, 0))
    signs = (-1.0) ** np.arange(N - 1, -1, -1)
    return _Remainders(n, d, m, Q * signs, scale)


def _stable_roots(n: Array, d: Array) -> poly.ComplexArray:
    """Roots of the spectral factor of n n~ + d d~: those in Re s < 0."""
    x = poly.roots(Power(n, d).coefficients)
    return np.asarray(-np.sqrt(-x))


def _refined(m: Array, n: Array, d: Array) -> Array:
    """One Newton step on m m~ = k (n n~ + d d~); multiple roots cost digits in roots, not in m."""
    N = m.shape[-1] - 1
    target = poly.multiply(n, poly.mirror(n)) + poly.multiply(d, poly.mirror(d))
    lead = target[:, :1] * (-1.0) ** N
    residual = (target / lead - poly.multiply(m, poly.mirror(m)))[:, ::2]
    columns = []
    for k in range(1, N + 1):
        unit = np.zeros((1, N + 1))
        unit[0, k] = 1.0
        product = poly.multiply(m, poly.mirror(unit))
        columns.append((product + poly.mirror(product))[:, ::2])
    if not columns:
        return m
    step = np.linalg.solve(np.stack(columns, axis=-1)[:, 1:], residual[:, 1:, None])[..., 0]
    refined = m.copy()
    refined[:, 1:] += step
    return refined


def _weights(n: Array, d: Array, roots: poly.ComplexArray) -> tuple[Array, Array]:
    """a, b (B, 1), a² + b² = 1, with b d - a n far from 0 at the roots of m~.

    The two conditions, that m~ divides d~c - nf and n~c + df, are the same unless a pole mirrors a zero (a
    delay does); then one is void. The mixture a (first) + b (second) never is.
    """
    at_n, at_d = poly.at(n, roots), poly.at(d, roots)
    size = np.abs(at_n) + np.abs(at_d)
    mixed = np.abs(np.cos(_ANGLES)[:, None, None] * at_d - np.sin(_ANGLES)[:, None, None] * at_n) / size
    worst = mixed.min(axis=-1) if roots.shape[-1] else np.ones((len(_ANGLES), len(n)))
    angle = _ANGLES[worst.argmax(axis=0)][:, None]
    return np.sin(angle), np.cos(angle)


def _multiplication(p: Array, m: Array) -> Array:
    """Matrix (B, N, N) of the remainder of p·(polynomial of degree < N) modulo monic m."""
    N = m.shape[-1] - 1
    column = np.zeros((len(m), N))
    columns = []
    for k in range(p.shape[-1]):  # Horner's rule modulo m
        column = _times_s(column, m)
        column[:, -1] += p[:, k]
    for _ in range(N):
        columns.append(column)
        column = _times_s(column, m)
    return np.stack(columns[::-1], axis=-1)


def _times_s(column: Array, m: Array) -> Array:
    shifted = np.concatenate([column[:, 1:], np.zeros((len(column), 1))], axis=-1)
    return np.asarray(shifted - column[:, :1] * m[:, 1:])


def _apply(matrix: Array, column: Array) -> Array:
    return np.asarray((matrix @ column[..., None])[..., 0])


def _divide(p: Array, m: Array) -> Array:
    """Exact quotient (B, N + 1) of p (B, 2N + 1) by m (B, N + 1), high powers first, low powers last.

    Each end of the quotient is found from its own end, where nothing has cancelled yet.
    """
    N = m.shape[-1] - 1
    quotient = np.zeros((len(p), N + 1))
    half = N // 2 + 1
    rest = p.copy()
    for k in range(half):
        quotient[:, k] = rest[:, k] / m[:, 0]
        rest[:, k : k + N + 1] -= quotient[:, k : k + 1] * m
    rest = p.copy()
    for k in range(N, half - 1, -1):
        quotient[:, k] = rest[:, k + N] / m[:, N]
        rest[:, k : k + N + 1] -= quotient[:, k : k + 1] * m
    return quotient
