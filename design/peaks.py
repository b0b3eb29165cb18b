"""The largest value over all frequencies of a ratio of powers, exactly: every H-infinity norm here is one.

A ratio N(x)/D(x) in x = ω², each a product of sums of |p(jω)|². The level polynomial N - γ²D has no positive
root exactly where γ² is above the peak; between its positive roots the ratio is higher. So: a lower bound
from where the asymptotes bend, Newton's method on it, then level polynomials until none finds a higher
value (Boyd, Balakrishnan, Kabamba 1989; Bruinsma and Steinbuch 1990, on polynomials of half the size of
their Hamiltonian matrices). Values are taken from even and odd parts of the factors, so that a lightly
damped mode costs no digits. Never a frequency grid alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from design import polynomials as poly
from design.polynomials import Array

_RELATIVE_STEP = 1e-12
_MOST_ROUNDS = 30


class Power:
    """Sum of |p(jω)|² over polynomials p (..., n + 1)."""

    def __init__(self, *parts: Array) -> None:
        self._parts = tuple(part if part.ndim > 1 else part[None, :] for part in parts)

    @cached_property
    def coefficients(self) -> Array:
        """Of the sum, as polynomials in x = ω²."""
        return poly.add(*(poly.power(part) for part in self._parts))

    @cached_property
    def _even_odd(self) -> list[tuple[Array, Array]]:
        return [poly.even_odd(part) for part in self._parts]

    def at(self, x: Array) -> Array:
        """Values (B, k) at x = ω² (B, k), in (rad/s)²."""
        total = np.zeros_like(x)
        for even, odd in self._even_odd:
            e, o = poly.at(even, x), poly.at(odd, x)
            total += e * e + x * (o * o)
        return total

    def of(self, chosen: Array) -> Power:
        """The same for some candidates only; ``chosen`` indexes or masks the leading axis."""
        return Power(*(part if len(part) == 1 else part[chosen] for part in self._parts))


class PowerOf(Power):
    """A power given by its coefficients (B, n + 1) in x alone."""

    def __init__(self, coefficients: Array) -> None:
        super().__init__()
        self.coefficients = coefficients

    def at(self, x: Array) -> Array:
        """See Power."""
        return np.asarray(poly.at(self.coefficients, x))

    def of(self, chosen: Array) -> Power:
        """See Power."""
        return self if len(self.coefficients) == 1 else PowerOf(self.coefficients[chosen])


def peak(above: Sequence[Power], below: Sequence[Power]) -> tuple[Array, Array]:
    """Supremum (B,) over 0 <= ω <= ∞ of Π above / Π below, and the ω (B,) in rad/s where it is taken.

    ∞ where a pole lies on the axis. The place may be 0 or ∞.
    """
    N = poly.multiply(*(factor.coefficients for factor in above))
    D = poly.multiply(*(factor.coefficients for factor in below))
    batch = max(len(N), len(D))
    width = max(N.shape[-1], D.shape[-1])
    N, D = (_of_shape(p, batch, width) for p in (N, D))
    with np.errstate(all="ignore"):
        best, place = _ends(N, D)
        _improve(best, place, _bends(N, D), above, below)
        _polish(best, place, N, D, above, below)
        active = np.flatnonzero(np.isfinite(best))
        for _ in range(_MOST_ROUNDS):
            if not len(active):
                break
            n, d = N[active], D[active]
            some_above = [factor.of(active) for factor in above]
            some_below = [factor.of(active) for factor in below]
            b, p = best[active], place[active]
            before = b.copy()
            _improve(b, p, _between_roots(n - before[:, None] * d), some_above, some_below)
            higher = b > before * (1.0 + _RELATIVE_STEP)
            if higher.any():
                _polish(b, p, n, d, some_above, some_below)
            best[active], place[active] = b, p
            active = active[higher & np.isfinite(b)]
    return best, np.sqrt(place)


def _of_shape(p: Array, batch: int, width: int) -> Array:
    p = np.concatenate([np.zeros((len(p), width - p.shape[-1])), p], axis=-1)
    return np.broadcast_to(p, (batch, width))


def _ends(N: Array, D: Array) -> tuple[Array, Array]:
    """The larger of the values at x = 0 and x = ∞, and which."""
    at_zero = _first_nonzero_ratio(N[:, ::-1], D[:, ::-1])
    at_infinity = _first_nonzero_ratio(N, D)
    return np.maximum(at_zero, at_infinity), np.where(at_zero >= at_infinity, 0.0, np.inf)


def _first_nonzero_ratio(N: Array, D: Array) -> Array:
    leading = np.argmax((N != 0.0) | (D != 0.0), axis=-1)[:, None]
    n, d = (np.take_along_axis(p, leading, axis=-1)[:, 0] for p in (N, D))
    return np.where(d > 0.0, n / np.where(d > 0.0, d, 1.0), np.where(n > 0.0, np.inf, 0.0))


def _bends(N: Array, D: Array) -> Array:
    """Places (B, 2n) where the asymptotes of N and D bend: ratios of neighbouring coefficients."""
    ratios = np.concatenate([np.abs(p[:, 1:] / p[:, :-1]) for p in (N, D)], axis=-1)
    return np.where(np.isfinite(ratios), ratios, 1.0)


def _between_roots(level: Array) -> Array:
    """The positive real parts of the roots, and points between neighbours, as places to try."""
    x = poly.roots(level).real
    x = np.sort(np.where(x > 0.0, x, 0.0), axis=-1)
    return np.concatenate([x, np.sqrt(x[:, 1:] * x[:, :-1])], axis=-1)


def _improve(best: Array, place: Array, x: Array, above: Sequence[Power], below: Sequence[Power]) -> None:
    """Raise ``best`` to the largest value at ``x`` (B, k), in place."""
    value = _value(x, above, below)
    value = np.where(np.isnan(value), 0.0, value)
    chosen = value.argmax(axis=-1)[:, None]
    found = np.take_along_axis(value, chosen, axis=-1)[:, 0]
    where = np.take_along_axis(x, chosen, axis=-1)[:, 0]
    higher = found > best
    best[higher], place[higher] = found[higher], where[higher]


def _value(x: Array, above: Sequence[Power], below: Sequence[Power]) -> Array:
    value = np.ones_like(x)
    for factor in above:
        value = value * factor.at(x)
    for factor in below:
        value = value / factor.at(x)
    return value


def _polish(
    best: Array, place: Array, N: Array, D: Array, above: Sequence[Power], below: Sequence[Power]
) -> None:
    """Newton's method for d log(N/D) / d log x = 0 from ``place``, kept where it climbs, in place."""
    inside = (place > 0.0) & np.isfinite(place)
    x = np.where(inside, place, 1.0)[:, None]
    ladders = [(p, poly.derivative(p), poly.derivative(poly.derivative(p))) for p in (N, D)]
    for _ in range(3):
        slope, curvature = 0.0, 0.0
        for sign, (p, dp, ddp) in zip((1.0, -1.0), ladders, strict=True):
            v = poly.at(p, x)
            first = x * poly.at(dp, x) / v
            slope = slope + sign * first
            curvature = curvature + sign * (first + x * x * poly.at(ddp, x) / v - first * first)
        step = np.where(curvature < 0.0, -slope / curvature, 0.25 * np.sign(slope))
        x = x * np.exp(np.clip(step, -0.5, 0.5))
        _improve(best, place, np.where(inside[:, None], x, 0.0), above, below)
