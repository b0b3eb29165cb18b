"""Batched polynomial algebra: arrays (..., n + 1) of real coefficients in falling powers.

The leading axes are candidates; a polynomial shared by all candidates has shape (1, n + 1) or (n + 1,).
Lives here: arithmetic, powers |p(jω)|² as polynomials in x = ω², roots by companion matrices, the Routh
test. No control engineering.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]


def multiply(*factors: Array) -> Array:
    """Product of polynomials; leading axes broadcast."""
    product = factors[0]
    for factor in factors[1:]:
        n, m = product.shape[-1], factor.shape[-1]
        terms = product[..., :, None] * factor[..., None, :]
        product = terms.reshape(*terms.shape[:-2], n * m) @ _gathering(n, m)
    return product


def add(*terms: Array) -> Array:
    """Sum of polynomials of any degrees; leading axes broadcast."""
    batch = np.broadcast_shapes(*(term.shape[:-1] for term in terms))
    total = np.zeros((*batch, max(term.shape[-1] for term in terms)))
    for term in terms:
        total[..., total.shape[-1] - term.shape[-1] :] += term
    return total


def mirror(p: Array) -> Array:
    """p(-s)."""
    return p * _signs(p.shape[-1])


def power(p: Array) -> Array:
    """|p(jω)|² as a polynomial in x = ω², of the degree of p."""
    n = p.shape[-1]
    terms = p[..., :, None] * p[..., None, :]
    return np.asarray(terms.reshape(*p.shape[:-1], n * n) @ _gathering_power(n))


def derivative(p: Array) -> Array:
    """dp/ds."""
    n = p.shape[-1]
    return p[..., :-1] * np.arange(n - 1.0, 0.0, -1.0) if n > 1 else np.zeros_like(p)


def at(p: Array, s: NDArray[Any]) -> NDArray[Any]:
    """Values (..., k) of polynomials (..., n + 1) at points (..., k), real or complex."""
    value: NDArray[Any] = p[..., :1] * s if p.shape[-1] > 1 else p + np.zeros_like(s)
    for i in range(1, p.shape[-1]):
        value += p[..., i : i + 1]
        if i < p.shape[-1] - 1:
            value *= s
    return value


def power_at(p: Array, omega: Array) -> Array:
    """|p(jω)|² at ω (..., k), from even and odd part: no digits are lost near a root close to the axis."""
    n = p.shape[-1]
    powers = omega[..., None] ** np.arange(n - 1.0, -1.0, -1.0)
    parts = (p[..., None, :] * powers) @ _even_odd_signs(n)
    return np.asarray((parts * parts).sum(axis=-1))


def even_odd(p: Array) -> tuple[Array, Array]:
    """E and O, polynomials in x = ω² with p(jω) = E(x) + jω O(x)."""
    even, odd = p[..., ::-1][..., ::2], p[..., ::-1][..., 1::2]
    if odd.shape[-1] == 0:
        odd = np.zeros((*p.shape[:-1], 1))
    return (
        (even * (-1.0) ** np.arange(even.shape[-1]))[..., ::-1],
        (odd * (-1.0) ** np.arange(odd.shape[-1]))[..., ::-1],
    )


def roots(p: Array) -> ComplexArray:
    """Roots (..., n) of polynomials (..., n + 1), by companion eigenvalues; ∞ for each leading 0.

    Of p and of its reversal, whose roots are the inverses, the one is taken whose companion matrix is less
    dominated by a far root: a nearly vanishing end coefficient then costs the other roots no digits.
    """
    shape, n = p.shape[:-1], p.shape[-1] - 1
    if n == 0:
        return np.zeros((*shape, 0), dtype=np.complex128)
    flat = p.reshape(-1, n + 1)
    vanishing = np.argmax(flat != 0.0, axis=-1)
    if vanishing.any():
        index = np.arange(n + 1) + vanishing[:, None]
        flat = np.where(index <= n, np.take_along_axis(flat, np.minimum(index, n), axis=-1), 0.0)
    reverse = np.zeros(len(flat), dtype=bool)
    with np.errstate(all="ignore"):
        if n > 2:
            size = np.abs(flat)
            far = size[:, 1] * size[:, n] / (size[:, 0] * size[:, n - 1])
            reverse = far > (size[:, n - 1] / size[:, 1]) ** (2.0 / (n - 2))
            reverse &= size[:, n] > 0.0
        flat = np.where(reverse[:, None], flat[:, ::-1], flat)
        companion = np.zeros((len(flat), n, n))
        companion[:, 0] = np.nan_to_num(-flat[:, 1:] / flat[:, :1], posinf=1e200, neginf=-1e200)
        companion[:, np.arange(1, n), np.arange(n - 1)] = 1.0
        found = np.linalg.eigvals(companion).astype(np.complex128)
        found = np.where(reverse[:, None], 1.0 / found, found)
    if vanishing.any():
        found = np.take_along_axis(found, np.argsort(np.abs(found), axis=-1), axis=-1)
        found[np.arange(n) < vanishing[:, None]] = np.inf
    return found.reshape(*shape, n)


def from_roots(zeros: ComplexArray) -> ComplexArray:
    """Monic polynomials (..., n + 1) with roots (..., n); real but for rounding where those pair up."""
    product = np.zeros((*zeros.shape[:-1], zeros.shape[-1] + 1), dtype=np.complex128)
    product[..., 0] = 1.0
    for i in range(zeros.shape[-1]):
        product[..., 1 : i + 2] -= zeros[..., i : i + 1] * product[..., : i + 1]
    return product


def hurwitz(p: Array) -> Flags:
    """Whether all roots (...) lie in Re s < 0, by the Routh table. A leading coefficient of 0 fails."""
    n = p.shape[-1]
    p = p * np.sign(p[..., :1])
    width = (n + 1) // 2
    above, row = np.zeros((2, *p.shape[:-1], width + 1))
    above[..., :width], row[..., : n // 2] = p[..., ::2], p[..., 1::2]
    firsts = [above[..., 0], row[..., 0]][:n]
    with np.errstate(all="ignore"):
        for _ in range(n - 2):
            below = np.zeros_like(row)
            below[..., :-1] = above[..., 1:] - (above[..., :1] / row[..., :1]) * row[..., 1:]
            firsts.append(below[..., 0])
            above, row = row, below
    return np.asarray((np.stack(firsts) > 0.0).all(axis=0))


def spectral_abscissa(p: Array) -> Array:
    """Largest real part (...) of the roots."""
    if p.shape[-1] == 1:
        return np.full(p.shape[:-1], -np.inf)
    return np.asarray(roots(p).real.max(axis=-1))


def substitute_fraction(p: Array, above: Sequence[float], below: Sequence[float]) -> Array:
    """Numerator of p(a(s)/b(s)) over b(s)^n, for polynomials a and b of one degree each."""
    n = p.shape[-1] - 1
    a, b = np.asarray(above, dtype=float), np.asarray(below, dtype=float)
    total = p[..., :1]
    b_power = np.ones(1)
    for i in range(1, n + 1):
        b_power = multiply(b_power, b)
        total = add(multiply(total, a), p[..., i : i + 1] * b_power)
    return total


def _signs(n: int) -> Array:
    """+1 for even, -1 for odd powers, of polynomials with n coefficients."""
    return np.asarray((-1.0) ** np.arange(n - 1, -1, -1))


@lru_cache
def _gathering(n: int, m: int) -> Array:
    """Matrix (n m, n + m - 1) that adds up the products of coefficients that belong to one power."""
    i, j = np.divmod(np.arange(n * m), m)
    return np.asarray((i + j)[:, None] == np.arange(n + m - 1), dtype=np.float64)


@lru_cache
def _gathering_power(n: int) -> Array:
    """The same (n n, n) for p(s) p(-s) with s² = -x."""
    i, j = np.divmod(np.arange(n * n), n)
    signs = (-1.0) ** (n - 1 - j) * (-1.0) ** np.arange(n - 1, -1, -1)[:, None]
    return np.asarray(((i + j)[:, None] == 2 * np.arange(n)) * signs.T, dtype=np.float64)


@lru_cache
def _even_odd_signs(n: int) -> Array:
    """Matrix (n, 2) that takes p_k ω^k to the real and the imaginary part of p(jω)."""
    k = np.arange(n - 1, -1, -1)
    return np.stack([np.array([1.0, 0.0, -1.0, 0.0])[k % 4], np.array([0.0, 1.0, 0.0, -1.0])[k % 4]], axis=-1)
