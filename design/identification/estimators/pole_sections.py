"""Stable denominators F(z^-1) by the continuous poles that they are sampled from.

A real pole -p and pole pairs s² + 2ζω s + ω², in logarithms: every point is stable, a pair passes from
oscillatory to real poles without a seam, and parameters of very different size are alike. A search in these
coordinates converges on data where one in the coefficients of F diverges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from design.mathematics.polynomials import Array, ComplexArray

FASTEST = 20.0
"""Largest real pole, times the sample time. Such a pole has decayed to 2e-9 after one sample."""
DAMPING = (1e-4, 200.0)
"""Search range of a pair's damping ratio ζ."""


@dataclass(frozen=True)
class PoleSections:
    """Real poles and pole pairs at one sample time. θ is (log p, …, log ω, log ζ, …)."""

    real: int
    pairs: int
    sample_time_s: float

    @classmethod
    def of_order(cls, order: int, sample_time_s: float) -> PoleSections:
        """Return the sections with as many pairs as the order holds, and a real pole if it is odd."""
        return cls(order % 2, order // 2, sample_time_s)

    @property
    def order(self) -> int:
        """Degree of F."""
        return self.real + 2 * self.pairs

    @property
    def spans(self) -> list[slice]:
        """The part of θ that belongs to each section."""
        pairs = (slice(i, i + 2) for i in range(self.real, self.order, 2))
        return [*(slice(i, i + 1) for i in range(self.real)), *pairs]

    def bounds(self, samples: int) -> tuple[Array, Array]:
        """Return the lower and upper bounds of θ for a record of this many samples."""
        T = self.sample_time_s
        low = [np.log(1e-3 / (samples * T))] * self.real + [
            np.log(1e-2 / (samples * T)),
            np.log(DAMPING[0]),
        ] * self.pairs
        high = [np.log(FASTEST / T)] * self.real + [np.log(np.pi / T), np.log(DAMPING[1])] * self.pairs
        return np.array(low), np.array(high)

    def f(self, theta: Array) -> Array:
        """Return F (n + 1,) in powers of z^-1."""
        return self.f_and_slopes(theta)[0]

    def f_and_slopes(self, theta: Array) -> tuple[Array, Array]:
        """Return F (n + 1,) and dF/dθ (n + 1, p)."""
        sections, slopes = [], []
        for log_p in theta[: self.real]:
            a = np.exp(log_p) * self.sample_time_s
            sections.append(np.array([1.0, -np.exp(-a)]))
            slopes.append([np.array([0.0, a * np.exp(-a)])])
        for log_omega, log_zeta in theta[self.real :].reshape(-1, 2):
            section, by_omega, by_zeta = _pair(np.exp(log_omega) * self.sample_time_s, np.exp(log_zeta))
            sections.append(section)
            slopes.append([by_omega, by_zeta])
        columns = []
        for i, own in enumerate(slopes):
            others = np.ones(1)
            for j, section in enumerate(sections):
                if j != i:
                    others = np.convolve(others, section)
            columns += [np.convolve(others, slope) for slope in own]
        f = np.ones(1)
        for section in sections:
            f = np.convolve(f, section)
        return f, np.array(columns).T.reshape(len(f), len(theta))

    def continuous(self, theta: Array) -> list[Array]:
        """Return the sections (1, p) and (1, 2ζω, ω²) of the continuous denominator."""
        sections = [np.array([1.0, np.exp(log_p)]) for log_p in theta[: self.real]]
        for log_omega, log_zeta in theta[self.real :].reshape(-1, 2):
            omega = np.exp(log_omega)
            sections.append(np.array([1.0, 2.0 * np.exp(log_zeta) * omega, omega * omega]))
        return sections


def _pair(g: float, zeta: float) -> tuple[Array, Array, Array]:
    """Return the sampled section of s² + 2ζg s + g² at sample time 1, and its slopes by log g, log ζ."""
    a = zeta * g
    d = g * g - a * a
    if d > 0.0:
        root = np.sqrt(d)
        cosine, sine = np.exp(-a) * np.cos(root), np.exp(-a) * np.sinc(root / np.pi)
    else:
        root = np.sqrt(-d)
        slow, fast = np.exp(-g * g / (a + root)), np.exp(-(a + root))
        cosine = 0.5 * (slow + fast)
        sine = 0.5 * (slow - fast) / root if root > 1e-4 else np.exp(-a)
    middle, last = -2.0 * cosine, np.exp(-2.0 * a)
    # d middle = 2 cosine da + sine dd
    by_g = np.array([0.0, 2.0 * a * cosine + 2.0 * d * sine, -2.0 * a * last])
    by_zeta = np.array([0.0, 2.0 * a * cosine - 2.0 * a * a * sine, -2.0 * a * last])
    return np.array([1.0, middle, last]), by_g, by_zeta


def from_poles(poles: ComplexArray, sections: PoleSections) -> Array | None:
    """Return θ of ``sections`` for continuous poles s (n,). None where their numbers do not fit.

    Unstable poles are reflected. Of the real poles the slowest stand alone; the others are paired by size.
    """
    floor = 1e-9 / sections.sample_time_s
    upper = [complex(-abs(s.real), s.imag) for s in poles if s.imag > 1e-12 * abs(s)]
    reals = sorted(max(abs(float(s.real)), floor) for s in poles if abs(s.imag) <= 1e-12 * abs(s))
    alone, paired = reals[: sections.real], reals[sections.real :]
    if len(alone) < sections.real or len(paired) != 2 * (sections.pairs - len(upper)):
        return None
    pairs = [(abs(s) ** 2, -2.0 * s.real) for s in upper]
    pairs += [(p * q, p + q) for p, q in zip(paired[::2], paired[1::2], strict=True)]
    theta = [np.log(p) for p in alone]
    for square, double in pairs:
        omega = np.sqrt(max(square, floor * floor))
        theta += [np.log(omega), np.log(max(0.5 * double / omega, DAMPING[0]))]
    return np.array(theta)


def regrouped(sections: PoleSections, theta: Array) -> Array:
    """Return θ for the same poles, with real poles of similar size in one pair."""
    poles = np.concatenate([np.roots(section) for section in sections.continuous(theta)])
    found = from_poles(poles.astype(np.complex128), sections)
    return theta if found is None else found
