"""Loops that have a given step response y(t) = 1 + Σ r_i exp(p_i t), and the readings of that response.

The readings come from the exponentials, point by point, on a grid that resolves every mode while it lasts. So
the reference shares neither states nor blocks with the code under test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from design.closed_loop.loops import ClosedLoops
from design.models.controller import one_degree_of_freedom
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction

ONE = one_degree_of_freedom(np.array([[1.0]]), np.array([[1.0]]))
Values = NDArray[np.float64]
Modes = list[tuple[complex, complex]]
"""Poles with their residues; a complex pair is given by its pole above the real axis."""


@dataclass(frozen=True)
class Given:
    """The readings of a given response."""

    overshoot: float
    settling_s: float
    rise_s: float
    knife_edge: bool
    """True if a peak is so close to the edge of the band, or to a rise level, that rounding decides."""


def both(modes: Modes) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return all poles, and residues that add up to -1, so that y begins at 0."""
    poles, residues = [], []
    for pole, residue in modes:
        poles += [pole] if pole.imag == 0.0 else [pole, np.conj(pole)]
        residues += [residue.real] if pole.imag == 0.0 else [residue / 2.0, np.conj(residue) / 2.0]
    r = np.array(residues, dtype=np.complex128)
    return np.array(poles, dtype=np.complex128), -r / r.sum().real


def continuous_loop(modes: Modes) -> ClosedLoops:
    """Return the loop with K = 1 that has this step response."""
    p, r = both(modes)
    return _around_one(p, r * p, None)


def sampled_loop(modes: Modes, period_s: float) -> ClosedLoops:
    """Return the sampled loop with K = 1 whose samples are those of this step response."""
    p, r = both(modes)
    z = np.exp(p * period_s)
    # 1 + Σ r (z - 1)/(z - z_i), and z = (1 + hs)/(1 - hs): 1 + Σ 2 r/(1 + z_i) s/(s - s_i).
    s = -(1.0 - z) / (0.5 * period_s * (1.0 + z))
    return _around_one(s, 2.0 * r / (1.0 + z) * s, Sampling(period_s, 0), 1.0 + (2.0 * r / (1.0 + z)).sum())


def readings(modes: Modes, period_s: float | None = None) -> Given:
    """Return the readings of the whole response or, with a period, of its samples."""
    p, r = both(modes)
    end_s = np.log(max(float(np.abs(r).sum()) / 1e-5, 2.0)) / -p.real.max()
    if period_s is None:
        grids = [np.geomspace(1e-6 * end_s, end_s, 50_000)]
        for pole, residue in zip(p, r, strict=True):
            lasts_s = np.log(max(abs(residue) / 1e-4, 2.0)) / -pole.real
            grids.append(np.linspace(0.0, lasts_s, int(max(abs(pole) * lasts_s / 0.02, 1000))))
        t = np.unique(np.concatenate(grids))
    else:
        t = period_s * np.arange(int(end_s / period_s) + 2)
    e = np.zeros(len(t))
    for pole, residue in zip(p, r, strict=True):
        e += (residue * np.exp(pole * t)).real
    outside = np.flatnonzero(np.abs(e) > 0.02)
    reached = []
    for level in (-0.9, -0.1):
        k = max(int(np.argmax(e >= level)), 1)
        reached.append(float(np.interp(level, e[k - 1 : k + 1], t[k - 1 : k + 1])))
    tops = e[1:-1][(e[1:-1] - e[:-2]) * (e[2:] - e[1:-1]) <= 0.0]
    near = np.abs(np.concatenate([np.abs(tops) - 0.02, tops + 0.1, tops + 0.9])).min(initial=1.0)
    return Given(
        overshoot=max(float(e.max()), 0.0),
        settling_s=float(t[outside[-1]]),
        rise_s=reached[1] - reached[0],
        knife_edge=bool(near < 2e-4),
    )


def _around_one(
    p: NDArray[np.complex128],
    shares: NDArray[np.complex128],
    sampling: Sampling | None,
    direct: complex = 0.0,
) -> ClosedLoops:
    """Return the loop with K = 1 and T = direct + Σ share/(s - p), which must be 1 at s = 0."""
    den = np.poly(p).real
    num = direct.real * den
    for i, share in enumerate(shares):
        num[1:] += (share * np.poly(np.delete(p, i))).real
    return ClosedLoops(TransferFunction(num, den - num), ONE, sampling=sampling)
