"""Stability margins of closed loops: the margin ε of the paper, exactly, and the classical margins.

ε(G, K) = 1/‖T_zw‖∞ of eq. (13) is the largest normalised coprime perturbation that the loop surely survives.
For one input and one output, with Gs = G W1 and K∞ = K/W1,

    1/ε² = max over ω of (1 + |K∞|²)(1 + |Gs|²) / |1 + G K|².

ε is 0 where the loop is unstable. Feedback is negative. All functions work on batches of B controllers, with
polynomials in s or, for a sampled loop, in the bilinear plane (see :mod:`design.models.plant`). Frequencies
are then those of that plane. For a controller with two degrees of freedom only the feedback part counts.
"""

from __future__ import annotations

import numpy as np

from design.mathematics import polynomials as poly
from design.mathematics.peaks import SquaredMagnitude, SquaredMagnitudeInX, peak
from design.mathematics.polynomials import Array, Flags
from design.models.transfer_function import TransferFunction

UNIT = TransferFunction(np.ones((1, 1)), np.ones((1, 1)))
"""The weight W1 = 1."""


def characteristic(G: TransferFunction, K: TransferFunction) -> Array:
    """Return the characteristic polynomials dG dK + nG nK of the closed loops.

    Poles that a zero cancels stay in them, so that a cancelled unstable pole shows.
    """
    return poly.add(poly.multiply(K.den, G.den), poly.multiply(K.num, G.num))


def stability_margin(
    G: TransferFunction, K: TransferFunction, W: TransferFunction = UNIT, cutoff: Array | None = None
) -> Array:
    """Return ε (B,) of controllers K (B, n + 1) on the plant G with the weight W1 = W; 0 where unstable.

    W must be stable and minimum phase. The relative error is 1e-10 or less, whatever the damping. Where ε is
    below ``cutoff`` (B,), any value below the cutoff may be returned, which is faster.
    """
    return margin_and_frequency(G, K, W, cutoff)[0]


def margin_and_frequency(
    G: TransferFunction, K: TransferFunction, W: TransferFunction = UNIT, cutoff: Array | None = None
) -> tuple[Array, Array]:
    """Return ε (B,) as :func:`stability_margin` does, and the ω (B,) in rad/s at which the norm is taken.

    The frequency is NaN where the loop is unstable.
    """
    G, K, W = (TransferFunction(np.atleast_2d(H.num), np.atleast_2d(H.den)) for H in (G, K, W))
    closed = characteristic(G, K)
    margin, omega = np.zeros(len(closed)), np.full(len(closed), np.nan)
    stable = np.flatnonzero(poly.hurwitz(closed))
    if len(stable):
        Wn, Wd, Gn, Gd, num, den, closed = (p if len(p) == 1 else p[stable] for p in (*W, *G, *K, closed))
        gamma_squared, omega[stable] = peak(
            above=[
                SquaredMagnitude(poly.multiply(den, Wn), poly.multiply(num, Wd)),
                SquaredMagnitude(poly.multiply(Gd, Wd), poly.multiply(Gn, Wn)),
            ],
            below=[SquaredMagnitude(poly.multiply(Wn, Wd)), SquaredMagnitude(closed)],
            cutoff=None if cutoff is None else 1.0 / np.maximum(cutoff[stable], 1e-9) ** 2,
        )
        margin[stable] = np.where(gamma_squared > 0.0, 1.0 / np.sqrt(gamma_squared), 0.0)
    return margin, omega


def crossover(L: TransferFunction) -> Array:
    """Return the lowest ω (B,) at which |L| falls through 1.

    It is 0 where |L| is below 1 at ω = 0, and ∞ where |L| never falls through 1.
    """
    return _falls_through_one(np.atleast_2d(L.num), np.atleast_2d(L.den))


def bandwidth(G: TransferFunction, K: TransferFunction, num_r: Array | None = None) -> Array:
    """Return the lowest ω (B,) at which the gain from setpoint to output falls through 1/√2 (-3 dB).

    ``num_r`` is the controller's numerator for the setpoint, if it differs from that of K. The bandwidth is 0
    where the gain is below 1/√2 at ω = 0, and ∞ where it never falls through 1/√2.
    """
    closed = np.atleast_2d(characteristic(G, K))
    forward = poly.multiply(np.atleast_2d(G.num), np.atleast_2d(K.num if num_r is None else num_r))
    return _falls_through_one(np.sqrt(2.0) * forward, closed)


def lowest_gain(L: TransferFunction, omega: float) -> Array:
    """Return the smallest |L| (B,) over the frequencies from 0 to ``omega`` in rad/s."""
    # x = ω_l² t/(1 + t) maps t in [0, ∞] onto the band and leaves squared magnitudes rational in t.
    num, den = (poly.squared_magnitude(np.atleast_2d(p)) for p in (L.num, L.den))
    n = max(num.shape[-1], den.shape[-1])
    n_t, d_t = (
        poly.substitute_fraction(
            np.concatenate([np.zeros((len(p), n - p.shape[-1])), p], axis=-1), (omega**2, 0.0), (1.0, 1.0)
        )
        for p in (num, den)
    )
    largest, _ = peak([SquaredMagnitudeInX(d_t)], [SquaredMagnitudeInX(n_t)])
    with np.errstate(divide="ignore"):
        return 1.0 / np.sqrt(largest)


def disturbance_peak(G: TransferFunction, K: TransferFunction) -> Array:
    """Return the largest gain (B,) from input disturbance to output, ‖G/(1 + GK)‖∞; ∞ where unstable."""
    closed = np.atleast_2d(characteristic(G, K))
    largest, _ = peak(
        [SquaredMagnitude(poly.multiply(np.atleast_2d(G.num), np.atleast_2d(K.den)))],
        [SquaredMagnitude(closed)],
    )
    return np.where(poly.hurwitz(closed), np.sqrt(largest), np.inf)


def phase_margin(L: TransferFunction) -> Array:
    """Return the smallest angle (B,) in rad between -1 and L where |L| = 1; π where |L| is never 1."""
    num, den = np.atleast_2d(L.num), np.atleast_2d(L.den)
    x, crossing = _positive_roots(poly.add(poly.squared_magnitude(num), -poly.squared_magnitude(den)))
    jw = 1j * np.sqrt(x)
    angle = np.abs(np.angle(-poly.at(num, jw) / poly.at(den, jw)))
    return np.asarray(np.where(crossing, angle, np.pi).min(axis=-1, initial=np.pi))


def gain_margins(L: TransferFunction) -> tuple[Array, Array]:
    """Return the largest factor below 1 and the smallest factor above 1 (B,) that bring L to -1.

    They are 0 and ∞ where no such factor exists.
    """
    num, den = np.atleast_2d(L.num), np.atleast_2d(L.den)
    # L is real where the odd part of n d~ is 0, and at both ends of the axis.
    even_x, odd_x = poly.even_odd(poly.multiply(num, poly.mirror(den)))
    x, crossing = _positive_roots(odd_x)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.where(crossing, poly.at(even_x, x) / SquaredMagnitude(den).at(np.sqrt(x)), 0.0)
        at_zero = num[:, -1:] / den[:, -1:]
        at_infinity = num[:, :1] / den[:, :1] if num.shape[-1] == den.shape[-1] else np.zeros((len(x), 1))
        size = (len(value), 1)
        ends = [np.broadcast_to(end, size) for end in (at_zero, at_infinity)]
        value = np.concatenate([value, *ends], axis=-1)
        factor = np.where(value < 0.0, -1.0 / value, np.nan)
        below = np.where(factor < 1.0, factor, 0.0).max(axis=-1)
        above = np.where(factor > 1.0, factor, np.inf).min(axis=-1)
    return below, above


def _falls_through_one(num: Array, den: Array) -> Array:
    """Return the lowest ω (B,) at which |num/den| falls through 1; 0 if below at first, ∞ if never."""
    excess = poly.add(poly.squared_magnitude(num), -poly.squared_magnitude(den))
    x, crossing = _positive_roots(excess)
    slope = poly.at(poly.derivative(excess), x)
    lowest = np.where(crossing & (slope < 0.0), x, np.inf).min(axis=-1, initial=np.inf)
    starts_below = _sign_at_zero(excess) <= 0.0
    return np.where(starts_below, 0.0, np.sqrt(lowest))


def _sign_at_zero(p: Array) -> Array:
    """Return the lowest nonzero coefficient (B,): its sign is that of p(x) for small x > 0."""
    rising = p[:, ::-1]
    first = np.argmax(rising != 0.0, axis=-1)[:, None]
    return np.take_along_axis(rising, first, axis=-1)[:, 0]


def _positive_roots(p: Array) -> tuple[Array, Flags]:
    """Return the roots (B, n) in x = ω² of polynomials (B, n + 1), and which of them are real and positive.

    The others are replaced by 1.
    """
    roots = poly.roots(p)
    real = np.isfinite(roots) & (np.abs(roots.imag) <= 1e-7 * np.abs(roots)) & (roots.real > 0.0)
    return np.where(real, roots.real, 1.0), real
