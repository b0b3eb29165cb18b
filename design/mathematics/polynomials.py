"""Algebra of batches of real polynomials.

A batch is an array (..., n + 1) of coefficients in falling powers of s. The leading axes count candidates; a
polynomial that all candidates share has the shape (1, n + 1) or (n + 1,). Squared magnitudes |p(jω)|² are
polynomials in x = ω².
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
    """Return the product of polynomials; leading axes broadcast."""
    product = factors[0]
    for factor in factors[1:]:
        n, m = product.shape[-1], factor.shape[-1]
        terms = product[..., :, None] * factor[..., None, :]
        product = terms.reshape(*terms.shape[:-2], n * m) @ _product_sums(n, m)
    return product


def add(*terms: Array) -> Array:
    """Return the sum of polynomials of any degrees; leading axes broadcast."""
    batch = np.broadcast_shapes(*(term.shape[:-1] for term in terms))
    total = np.zeros((*batch, max(term.shape[-1] for term in terms)))
    for term in terms:
        total[..., total.shape[-1] - term.shape[-1] :] += term
    return total


def mirror(p: Array) -> Array:
    """Return p(-s)."""
    return p * _signs(p.shape[-1])


def squared_magnitude(p: Array) -> Array:
    """Return |p(jω)|² as a polynomial in x = ω², which has the degree of p."""
    n = p.shape[-1]
    terms = p[..., :, None] * p[..., None, :]
    return np.asarray(terms.reshape(*p.shape[:-1], n * n) @ _squared_magnitude_sums(n))


def derivative(p: Array) -> Array:
    """Return dp/ds."""
    n = p.shape[-1]
    return p[..., :-1] * np.arange(n - 1.0, 0.0, -1.0) if n > 1 else np.zeros_like(p)


def at(p: Array, s: NDArray[Any]) -> NDArray[Any]:
    """Return the values (..., k) of polynomials (..., n + 1) at real or complex points (..., k)."""
    value: NDArray[Any] = p[..., :1] * s if p.shape[-1] > 1 else p + np.zeros_like(s)
    for i in range(1, p.shape[-1]):
        value += p[..., i : i + 1]
        if i < p.shape[-1] - 1:
            value *= s
    return value


def squared_magnitude_at(p: Array, omega: Array) -> Array:
    """Return |p(jω)|² at ω (..., k).

    It is computed from the real and the imaginary part of p(jω). So it keeps its relative precision near a
    root close to the imaginary axis, where the polynomial of :func:`squared_magnitude` loses it.
    """
    n = p.shape[-1]
    powers = omega[..., None] ** np.arange(n - 1.0, -1.0, -1.0)
    parts = (p[..., None, :] * powers) @ _even_odd_signs(n)
    return np.asarray((parts * parts).sum(axis=-1))


def even_odd(p: Array) -> tuple[Array, Array]:
    """Return the polynomials E and O in x = ω² for which p(jω) = E(x) + jω O(x)."""
    even, odd = p[..., ::-1][..., ::2], p[..., ::-1][..., 1::2]
    if odd.shape[-1] == 0:
        odd = np.zeros((*p.shape[:-1], 1))
    return (
        (even * (-1.0) ** np.arange(even.shape[-1]))[..., ::-1],
        (odd * (-1.0) ** np.arange(odd.shape[-1]))[..., ::-1],
    )


def roots(p: Array) -> ComplexArray:
    """Return the roots (..., n) of polynomials (..., n + 1); ∞ stands for each leading coefficient that is 0.

    The roots are eigenvalues of a companion matrix. A root far from all others (a nearly vanishing first or
    last coefficient) would cost the others their precision. So each polynomial is reversed where that keeps
    more digits; the roots of the reversed polynomial are the inverses.
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
    """Return the monic polynomials (..., n + 1), as complex arrays, that have the roots (..., n)."""
    product = np.zeros((*zeros.shape[:-1], zeros.shape[-1] + 1), dtype=np.complex128)
    product[..., 0] = 1.0
    for i in range(zeros.shape[-1]):
        product[..., 1 : i + 2] -= zeros[..., i : i + 1] * product[..., : i + 1]
    return product


def hurwitz(p: Array) -> Flags:
    """Return for each polynomial (...) if all its roots have Re s < 0, by the Routh table.

    A polynomial whose leading coefficient is 0 has a root at infinity and counts as unstable.
    """
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
    """Return the largest real part (...) of the roots; -∞ for a constant."""
    if p.shape[-1] == 1:
        return np.full(p.shape[:-1], -np.inf)
    return np.asarray(roots(p).real.max(axis=-1))


def substitute_fraction(p: Array, above: Sequence[float], below: Sequence[float]) -> Array:
    """Return the numerator of p(a(s)/b(s)) over the denominator b(s)^n.

    ``above`` and ``below`` are the two coefficients of a and of b, polynomials of degree 1.
    """
    n = p.shape[-1] - 1
    a, b = np.asarray(above, dtype=float), np.asarray(below, dtype=float)
    total = p[..., :1]
    b_power = np.ones(1)
    for i in range(1, n + 1):
        b_power = multiply(b_power, b)
        total = add(multiply(total, a), p[..., i : i + 1] * b_power)
    return total


def _signs(n: int) -> Array:
    """Return +1 for each even and -1 for each odd power of a polynomial with n coefficients."""
    return np.asarray((-1.0) ** np.arange(n - 1, -1, -1))


@lru_cache
def _product_sums(n: int, m: int) -> Array:
    """Return the matrix (n m, n + m - 1) that adds up the products of coefficients which share a power."""
    i, j = np.divmod(np.arange(n * m), m)
    return np.asarray((i + j)[:, None] == np.arange(n + m - 1), dtype=np.float64)


@lru_cache
def _squared_magnitude_sums(n: int) -> Array:
    """Return the matrix (n n, n) that adds up the products of coefficients in p(s) p(-s), with s² = -x."""
    i, j = np.divmod(np.arange(n * n), n)
    signs = (-1.0) ** (n - 1 - j) * (-1.0) ** np.arange(n - 1, -1, -1)[:, None]
    return np.asarray(((i + j)[:, None] == 2 * np.arange(n)) * signs.T, dtype=np.float64)


@lru_cache
def _even_odd_signs(n: int) -> Array:
    """Return the matrix (n, 2) that turns the terms p_k ω^k into the real and the imaginary part of p(jω)."""
    k = np.arange(n - 1, -1, -1)
    return np.stack([np.array([1.0, 0.0, -1.0, 0.0])[k % 4], np.array([0.0, 1.0, 0.0, -1.0])[k % 4]], axis=-1)
