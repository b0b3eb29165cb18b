"""Controllers for comparison: Ziegler-Nichols, Tyreus-Luyben, and conventional loop shaping.

The ultimate cycle is computed exactly. Under proportional control with the gain k, the poles of the closed
loop are the roots of d + k n. The ultimate gain is the k at which a pair of them reaches the imaginary axis.
A sampled loop is given in the bilinear plane, so that its ultimate cycle includes hold and delay.

Sources: Ziegler and Nichols 1942; Tyreus and Luyben 1992; conventional loop shaping, eqs. (5) to (7).
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
"""Ratio of the derivative time to the time constant of the derivative filter: tau_d = Td/N."""


@dataclass(frozen=True)
class UltimateCycle:
    """Ultimate gain Ku, in the controller's output unit per input unit, and ultimate period Pu in s."""

    gain: float
    period_s: float


@dataclass(frozen=True)
class PidGains:
    """Parameters of the structure "pid", eq. (19)."""

    kp: float
    ki: float
    kd: float
    tau_d: float

    @property
    def values(self) -> list[float]:
        """Parameter values in the order of the structure "pid"."""
        return [self.kp, self.ki, self.kd, self.tau_d]


def ultimate_cycle(G: TransferFunction, sampling: Sampling | None = None) -> UltimateCycle:
    """Return the ultimate cycle of G(s), or, with ``sampling``, of G in the bilinear plane of its loop.

    The ultimate gain is the upper end of the stable gains; it is negative for a plant of negative gain.
    Raises DesignError if no gain stabilises the loop, if every gain does, or if it loses stability without
    oscillating.
    """
    ends = _marginal(G)
    n, d = np.ravel(G.num), np.ravel(G.den)
    # With this sign of k, k n(0) has the sign of d(0): the feedback is negative.
    sign = 1.0 if np.trim_zeros(n, "b")[-1] * np.trim_zeros(d, "f")[0] > 0.0 else -1.0
    candidates = [
        end for end in (_last_stable(G, sign, ends), _last_stable(G, -sign, ends)) if end is not None
    ]
    if not candidates:
        raise DesignError("the loop has no ultimate cycle: no proportional gain stabilises the plant")
    for gain, omega in candidates:
        true_omega = omega if sampling is None else float(sampling.unwarp(omega))
        if 0.0 < true_omega < np.inf and np.isfinite(gain):
            return UltimateCycle(gain, 2.0 * np.pi / true_omega)
    gain, _ = candidates[0]
    if np.isinf(gain):
        raise DesignError(
            "the loop has no ultimate cycle: it stays stable at every proportional gain"
            + ("" if sampling else "; the sampled loop has one")
        )
    raise DesignError(
        f"the loop has no ultimate cycle: above a gain of {gain:.4g} it drifts instead of oscillating"
    )


def ziegler_nichols(cycle: UltimateCycle) -> PidGains:
    """Tune a PID by Ziegler and Nichols: Kp = 0.6 Ku, Ti = Pu/2, Td = Pu/8."""
    return _pid(0.6 * cycle.gain, cycle.period_s / 2.0, cycle.period_s / 8.0)


def tyreus_luyben(cycle: UltimateCycle) -> PidGains:
    """Tune a PID by Tyreus and Luyben: Kp = Ku/2.2, Ti = 2.2 Pu, Td = Pu/6.3."""
    return _pid(cycle.gain / 2.2, 2.2 * cycle.period_s, cycle.period_s / 6.3)


def loop_shaping_controller(G: TransferFunction, W: TransferFunction, factor: float = 1.1) -> Controller:
    """Return K = W1 K∞ of eq. (7) as polynomials (1, n + 1); K∞ is central for γ = factor γ_opt."""
    K_inf, _ = central_controllers(shaped(G, W), factor)
    return one_degree_of_freedom(poly.multiply(W.num, K_inf.num), poly.multiply(W.den, K_inf.den))


def _pid(kp: float, ti: float, td: float) -> PidGains:
    return PidGains(kp, kp / ti, kp * td, td / FILTER_N)


def _marginal(G: TransferFunction) -> list[tuple[float, float]]:
    """Return the gains k at which d + k n has a root jω on the axis, each with its ω in rad/s.

    ω may be 0 or infinite; in the bilinear plane, infinity is z = -1.
    """
    n, d = np.ravel(G.num), np.ravel(G.den)
    n = poly.add(n, np.zeros(len(d)))
    marginal = [(-d[-1] / n[-1], 0.0)] if n[-1] != 0.0 else []
    if n[0] != 0.0:
        marginal.append((-d[0] / n[0], np.inf))
    even_n, odd_n = poly.even_odd(n)
    even_d, odd_d = poly.even_odd(d)
    crossing = poly.roots(poly.add(poly.multiply(odd_n, even_d), -poly.multiply(even_n, odd_d)))
    real = np.isfinite(crossing) & (np.abs(crossing.imag) <= 1e-9 * np.abs(crossing)) & (crossing.real > 0.0)
    for omega in np.sqrt(crossing[real].real):
        loop = complex(np.polyval(d, 1j * omega) / np.polyval(n, 1j * omega))
        marginal.append((-loop.real, float(omega)))
    return [(float(k), float(omega)) for k, omega in marginal]


def _last_stable(
    G: TransferFunction, sign: float, ends: list[tuple[float, float]]
) -> tuple[float, float] | None:
    """Return the upper end of the stable gains of one sign: the gain and its ω; None if no gain is stable.

    ``ends`` are the marginal gains with their ω; between two of them the loop is stable throughout or
    nowhere.
    """
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
