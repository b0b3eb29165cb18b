"""Controllers to compare with: Ziegler-Nichols and Tyreus-Luyben, conventional loop shaping.

The ultimate cycle is found exactly: under proportional control the closed loop has the poles of d + k n, and
k is ultimate where a pair of them reaches the axis. Sampled loops are those of the bilinear plane, so their
ultimate cycle is that of the loop with its hold and delay. Rules: Ziegler and Nichols 1942; Tyreus and
Luyben 1992; the derivative is filtered at N = 10. Conventional loop shaping: eqs. (5) to (7).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from design.errors import DesignError
from design.mathematics import polynomials as poly
from design.models.controller import Controller, one_degree_of_freedom
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction
from design.robustness.central_controller import central_controllers
from design.robustness.loop_shaping import shaped

FILTER_N = 10.0
"""Derivative filter: tau_d = Td/N."""


@dataclass(frozen=True)
class UltimateCycle:
    """Ultimate gain Ku (output unit of the controller per input unit) and period Pu in seconds."""

    gain: float
    period_s: float


@dataclass(frozen=True)
class PidGains:
    """Gains of eq. (19), in the order of the structure "pid"."""

    kp: float
    ki: float
    kd: float
    tau_d: float

    @property
    def values(self) -> list[float]:
        """As the structure takes them."""
        return [self.kp, self.ki, self.kd, self.tau_d]


def ultimate_cycle(G: TransferFunction, sampling: Sampling | None = None) -> UltimateCycle:
    """Ultimate cycle of G(s), or with ``sampling`` of G in its bilinear plane (hold and delay included).

    The largest gain that keeps the loop stable, negative for a plant of negative gain. Raises DesignError
    where there is none: no gain stabilises, every gain does, or stability is lost without an oscillation.
    """
    ends = _marginal(G)
    n, d = np.ravel(G.num), np.ravel(G.den)
    # Feedback is negative where k n(0) helps d(0).
    sign = 1.0 if np.trim_zeros(n, "b")[-1] * np.trim_zeros(d, "f")[0] > 0.0 else -1.0
    found = [end for end in (_last_stable(G, sign, ends), _last_stable(G, -sign, ends)) if end is not None]
    if not found:
        raise DesignError("the loop has no ultimate cycle: no proportional gain stabilises the plant")
    for gain, omega in found:
        true_omega = omega if sampling is None else float(sampling.unwarp(omega))
        if 0.0 < true_omega < np.inf and np.isfinite(gain):
            return UltimateCycle(gain, 2.0 * np.pi / true_omega)
    gain, _ = found[0]
    if np.isinf(gain):
        raise DesignError(
            "the loop has no ultimate cycle: it stays stable at every proportional gain"
            + ("" if sampling else "; the sampled loop has one")
        )
    raise DesignError(
        f"the loop has no ultimate cycle: past a gain of {gain:.4g} it drifts instead of oscillating"
    )


def ziegler_nichols(cycle: UltimateCycle) -> PidGains:
    """Kp = 0.6 Ku, Ti = Pu/2, Td = Pu/8."""
    return _pid(0.6 * cycle.gain, cycle.period_s / 2.0, cycle.period_s / 8.0)


def tyreus_luyben(cycle: UltimateCycle) -> PidGains:
    """Kp = Ku/2.2, Ti = 2.2 Pu, Td = Pu/6.3."""
    return _pid(cycle.gain / 2.2, 2.2 * cycle.period_s, cycle.period_s / 6.3)


def loop_shaping_controller(G: TransferFunction, W: TransferFunction, factor: float = 1.1) -> Controller:
    """K = W1 K∞ of eq. (7), K∞ central for γ = factor γ_opt. Polynomials (1, n + 1)."""
    K_inf, _ = central_controllers(shaped(G, W), factor)
    return one_degree_of_freedom(poly.multiply(W.num, K_inf.num), poly.multiply(W.den, K_inf.den))


def _pid(kp: float, ti: float, td: float) -> PidGains:
    return PidGains(kp, kp / ti, kp * td, td / FILTER_N)


def _marginal(G: TransferFunction) -> list[tuple[float, float]]:
    """Gains k at which d + k n has a root on the axis, each with its ω: 0, finite, or ∞ (z = -1)."""
    n, d = np.ravel(G.num), np.ravel(G.den)
    n = poly.add(n, np.zeros(len(d)))
    found = [(-d[-1] / n[-1], 0.0)] if n[-1] != 0.0 else []
    if n[0] != 0.0:
        found.append((-d[0] / n[0], np.inf))
    even_n, odd_n = poly.even_odd(n)
    even_d, odd_d = poly.even_odd(d)
    crossing = poly.roots(poly.add(poly.multiply(odd_n, even_d), -poly.multiply(even_n, odd_d)))
    real = np.isfinite(crossing) & (np.abs(crossing.imag) <= 1e-9 * np.abs(crossing)) & (crossing.real > 0.0)
    for omega in np.sqrt(crossing[real].real):
        loop = complex(np.polyval(d, 1j * omega) / np.polyval(n, 1j * omega))
        found.append((-loop.real, float(omega)))
    return [(float(k), float(omega)) for k, omega in found]


def _last_stable(
    G: TransferFunction, sign: float, ends: list[tuple[float, float]]
) -> tuple[float, float] | None:
    """The end of the last stable range of gains of one sign: the gain and its ω; None if none is stable."""
    ends = sorted((abs(k), omega) for k, omega in ends if sign * k > 0.0)
    bounds = [0.0, *(k for k, _ in ends)]
    inside = [0.5 * (low + high) for low, high in pairwise(bounds)]
    inside.append(2.0 * bounds[-1] if ends else 1.0)
    stable = [bool(poly.hurwitz(poly.add(np.ravel(G.den), sign * k * np.ravel(G.num)))) for k in inside]
    if not any(stable):
        return None
    last = len(stable) - 1 - stable[::-1].index(True)
    if last == len(ends):
        return np.inf, np.inf
    return sign * ends[last][0], ends[last][1]
