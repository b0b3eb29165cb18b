"""Poles of the closed loop of a controller with the plant that its file names.

The file of a designed controller repeats its plant in ``origin.plant``: ``num`` and ``den`` in falling powers
of s, and the delay. The loop is sampled as on the rig: the valve voltage is held for a period, and each
command takes effect after the rig's transport delay. Only numpy is needed.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hil.core.control_law import Matrix, realise
from hil.core.controller_file import ControllerFile
from hil.core.errors import DocumentError

MAX_ORDER = 20
"""Largest degree of a plant that is checked."""
MAX_DELAY_PERIODS = 100
"""Longest delay of a plant that is checked, in periods."""
_TAYLOR_TERMS = 20
"""Terms of the exponential's series for a matrix with a norm of at most 1/2: the rest is below 1e-25."""


def check_closed_loop(controller: ControllerFile, source: str, delay_periods: int) -> bool:
    """Refuse a controller that does not stabilise the plant in its file.

    ``delay_periods`` is the rig's transport delay: 1 if the valve board applies commands at SYNC, 0 if it
    applies them at once. Returns False if the file names no plant that can be checked. Raises DocumentError.
    """
    plant = controller.origin.get("plant")
    sampled = _sampled_plant(plant, controller.sample_time_s, delay_periods)
    if sampled is None:
        return False
    pole = largest_pole(controller, *sampled)
    if abs(pole) < 1.0:
        return True
    at = f"{pole.real:.4g}" if pole.imag == 0.0 else f"{pole.real:.4g} ± {abs(pole.imag):.4g}j"
    raise DocumentError(
        f"{source}: the closed loop with the plant of the file (origin.plant) is unstable: its pole z = {at} "
        f"has the modulus {abs(pole):.6g}, but must be below 1; with a sample time of "
        f"{controller.sample_time_s:g} s and a transport delay of {delay_periods} "
        f"period{'' if delay_periods == 1 else 's'} (rig: dac.apply); `hil design` makes a controller for "
        "this plant"
    )


def largest_pole(controller: ControllerFile, A: Matrix, B: Matrix, C: Matrix) -> complex:
    """Return the closed-loop pole with the largest modulus. The plant is x+ = A x + B u, y = C x, sampled."""
    K = realise(controller.law, controller.sample_time_s)
    # The setpoint is 0, so that the law is xk+ = Ak xk + bk y, u = Ck xk + dk y.
    bk, dk = K.B[:, [1]], K.D[:, [1]]
    loop = np.block([[A + B @ dk @ C, B @ K.C], [bk @ C, K.A]])
    poles = np.linalg.eigvals(loop)
    return complex(poles[np.argmax(np.abs(poles))]) if len(poles) else 0j


def _sampled_plant(plant: Any, period_s: float, delay_periods: int) -> tuple[Matrix, Matrix, Matrix] | None:
    """Return the plant of a file with its delay as x+ = A x + B u, y = C x; None if there is none."""
    if not isinstance(plant, dict):
        return None
    num, den = _polynomial(plant.get("num")), _polynomial(plant.get("den"))
    dead_time_s = plant.get("dead_time_s", 0.0)
    contained = plant.get("contains_delay_samples", 0)
    if num is None or den is None or len(num) >= len(den) or den[0] == 0.0:
        return None
    if not isinstance(dead_time_s, int | float) or not isinstance(contained, int):
        return None
    delay = dead_time_s / period_s - contained + delay_periods
    if not 0.0 <= delay <= MAX_DELAY_PERIODS:
        return None
    whole, share = divmod(delay + 1e-9, 1.0)
    return _delayed(*_companion(num, den), period_s, int(whole), share if share > 2e-9 else 0.0)


def _polynomial(coefficients: Any) -> list[float] | None:
    """Return finite coefficients without leading zeros, or None."""
    if not isinstance(coefficients, list) or not 0 < len(coefficients) <= MAX_ORDER + 1:
        return None
    if not all(isinstance(c, int | float) and math.isfinite(c) for c in coefficients):
        return None
    values = [float(c) for c in coefficients]
    while len(values) > 1 and values[0] == 0.0:
        del values[0]
    return values


def _companion(num: list[float], den: list[float]) -> tuple[Matrix, Matrix, Matrix]:
    """Return a strictly proper num(s)/den(s) as x' = A x + B u, y = C x."""
    n = len(den) - 1
    A = np.diag(np.ones(n - 1), -1)
    A[0] = -np.array(den[1:]) / den[0]
    B = np.zeros((n, 1))
    B[0, 0] = 1.0
    C = np.zeros((1, n))
    C[0, n - len(num) :] = np.array(num) / den[0]
    return A, B, C


def _delayed(
    A: Matrix, B: Matrix, C: Matrix, period_s: float, whole: int, share: float
) -> tuple[Matrix, Matrix, Matrix]:
    """Sample the plant with a held input that arrives ``whole`` + ``share`` periods late.

    Within a period, the older of two inputs acts for the first ``share`` of it (Astrom and Wittenmark,
    Computer-Controlled Systems, section 2.3).
    """
    Ad, older = _held(A, B, period_s * share)
    rest, newer = _held(A, B, period_s * (1.0 - share))
    delays = whole + (share > 0.0)
    if delays == 0:
        return rest, newer, C
    n = len(A)
    F = np.zeros((n + delays, n + delays))
    F[:n, :n] = rest @ Ad
    G = np.zeros((n + delays, 1))
    # The states after n are the last inputs, the oldest first.
    F[:n, [n]] = rest @ older if share > 0.0 else newer
    if share > 0.0 and delays > 1:
        F[:n, [n + 1]] = newer
    elif share > 0.0:
        G[:n] = newer
    F[n:-1, n + 1 :] = np.eye(delays - 1)
    G[-1, 0] = 1.0
    return F, G, np.hstack([C, np.zeros((1, delays))])


def _held(A: Matrix, B: Matrix, time_s: float) -> tuple[Matrix, Matrix]:
    """Return e^(A t), and the integral of e^(A s) B over 0 to t."""
    n = len(A)
    M = np.zeros((n + 1, n + 1))
    M[:n, :n], M[:n, n:] = A * time_s, B * time_s
    halvings = max(math.ceil(math.log2(max(float(np.abs(M).sum(axis=0).max()), 1e-300))) + 1, 0)
    M = M / 2.0**halvings
    power = result = np.eye(n + 1)
    for k in range(1, _TAYLOR_TERMS):
        power = power @ M / k
        result = result + power
    for _ in range(halvings):
        result = result @ result
    return result[:n, :n], result[:n, n:]
