"""The largest value, over all frequencies, of a ratio of squared magnitudes.

Every H-infinity norm of this package is such a ratio N(x)/D(x) in x = ω², where N and D are products of sums
of |p(jω)|². It is found exactly, without a frequency grid (Boyd, Balakrishnan and Kabamba 1989; Bruinsma and
Steinbuch 1990; here on polynomials instead of Hamiltonian matrices):

1. The values at ω = 0, at ω = ∞ and where the asymptotes bend give a lower bound γ² of the peak. Newton's
   method raises it to a local maximum.
2. The level polynomial N - γ² D has no positive root exactly if γ² is the peak. Otherwise the ratio is above
   γ² somewhere between the roots, and the search goes on from there.
3. At the peak, the ratio is evaluated once more from the real and imaginary parts of the polynomials. So a
   lightly damped mode costs no precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array

_HIGHER = 1.0 + 1e-11
"""Factor by which a new level must exceed the previous one; a smaller gain is rounding."""
_MAX_ROUNDS = 30
"""Largest number of level polynomials; a few suffice."""
_BLURRED = 1e-9
"""Relative difference between both ways to evaluate the ratio above which its coefficients are imprecise."""


class SquaredMagnitude:
    """The sum of |p(jω)|² over several polynomials p (..., n + 1)."""

    def __init__(self, *parts: Array) -> None:
        self._parts = tuple(part if part.ndim > 1 else part[None, :] for part in parts)

    @cached_property
    def coefficients(self) -> Array:
        """Coefficients (B, n + 1) of the sum as a polynomial in x = ω²."""
        return poly.add(*(poly.squared_magnitude(part) for part in self._parts))

    def at(self, omega: Array) -> Array:
        """Return the values (B, k) at ω (B, k) in rad/s."""
        total = poly.squared_magnitude_at(self._parts[0], omega)
        for part in self._parts[1:]:
            total = total + poly.squared_magnitude_at(part, omega)
        return total


class SquaredMagnitudeInX(SquaredMagnitude):
    """A squared magnitude given only by its coefficients (B, n + 1) as a polynomial in x = ω²."""

    def __init__(self, coefficients: Array) -> None:
        super().__init__()
        self.coefficients = coefficients

    def at(self, omega: Array) -> Array:
        """See :class:`SquaredMagnitude`."""
        return np.asarray(poly.at(self.coefficients, omega * omega))


def peak(
    above: Sequence[SquaredMagnitude], below: Sequence[SquaredMagnitude], cutoff: Array | None = None
) -> tuple[Array, Array]:
    """Return the supremum (B,) over 0 <= ω <= ∞ of the ratio, and the ω (B,) in rad/s where it is taken.

    The ratio is the product of ``above`` over the product of ``below``. The supremum is ∞ where a pole lies
    on the imaginary axis. The frequency may be 0 or ∞. Where the supremum is over ``cutoff`` (B,), any value
    over the cutoff may be returned, which is faster.
    """
    pair = _coefficients(above, below)
    with np.errstate(all="ignore"):
        best, place = _ends(pair)
        ends = best.copy()
        _improve(best, place, _bends(pair), pair)
        _climb(best, place, pair)
        _raise_level(best, place, pair, np.full(len(best), np.inf) if cutoff is None else cutoff)
        is_inside = np.isfinite(place) & (place > 0.0)
        omega = np.sqrt(place)
        inner = np.where(is_inside, omega, 1.0)[:, None]
        value = _ratio(inner, above, below)
        is_blurred = is_inside & (np.abs(value[:, 0] / best - 1.0) > _BLURRED)
        if is_blurred.any():
            value, inner = _zoom(inner, above, below)
            omega = np.where(is_inside, inner[:, 0], omega)
        best = np.where(is_inside, np.maximum(value[:, 0], ends), best)
    return best, omega


def _coefficients(above: Sequence[SquaredMagnitude], below: Sequence[SquaredMagnitude]) -> Array:
    """Return numerator and denominator (2, B, n + 1) of the ratio as polynomials in x."""
    N = poly.multiply(*(factor.coefficients for factor in above))
    D = poly.multiply(*(factor.coefficients for factor in below))
    pair = np.zeros((2, max(len(N), len(D)), max(N.shape[-1], D.shape[-1], 2)))
    pair[0, :, pair.shape[-1] - N.shape[-1] :] = N
    pair[1, :, pair.shape[-1] - D.shape[-1] :] = D
    return pair


def _raise_level(best: Array, place: Array, pair: Array, cutoff: Array) -> None:
    """Raise ``best`` (B,), at x = ``place`` (B,), to the peak or beyond the cutoff, in place."""
    active = np.flatnonzero(best < cutoff)
    for _ in range(_MAX_ROUNDS):
        if not len(active):
            break
        some, b, p = pair[:, active], best[active], place[active]
        before = b.copy()
        _improve(b, p, _between_roots(some[0] - b[:, None] * some[1]), some)
        is_higher = b > before * _HIGHER
        if is_higher.any():
            _climb(b, p, some)
            best[active], place[active] = b, p
        active = active[is_higher & (b < cutoff[active])]


def _ratio(omega: Array, above: Sequence[SquaredMagnitude], below: Sequence[SquaredMagnitude]) -> Array:
    """Return the ratio (B, k) at ω (B, k) in rad/s, from real and imaginary parts."""
    value = np.ones_like(omega)
    for factor in above:
        value = value * factor.at(omega)
    for factor in below:
        value = value / factor.at(omega)
    return value


def _zoom(
    omega: Array, above: Sequence[SquaredMagnitude], below: Sequence[SquaredMagnitude]
) -> tuple[Array, Array]:
    """Return the highest ratio (B, 1) in the neighbourhood of ω (B, 1), and the ω where it is taken.

    This is for modes with so little damping that the coefficients of N and D do not locate their peak.
    """
    rows = np.arange(len(omega))
    width = 1e-3
    while width > 1e-17:
        around = omega * (1.0 + width * np.linspace(-1.0, 1.0, 9))
        value = _ratio(around, above, below)
        omega = around[rows, value.argmax(axis=-1)][:, None]
        width /= 3.0
    return _ratio(omega, above, below), omega


def _ends(pair: Array) -> tuple[Array, Array]:
    """Return the larger (B,) of the ratios at x = 0 and x = ∞, and the x (B,) that it belongs to."""
    at_zero, at_infinity = _first_nonzero_ratio(pair[..., ::-1]), _first_nonzero_ratio(pair)
    return np.maximum(at_zero, at_infinity), np.where(at_zero >= at_infinity, 0.0, np.inf)


def _first_nonzero_ratio(pair: Array) -> Array:
    """Return the ratio (B,) of the first coefficients that are not both 0."""
    leading = np.argmax((pair != 0.0).any(axis=0), axis=-1)
    n, d = pair[:, np.arange(pair.shape[1]), leading]
    return np.where(d > 0.0, n / d, np.where(n > 0.0, np.inf, 0.0))


def _bends(pair: Array) -> Array:
    """Return the x (B, 2n) at which asymptotes of N and D bend: the ratios of neighbouring coefficients."""
    ratios = np.abs(pair[..., 1:] / pair[..., :-1])
    x = np.concatenate([ratios[0], ratios[1]], axis=-1)
    return np.where(np.isfinite(x), x, 1.0)


def _between_roots(level: Array) -> Array:
    """Return an x in every interval between the positive roots, 0 and ∞: (B, 3n - 1) in all."""
    x = poly.roots(level).real
    x = np.sort(np.where((x > 0.0) & np.isfinite(x), x, 0.0), axis=-1)
    return np.concatenate([np.sqrt(x[:, 1:] * x[:, :-1]), 0.5 * x, 2.0 * x], axis=-1)


def _improve(best: Array, place: Array, x: Array, pair: Array) -> None:
    """Raise ``best`` (B,) and its ``place`` (B,) to the largest ratio at ``x`` (B, k), in place."""
    N, D = poly.at(pair, x)
    # D is never negative. If it comes out negative, a pole is as close to the axis as rounding can resolve.
    value = N / np.abs(D)
    value[~(value > 0.0)] = 0.0
    rows = np.arange(len(x))
    chosen = value.argmax(axis=-1)
    found, where = value[rows, chosen], x[rows, chosen]
    higher = found > best
    best[higher], place[higher] = found[higher], where[higher]


def _climb(best: Array, place: Array, pair: Array) -> None:
    """Apply Newton's method to d log(N/D) / d log x = 0 from ``place``, and keep what it gains, in place."""
    inside = (place > 0.0) & np.isfinite(place)
    u = np.log(np.where(inside, place, 1.0))
    k = np.arange(pair.shape[-1] - 1.0, -1.0, -1.0)
    moments = np.stack([np.ones_like(k), k, k * k], axis=-1)
    for _ in range(3):
        sums = (pair * np.exp(u[:, None] * k)) @ moments
        first = sums[..., 1] / sums[..., 0]
        second = sums[..., 2] / sums[..., 0] - first * first
        slope, curvature = first[0] - first[1], second[0] - second[1]
        step = np.where(curvature < 0.0, -slope / curvature, np.sign(slope))
        u = u + np.clip(step, -1.0, 1.0)
    x = np.exp(u)
    _improve(best, place, np.where(inside & np.isfinite(x), x, 0.0)[:, None], pair)
