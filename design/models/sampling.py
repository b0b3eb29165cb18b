"""A continuous plant as a sampled loop sees it, exactly, as polynomials of the bilinear plane.

A sampled loop sees the plant behind a zero-order hold and a delay. In the bilinear plane

    s = 2/T (z - 1)/(z + 1)

this is a ratio of polynomials as well. In that plane, a controller that is sampled by Tustin's rule has its
continuous coefficients again, the unit circle is the imaginary axis, and every norm is exactly that of the
sampled loop. So all mathematics of this package is written once, for s.

The delay need not be a whole number of periods (modified z-transform; Åström and Wittenmark,
Computer-Controlled Systems, 3rd ed., sec. 2.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from design.errors import DesignError
from design.mathematics import polynomials as poly
from design.mathematics.matrix_exponential import exponential
from design.mathematics.polynomials import Array
from design.models.realisation import numerator
from design.models.transfer_function import TransferFunction

MAX_DELAY_SAMPLES = 20
"""Largest delay in periods.

Every period adds a pole at the same place. Margins are exact to 25 periods, and optimal margins to 20; at 30
they are wrong.
"""
_WHOLE = 1e-9
"""Distance from a whole number of periods, in periods, below which a delay is a whole number of periods."""


@dataclass(frozen=True)
class Sampling:
    """How a loop samples: its period, and the whole periods from a measurement to its effect on the valve."""

    period_s: float
    delay_samples: int = 1

    def warp(self, omega: Array | float) -> Array:
        """Return the frequency of the bilinear plane for a true frequency in rad/s."""
        return 2.0 / self.period_s * np.tan(0.5 * self.period_s * np.asarray(omega, dtype=float))

    def unwarp(self, omega: Array | float) -> Array:
        """Return the true frequency in rad/s for a frequency of the bilinear plane."""
        return 2.0 / self.period_s * np.arctan(0.5 * self.period_s * np.asarray(omega, dtype=float))


def zero_order_hold(G: TransferFunction, period_s: float, delay_s: float = 0.0) -> TransferFunction:
    """Return G behind a zero-order hold and a delay, as the loop of this period sees it.

    The result is exact, for any delay from 0 on, and is not worse conditioned for short periods. G must be
    proper. Raises DesignError for an undamped mode at half the sampling frequency, which the loop cannot see,
    and for a delay of more than :data:`MAX_DELAY_SAMPLES` periods.
    """
    whole = round(delay_s / period_s)
    if abs(delay_s / period_s - whole) > _WHOLE:
        whole = int(np.floor(delay_s / period_s))
        fraction_s = delay_s - whole * period_s
    else:
        fraction_s = 0.0
    if whole + bool(fraction_s) > MAX_DELAY_SAMPLES:
        raise DesignError(
            f"the loop's delay, {delay_s:.4g} s, is {delay_s / period_s:.3g} periods of {period_s:g} s; the "
            f"largest delay is {MAX_DELAY_SAMPLES} periods: lengthen the period"
        )
    if fraction_s:
        return delayed(_held_with_fraction(G, period_s, fraction_s), period_s, whole + 1)
    return delayed(_held(G, period_s), period_s, whole)


def delayed(G: TransferFunction, period_s: float, samples: int) -> TransferFunction:
    """Return G, in the bilinear plane, with a delay of whole samples: z^-1 = (1 - sT/2)/(1 + sT/2)."""
    num, den = G
    half = 0.5 * period_s
    for _ in range(samples):
        num = poly.multiply(num, np.array([-half, 1.0]))
        den = poly.multiply(den, np.array([half, 1.0]))
    return TransferFunction(num, den)


def to_z(H: TransferFunction, period_s: float) -> TransferFunction:
    """Return a transfer function of the bilinear plane in falling powers of z; den is monic."""
    n = max(H.num.shape[-1], H.den.shape[-1])
    pair = [
        poly.substitute_fraction(
            np.concatenate([np.zeros((*p.shape[:-1], n - p.shape[-1])), p], axis=-1),
            (2.0 / period_s, -2.0 / period_s),
            (1.0, 1.0),
        )
        for p in H
    ]
    lead = pair[1][..., :1]
    return TransferFunction(pair[0] / lead, pair[1] / lead)


class _Scaled(NamedTuple):
    """A plant in companion form, in time scaled by its fastest pole, and what the hold needs of it.

    With Φ = exp(A T) and φ(t) = ∫ exp(A s) ds from 0 to t, the matrix of the bilinear plane is
    A_w = 2/T (Φ - I)(Φ + I)^-1, where Φ = I + A φ(T).
    """

    A: Array
    B: Array
    C: Array
    direct: float
    scale: float
    """Unit of the scaled frequency in rad/s."""
    step: float
    """The period in scaled time."""
    phi: Array
    """φ(T)."""
    inverse: Array
    """(Φ + I)^-1."""
    A_w: Array
    den_w: Array
    """Characteristic polynomial of A_w."""


def _held(G: TransferFunction, period_s: float) -> TransferFunction:
    """Return G behind a zero-order hold without delay."""
    if len(G.den) == 1:
        return TransferFunction(G.num / G.den[0], G.den / G.den[0])
    plant = _scaled(G, period_s)
    B_w, C_w = plant.phi @ plant.B, 2.0 / plant.step * plant.C @ plant.inverse
    num_w = numerator(plant.A_w, B_w, C_w, plant.den_w)
    # The factor 1 - sT/2 is the zero at z = ∞ that a strictly proper system has.
    num_w = poly.add(poly.multiply(num_w, np.array([-0.5 * plant.step, 1.0])), plant.direct * plant.den_w)
    return _in_true_time(num_w, plant)


def _held_with_fraction(G: TransferFunction, period_s: float, fraction_s: float) -> TransferFunction:
    """Return z times G behind a zero-order hold and a delay of a fraction of the period (over 0, under 1).

    At a sample, the input of the plant has been u[k - 1] during the fraction, and is u[k] for the rest of the
    period: x[k + 1] = Φ x[k] + Γ1 u[k - 1] + Γ0 u[k]. So the transfer function is z^-1 times

        C (zI - Φ)^-1 (z Γ0 + Γ1) + D,   Γ0 = φ(T - fraction) B,   Γ0 + Γ1 = φ(T) B.
    """
    if len(G.den) == 1:
        return TransferFunction(G.num / G.den[0], G.den / G.den[0])
    plant = _scaled(G, period_s)
    gamma = plant.phi @ plant.B
    gamma_0 = _integral(plant.A, plant.step - fraction_s * plant.scale) @ plant.B
    C_w = 2.0 / plant.step * plant.C @ plant.inverse
    total = numerator(plant.A_w, gamma, C_w, plant.den_w)
    difference = numerator(plant.A_w, 2.0 * gamma_0 - gamma, C_w, plant.den_w)
    num_w = poly.add(total, poly.multiply(difference, np.array([0.5 * plant.step, 0.0])))
    return _in_true_time(poly.add(num_w, plant.direct * plant.den_w), plant)


def _scaled(G: TransferFunction, period_s: float) -> _Scaled:
    n = len(G.den) - 1
    num, den = G.num / G.den[0], G.den / G.den[0]
    direct = float(num[0]) if len(num) == n + 1 else 0.0
    poles = poly.roots(den)
    scale = max(float(np.abs(poles).max()), 1e-3 / period_s)
    scaled_den = den / scale ** np.arange(n + 1)
    scaled_num = poly.add(np.zeros(n + 1), num)[1:] / scale ** np.arange(1, n + 1) - direct * scaled_den[1:]
    A = np.eye(n, k=-1)
    A[0] = -scaled_den[1:]
    step = period_s * scale
    phi = _integral(A, step)
    plus = 2.0 * np.eye(n) + A @ phi
    if np.linalg.norm(plus, -2) < 1e-12:
        raise DesignError(
            f"the plant has an undamped mode at half the sampling frequency, {np.pi / period_s:.4g} rad/s: a "
            f"loop with a period of {period_s:g} s cannot see it; change the period"
        )
    inverse = np.asarray(np.linalg.inv(plus), dtype=np.float64)
    den_w = poly.from_roots(np.tanh(0.5 * step * poles / scale) * (2.0 / step + 0j)).real
    return _Scaled(
        A=A,
        B=np.eye(n, 1),
        C=scaled_num.reshape(1, n),
        direct=direct,
        scale=scale,
        step=step,
        phi=phi,
        inverse=inverse,
        A_w=2.0 / step * A @ phi @ inverse,
        den_w=den_w,
    )


def _integral(A: Array, time: float) -> Array:
    """Return φ(time), the integral of exp(A s) from 0 to ``time``."""
    n = len(A)
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:] = A, np.eye(n)
    return exponential(block[None] * time)[0, :n, n:]


def _in_true_time(num_w: Array, plant: _Scaled) -> TransferFunction:
    back = plant.scale ** np.arange(len(plant.den_w))
    return TransferFunction(num_w * back, plant.den_w * back)
