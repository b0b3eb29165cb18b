r"""A continuous model behind a zero-order hold, with a dead time of any length, as polynomials in z^-1.

With A, B of the denominator's companion form and a dead time of d + m samples, 0 <= m < 1,

    x(k + 1) = exp(A T) x(k) + exp(A (1 - m) T) Γ(m) u(k - d - 1) + Γ(1 - m) u(k - d),
    Γ(θ) = ∫ from 0 to θT of exp(A t) B dt

(modified z transform; Åström and Wittenmark, Computer-Controlled Systems, section 2.3). The numerator for
s^i in the continuous numerator follows from the first n + 1 values of the impulse response. All is exact.
"""

from __future__ import annotations

import numpy as np

from design.identification.models.difference_basis import basis
from design.identification.models.model import ContinuousModel, DiscreteModel
from design.mathematics.matrix_exponential import exponential
from design.mathematics.polynomials import Array

_ROUNDING = 1e-9
"""Distance in samples of a dead time from a whole number that counts as rounding."""


def held_numerators(
    dens: Array, f: Array, whole: int, rest: Array, count: int, sample_time_s: float
) -> Array:
    """Return the sampled numerators (k, n + 1, count) of s^0 … s^(count - 1) over each of k denominators.

    ``dens`` (k, n + 1) is monic in falling powers of s, ``f`` (k, n + 1) its sampled counterpart in powers
    of z^-1; count <= n. The dead time is ``whole`` + ``rest`` (k,) samples, and the first coefficient
    multiplies z^-(whole + 1).
    """
    k, n, T = len(dens), dens.shape[-1] - 1, sample_time_s
    # Time is scaled by the fastest pole, so that no entry of the companion matrix dwarfs the others.
    speed = np.maximum(np.abs(dens[:, 1:]) ** (1.0 / np.arange(1, n + 1)), 1e-3 / T).max(axis=1)[:, None]
    block = np.zeros((k, n + 1, n + 1))
    block[:, 0, :n] = -dens[:, 1:] / speed ** np.arange(1, n + 1) * speed * T
    block[:, np.arange(1, n), np.arange(n - 1)] = speed * T
    block[:, :1, n] = speed * T
    part = rest[:, None, None]
    full, late, early = exponential(np.concatenate([block, block * (1.0 - part), block * part])).reshape(
        3, k, n + 1, n + 1
    )
    # A unit input of one period reaches the states in the part of the period after the dead time, and in the
    # part of the next period before it.
    state = late[:, :n, n]
    carried = np.einsum("kij,kj->ki", late[:, :n, :n], early[:, :n, n])
    responses = [state]
    for _ in range(n):
        state = np.einsum("kij,kj->ki", full[:, :n, :n], state) + carried
        carried = np.zeros_like(carried)
        responses.append(state)
    # State j is s^(n - j)/den.
    outputs = (np.stack(responses, axis=1) / (speed ** np.arange(1, n + 1))[:, None, :])[:, :, ::-1]
    found = np.zeros((k, n + 1, count))
    for lag in range(n + 1):
        found[:, lag:] += f[:, lag, None, None] * outputs[:, : n + 1 - lag, :count]
    return found


def hold(model: ContinuousModel, sample_time_s: float) -> DiscreteModel:
    """Return the sampled model of a strictly proper continuous one behind a zero-order hold. It is exact."""
    den = np.asarray(model.den, dtype=float) / model.den[0]
    num = np.asarray(model.num, dtype=float)[::-1] / model.den[0]
    n = len(den) - 1
    dead = model.dead_time_s / sample_time_s
    if abs(dead - round(dead)) < _ROUNDING:
        dead = float(round(dead))
    whole, rest = divmod(dead, 1.0)
    # Factors 1 - exp(sT) z^-1 in powers of 1 - z^-1, where slow poles keep their digits.
    differences = np.ones(1, dtype=np.complex128)
    for pole in np.roots(den) * sample_time_s:
        differences = np.convolve(differences, [-np.expm1(pole), np.exp(pole)])
    f = basis(n + 1) @ differences.real
    b = held_numerators(den[None], f[None], int(whole), np.array([rest]), len(num), sample_time_s)[0] @ num
    return DiscreteModel(b if rest > 0.0 else b[:-1], f, int(whole) + 1, sample_time_s)
