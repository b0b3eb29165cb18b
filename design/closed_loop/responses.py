"""Step responses of batches of closed loops, exact at their samples, for continuous and sampled loops.

Plant and controller keep their own states, in companion forms of scaled time. A continuous loop is stepped by
its matrix exponential, which is exact since the setpoint is constant. A sampled loop is stepped by the exact
map from the bilinear plane to z.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.mathematics.matrix_exponential import exponential
from design.mathematics.polynomials import Array
from design.models.controller import Controller
from design.models.realisation import StateSpace, observer_form, tustin
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction


class StepResponses(NamedTuple):
    """Responses to a unit step of the setpoint at time 0, from rest: time_s (k,), y (B, k), u (B, k)."""

    time_s: Array
    y: Array
    u: Array


def step_responses(
    G: TransferFunction, K: Controller, sampling: Sampling | None, step_s: float, samples: int
) -> StepResponses:
    """Return ``samples`` values of y and u, ``step_s`` apart, for controllers (B, n + 1) on the plant G.

    For a sampled loop, ``step_s`` must be its period. Values are not finite where modes are too fast for the
    arithmetic.
    """
    with np.errstate(all="ignore"):
        loop = closed_loop(G, K)
        A, B, C, D = loop if sampling is None else tustin(loop, sampling.period_s)
        n = A.shape[-1]
        M = np.zeros((len(A), n + 1, n + 1))
        M[:, :n, :n], M[:, :n, n:] = A, B
        if sampling is None:
            M = exponential(M * step_s)
        else:
            M[:, n, n] = 1.0
        outputs = _powers(np.concatenate([C, D], axis=-1), M, samples)
    return StepResponses(step_s * np.arange(float(samples)), outputs[:, 0], outputs[:, 1])


def closed_loop(G: TransferFunction, K: Controller) -> StateSpace:
    """Return the state spaces (B, ...) that lead from the setpoint r to [y, u], with negative feedback."""
    num, den, num_r = (np.atleast_2d(p) for p in K)
    Ag, Bg, _, Dg = observer_form(np.atleast_2d(G.den), np.atleast_2d(G.num))
    Ak, Bk, _, Dk = observer_form(den, num_r, -num)
    size = max(len(Ag), len(Ak), len(Dk))
    ng, nk = Ag.shape[-1], Ak.shape[-1]
    n = ng + nk
    # y = x_g[0] + Dg u and u = x_k[0] + Dk [r, y] depend on each other; the direct path is solved first.
    direct = 1.0 / (1.0 - Dk[:, 0, 1] * Dg[:, 0, 0])
    U = np.zeros((size, 1, n + 1))
    if nk:
        U[:, 0, ng] = 1.0
    if ng:
        U[:, 0, 0] = Dk[:, 0, 1]
    U[:, 0, n] = Dk[:, 0, 0]
    U *= direct[:, None, None]
    Y = Dg * U
    if ng:
        Y[:, 0, 0] += 1.0
    rows = np.zeros((size, n, n + 1))
    rows[:, :ng, :ng] = Ag
    rows[:, ng:, ng:n] = Ak
    rows[:, :ng] += Bg @ U
    rows[:, ng:] += Bk[:, :, 1:] @ Y
    rows[:, ng:, n] += Bk[:, :, 0]
    outputs = np.concatenate([Y, U], axis=1)
    return StateSpace(rows[:, :, :n], rows[:, :, n:], outputs[:, :, :n], outputs[:, :, n:])


def _powers(rows: Array, M: Array, samples: int) -> Array:
    """Return rows M^k [0 … 0 1]' for k < samples, as (B, outputs, samples).

    The powers up to about the root of ``samples`` are applied to the rows, and the others to the state.
    """
    size, outputs, n = rows.shape
    small = 1
    blocks = rows
    while small * small < samples:
        blocks = np.concatenate([blocks, blocks @ M], axis=1)
        M = M @ M
        small *= 2
    giant = 1
    states = np.zeros((size, n, 1))
    states[:, -1] = 1.0
    while giant * small < samples:
        states = np.concatenate([states, M @ states], axis=2)
        M = M @ M
        giant *= 2
    values = (blocks @ states).reshape(size, small, outputs, giant)
    return values.transpose(0, 2, 3, 1).reshape(size, outputs, small * giant)[:, :, :samples]
