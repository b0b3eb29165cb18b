"""The largest value over all frequencies of a ratio of powers, exactly: every H-infinity norm here is one.

A ratio N(x)/D(x) in x = ω², each a product of sums of |p(jω)|². The level polynomial N - γ²D has no positive
root exactly where γ² is above the peak; between its positive roots the ratio is higher. So: a lower bound
from where the asymptotes bend, Newton's method on it, then level polynomials until none finds a higher
value (Boyd, Balakrishnan, Kabamba 1989; Bruinsma and Steinbuch 1990, on polynomials of half the size of
their Hamiltonian matrices). The value at the peak is taken from even and odd parts of the factors, so that
a lightly damped mode costs no digits. Never a frequency grid alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array

_HIGHER = 1.0 + 1e-11
_MOST_ROUNDS = 30
_BLURRED = 1e-9


class Power:
    """Sum of |p(jω)|² over polynomials p (..., n + 1)."""

    def __init__(self, *parts: Array) -> None:
        self._parts = tuple(part if part.ndim > 1 else part[None, :] for part in parts)

    @cached_property
    def coefficients(self) -> Array:
        """Of the sum, as polynomials in x = ω²."""
        return poly.add(*(poly.power(part) for part in self._parts))

    def at(self, omega: Array) -> Array:
        """Values (B, k) at ω (B, k) in rad/s."""
        total = poly.power_at(self._parts[0], omega)
        for part in self._parts[1:]:
            total = total + poly.power_at(part, omega)
        return total


class PowerOf(Power):
    """A power given by its coefficients (B, n + 1) in x alone."""

    def __init__(self, coefficients: Array) -> None:
        super().__init__()
        self.coefficients = coefficients

    def at(self, omega: Array) -> Array:
        """See Power."""
        return np.asarray(poly.at(self.coefficients, omega * omega))


def peak(above: Sequence[Power], below: Sequence[Power], enough: Array | None = None) -> tuple[Array, Array]:
    """Supremum (B,) over 0 <= ω <= ∞ of Π above / Π below, and the ω (B,) in rad/s where it is taken.

    ∞ where a pole lies on the axis. The place may be 0 or ∞. Where the peak is over ``enough`` (B,), some
    value over it is returned.
    """
    N = poly.multiply(*(factor.coefficients for factor in above))
    D = poly.multiply(*(factor.coefficients for factor in below))
    pair = np.zeros((2, max(len(N), len(D)), max(N.shape[-1], D.shape[-1], 2)))
    pair[0, :, pair.shape[-1] - N.shape[-1] :] = N
    pair[1, :, pair.shape[-1] - D.shape[-1] :] = D
    with np.errstate(all="ignore"):
        best, place = _ends(pair)
        ends = best.copy()
        _improve(best, place, _bends(pair), pair)
        _climb(best, place, pair)
        enough = np.full(len(best), np.inf) if enough is None else enough
        active = np.flatnonzero(best < enough)
        for _ in range(_MOST_ROUNDS):
            if not len(active):
                break
            some, b, p = pair[:, active], best[active], place[active]
            before = b.copy()
            _improve(b, p, _between_roots(some[0] - b[:, None] * some[1]), some)
            higher = b > before * _HIGHER
            if higher.any():
                _climb(b, p, some)
                best[active], place[active] = b, p
            active = active[higher & (b < enough[active])]
        inside = np.isfinite(place) & (place > 0.0)
        omega = np.sqrt(place)
        inner = np.where(inside, omega, 1.0)[:, None]
        value = _exact(inner, above, below)
        blurred = inside & (np.abs(value[:, 0] / best - 1.0) > _BLURRED)
        if blurred.any():
            value, inner = _zoom(inner, above, below)
            omega = np.where(inside, inner[:, 0], omega)
        best = np.where(inside, np.maximum(value[:, 0], ends), best)
    return best, omega


def _exact(omega: Array, above: Sequence[Power], below: Sequence[Power]) -> Array:
    """The ratio at ω (B, k) from even and odd parts."""
    value = np.ones_like(omega)
    for factor in above:
        value = value * factor.at(omega)
    for factor in below:
        value = value / factor.at(omega)
    return value


def _zoom(omega: Array, above: Sequence[Power], below: Sequence[Power]) -> tuple[Array, Array]:
    """The highest exact value (B, 1) around ω (B, 1), and where.

    For a mode so lightly damped that N and D as coefficients blur its peak.
    """
    rows = np.arange(len(omega))
    width = 1e-3
    while width > 1e-17:
        around = omega * (1.0 + width * np.linspace(-1.0, 1.0, 9))
        value = _exact(around, above, below)
        omega = around[rows, value.argmax(axis=-1)][:, None]
        width /= 3.0
    return _exact(omega, above, below), omega


def _ends(pair: Array) -> tuple[Array, Array]:
    """The larger (B,) of the values at x = 0 and x = ∞, and which."""
    at_zero, at_infinity = _first_nonzero_ratio(pair[..., ::-1]), _first_nonzero_ratio(pair)
    return np.maximum(at_zero, at_infinity), np.where(at_zero >= at_infinity, 0.0, np.inf)


def _first_nonzero_ratio(pair: Array) -> Array:
    leading = np.argmax((pair != 0.0).any(axis=0), axis=-1)
    n, d = pair[:, np.arange(pair.shape[1]), leading]
    return np.where(d > 0.0, n / d, np.where(n > 0.0, np.inf, 0.0))


def _bends(pair: Array) -> Array:
    """Places (B, 2n) where the asymptotes of N and D bend: ratios of neighbouring coefficients."""
    ratios = np.abs(pair[..., 1:] / pair[..., :-1])
    x = np.concatenate([ratios[0], ratios[1]], axis=-1)
    return np.where(np.isfinite(x), x, 1.0)


def _between_roots(level: Array) -> Array:
    """Places (B, 3n - 1) inside every interval between the positive roots, 0 and ∞."""
    x = poly.roots(level).real
    x = np.sort(np.where((x > 0.0) & np.isfinite(x), x, 0.0), axis=-1)
    return np.concatenate([np.sqrt(x[:, 1:] * x[:, :-1]), 0.5 * x, 2.0 * x], axis=-1)


def _improve(best: Array, place: Array, x: Array, pair: Array) -> None:
    """Raise ``best`` to the largest value at ``x`` (B, k), in place."""
    N, D = poly.at(pair, x)
    # D is a power: where it comes out negative, a pole is as close to the axis as rounding can tell.
    value = N / np.abs(D)
    value[~(value > 0.0)] = 0.0
    rows = np.arange(len(x))
    chosen = value.argmax(axis=-1)
    found, where = value[rows, chosen], x[rows, chosen]
    higher = found > best
    best[higher], place[higher] = found[higher], where[higher]


def _climb(best: Array, place: Array, pair: Array) -> None:
    """Newton's method for d log(N/D) / d log x = 0 from ``place``, kept where it climbs, in place."""
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
