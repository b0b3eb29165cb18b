"""Identified models: sampled, with a model of the noise, and continuous, with a dead time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from design.identification.models.difference_basis import basis
from design.mathematics.polynomials import Array, ComplexArray


def _one() -> Array:
    return np.ones(1)


@dataclass(frozen=True, eq=False)
class DiscreteModel:
    """y(k) = q^-nk B/F u(k) + C/D e(k); polynomials in rising powers of z^-1, u held for a sample time.

    ``f``, ``c`` and ``d`` begin with 1.
    """

    b: Array
    f: Array
    nk: int
    sample_time_s: float
    c: Array = field(default_factory=_one)
    d: Array = field(default_factory=_one)

    @property
    def order(self) -> int:
        """Number of poles that are not the delay's."""
        return len(self.f) - 1

    @property
    def in_z(self) -> tuple[Array, Array]:
        """Numerator and denominator of the plant's part in falling powers of z, the delay included."""
        surplus = self.nk + len(self.b) - len(self.f)
        num = np.concatenate([self.b, np.zeros(max(-surplus, 0))])
        return num, np.concatenate([self.f, np.zeros(max(surplus, 0))])

    @property
    def poles_z(self) -> ComplexArray:
        """Poles (n,) in the z plane, without those of the delay at 0."""
        return rooted(self.f)

    @property
    def zeros_z(self) -> ComplexArray:
        """Zeros in the z plane."""
        return rooted(self.b)

    @property
    def stable(self) -> bool:
        """True if all poles lie inside the unit circle."""
        return bool((np.abs(self.poles_z) < 1.0).all())

    @property
    def gain(self) -> float:
        """Static gain. Infinite for an integrator."""
        with np.errstate(divide="ignore"):
            return float(np.divide(self.b.sum(), self.f.sum()))

    def at(self, omega_rad_s: ArrayLike) -> ComplexArray:
        """Return the frequency response (k,) from held input to sampled output, at frequencies in rad/s."""
        delta = -np.expm1(-1j * np.asarray(omega_rad_s, dtype=float) * self.sample_time_s)
        pair = [np.polynomial.polynomial.polyval(delta, basis(len(p)) @ p) for p in (self.b, self.f)]
        return np.asarray((1.0 - delta) ** self.nk * pair[0] / pair[1])

    def noise_at(self, omega_rad_s: ArrayLike) -> ComplexArray:
        """Return the frequency response (k,) of the noise model C/D."""
        inverse = np.exp(-1j * np.asarray(omega_rad_s, dtype=float) * self.sample_time_s)
        pair = [np.polynomial.polynomial.polyval(inverse, p) for p in (self.c, self.d)]
        return np.asarray(pair[0] / pair[1])

    def simulate(self, u: ArrayLike) -> Array:
        """Return the output (N,) without noise for the input (N,), from rest at 0."""
        from scipy.signal import lfilter

        column = np.asarray(u, dtype=float)
        return np.asarray(lfilter(np.concatenate([np.zeros(self.nk), self.b]), self.f, column))


@dataclass(frozen=True, eq=False)
class ContinuousModel:
    """G(s) = exp(-τ s) num/den; polynomials in falling powers of s, den monic."""

    num: Array
    den: Array
    dead_time_s: float = 0.0

    @property
    def poles(self) -> ComplexArray:
        """Poles (n,) in rad/s."""
        return np.asarray(np.roots(self.den), dtype=np.complex128)

    @property
    def zeros(self) -> ComplexArray:
        """Zeros in rad/s."""
        return np.asarray(np.roots(self.num), dtype=np.complex128)

    @property
    def gain(self) -> float:
        """Static gain. Infinite for an integrator."""
        with np.errstate(divide="ignore"):
            return float(np.divide(self.num[-1], self.den[-1]))

    def at(self, omega_rad_s: ArrayLike) -> ComplexArray:
        """Return the frequency response (k,) at frequencies in rad/s."""
        s = 1j * np.asarray(omega_rad_s, dtype=float)
        return np.asarray(np.polyval(self.num, s) / np.polyval(self.den, s) * np.exp(-self.dead_time_s * s))


def rooted(p: Array) -> ComplexArray:
    """Return the roots in z of a polynomial in rising powers of z^-1, accurate near z = 1."""
    differences = _roots_of_differences(p)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = 1.0 / (1.0 - differences)
    return z[np.isfinite(z)]


def logarithms(p: Array, sample_time_s: float) -> ComplexArray:
    """Return the continuous poles log(z)/T in rad/s of a polynomial in rising powers of z^-1.

    They are accurate near z = 1.
    """
    differences = _roots_of_differences(p)
    differences = differences[np.abs(differences - 1.0) > 1e-14]
    return np.asarray(-np.log1p(-differences) / sample_time_s)


def _roots_of_differences(p: Array) -> ComplexArray:
    """Return the roots of p in 1 - z^-1."""
    return np.asarray(np.roots((basis(len(p)) @ p)[::-1]), dtype=np.complex128)


def as_polynomial(sections: Sequence[Array]) -> Array:
    """Return the product of sections in falling powers."""
    product = np.ones(1)
    for section in sections:
        product = np.convolve(product, section)
    return product
