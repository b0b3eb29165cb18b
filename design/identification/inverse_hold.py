r"""The continuous model behind a zero-order hold of which a sampled model is the image, if there is one.

The step matrix of the sampled model with its input as a further state is [Φ Γ; 0 1] = exp([A B; 0 0] T), so
its logarithm gives A and B. A logarithm that is real exists where no pole lies on the negative real axis or at 0,
and it is unique among modes below half the sampling frequency. Whole samples of delay are a dead time.

A pole on the negative real axis changes sign at each sample; no continuous plant of the same order does that.
A pole at 0 is a delay or noise. For such models ``nearest_continuous`` fits a continuous model of the same order
to the sampled one's output.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import logm

from design.errors import DesignError
from design.identification.continuous_fit import fit_continuous
from design.identification.difference_basis import basis
from design.identification.experiment import Experiment
from design.identification.held_discretisation import hold
from design.identification.models import ContinuousModel, DiscreteModel
from design.identification.structures import ContinuousPoles
from design.mathematics.polynomials import Array, multiply

_ON_THE_AXIS = 1e-7
"""Largest argument, as a distance from π, of a pole that counts as lying on the negative real axis."""
_AT_ZERO = 1e-12
"""Largest modulus of a pole that counts as lying at 0."""


class NoContinuousModelError(DesignError):
    """No continuous model behind a zero-order hold has this sampled image."""


@dataclass(frozen=True)
class Nearest:
    """A continuous model that comes close to a sampled one that has no exact counterpart."""

    model: ContinuousModel
    fit_percent: float
    """Fit of its output to that of the sampled model, for white inputs held over a few samples."""


def invert_hold(model: DiscreteModel) -> ContinuousModel:
    """Return the continuous model of which ``model`` is the image behind a zero-order hold.

    A delay of nk samples becomes a dead time of nk - 1 sample times, for the hold itself needs one. Raises
    NoContinuousModelError, whose text names the pole, where no such model exists.
    """
    T = model.sample_time_s
    b, lag = model.b, model.nk
    while len(b) > 1 and b[0] == 0.0:
        b, lag = b[1:], lag + 1
    n = len(np.trim_zeros(model.f, "b")) - 1
    b = np.trim_zeros(b, "b") if b.any() else b[:1]
    _check_poles(model)
    if len(b) > n + (lag == 0):
        raise NoContinuousModelError(
            f"{len(b)} coefficients in B with {n} poles: no continuous model of order {n} behind a zero-order hold has "
            f"them; choose nb <= {n}, or a continuous structure with a dead time"
        )
    # x(k + 1) = x(k) + (A x + B u), y = C x + D u, in powers of γ = z - 1, so that slow poles keep their digits.
    shift = 1 if lag > 0 else 0
    num = _in_forward_differences(np.concatenate([np.zeros(shift), b]), n)
    den = _in_forward_differences(model.f[: n + 1], n)
    num, den = num / den[-1], den / den[-1]
    direct = num[-1]
    weights = num[:-1] - direct * den[:-1]
    speed = float(max((np.abs(den[:-1]) ** (1.0 / np.arange(n, 0, -1))).max(initial=0.0), 1e-6))
    step = np.zeros((n + 1, n + 1))
    step[0, :n] = -den[n - 1 :: -1] / speed ** np.arange(1, n + 1) * speed
    step[np.arange(1, n), np.arange(n - 1)] = speed
    step[0, n] = speed
    rates = np.real(logm(np.eye(n + 1) + step)) / T
    C = weights[::-1] / speed ** np.arange(1, n + 1)
    num_s, den_s = _transfer_function(rates[:n, :n], rates[:n, n], C, float(direct))
    return ContinuousModel(num_s, den_s, max(lag - 1, 0) * T)


def _check_poles(model: DiscreteModel) -> None:
    T = model.sample_time_s
    for z in model.poles_z:
        if abs(z) < _AT_ZERO:
            raise NoContinuousModelError(
                "a pole at z = 0: a delay of one sample, or an order that is too high; lower nf or raise nk"
            )
        if abs(abs(np.angle(z)) - np.pi) < _ON_THE_AXIS:
            raise NoContinuousModelError(
                f"a pole at z = {z.real:.4g}, on the negative real axis: no continuous model of order {model.order} "
                f"behind a zero-order hold of {T:g} s has it; lower nf, sample faster, or use a continuous structure"
            )


def _in_forward_differences(p: Array, n: int) -> Array:
    """Coefficients (n + 1,) in rising powers of z - 1 of z^n p(1/z), for p in rising powers of 1/z."""
    padded = np.concatenate([p, np.zeros(n + 1 - len(p))])
    rising = basis(n + 1) @ padded
    # With γ = z - 1: 1 - 1/z = γ/(1 + γ).
    total = np.zeros(n + 1)
    for i, coefficient in enumerate(rising):
        power = np.ones(1)
        for _ in range(n - i):
            power = np.convolve(power, [1.0, 1.0])
        total[i:] += coefficient * power
    return total


def _transfer_function(A: Array, B: Array, C: Array, direct: float) -> tuple[Array, Array]:
    """num and den in falling powers of s, by Faddeev and Leverrier's recursion in time scaled by the fastest pole."""
    n = len(A)
    speed = max(float(np.abs(np.linalg.eigvals(A)).max(initial=0.0)), 1e-300)
    scaled = A / speed
    den, num, M = [1.0], [], np.eye(n)
    for k in range(1, n + 1):
        num.append(float(C @ M @ B))
        den.append(-float(np.trace(scaled @ M)) / k)
        M = scaled @ M + den[-1] * np.eye(n)
    powers = speed ** np.arange(n + 1.0)
    full = np.array(den) * powers
    top = np.concatenate([[0.0], np.array(num) * powers[:n]])
    top = top + direct * full
    significant = np.abs(top) / powers > 1e-13 * (np.abs(top) / powers).max(initial=0.0)
    first = int(np.argmax(significant)) if significant.any() else n
    return top[first:], full


__all__ = ["Nearest", "NoContinuousModelError", "invert_hold", "nearest_continuous"]
