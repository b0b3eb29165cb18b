"""Control laws at run time: every controller file becomes one sampled state space with anti-windup.

x[k+1] = A x[k] + B [r, y] + L (u_applied - u),  u = C x + D [r, y].

u_applied is the output after the limits of the valve. L acts only while a limit is active.

The gain L is that of the stationary Kalman predictor of the law seen as x+ = A x + b v, u = C x + d v.
If the law has stable zeros and d != 0, L = b/d: the conditioning technique (Hanus, Kinnaert, Henrotte,
Automatica 1987). If a zero is unstable or on the unit circle, the predictor gives a stable gain near it.
While a limit is active, the state of the law decays at the rate of its own zeros.

At run time all numbers are plain floats, because numpy is slower for systems of this size.
"""

from __future__ import annotations

import math
from operator import mul
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.core.controller_file import MAX_COEFFICIENT, Law, PidLaw, StateSpaceLaw, TransferFunctionLaw
from hil.core.errors import DocumentError

Matrix = NDArray[np.float64]

INTEGRATOR_TOLERANCE = 1e-6
"""Distance of a mode from the unit circle below which it counts as an integrator.

With a period of 10 ms, such a mode decays with a time constant of 10,000 s or more. Computed eigenvalues are
often less exact than 1e-8.
"""


class Realisation(NamedTuple):
    """A sampled state space: A (n, n), B (n, 2), C (1, n), D (1, 2); inputs [r, y], output u in volts."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


def realise(law: Law, sample_time_s: float) -> Realisation:
    """Return the state space of a law at ``sample_time_s``, exactly as the gateway runs it."""
    match law:
        case PidLaw():
            return _realise_pid(law, sample_time_s)
        case TransferFunctionLaw(num=num, den=den):
            return _realise_transfer_function(np.array(num), np.array(den))
        case StateSpaceLaw():
            n = len(law.A)
            A = np.array(law.A).reshape(n, n)
            m = 1 if law.inputs == "e" else 2
            B, C, D = (
                np.array(law.B).reshape(n, m),
                np.array(law.C).reshape(1, n),
                np.array(law.D).reshape(1, m),
            )
            return Realisation(A, _from_error(B), C, _from_error(D)) if m == 1 else Realisation(A, B, C, D)


def check_law_runs(law: Law, sample_time_s: float, source: str) -> None:
    """Refuse a law with coefficients that are too large, or without a stable anti-windup gain.

    ``source`` names the law in errors. Raises DocumentError.
    """
    with np.errstate(all="ignore"):
        A, B, C, D = realise(law, sample_time_s)
    largest = float(np.max(np.abs(np.concatenate([part.ravel() for part in (A, B, C, D)]))))
    if not largest <= MAX_COEFFICIENT:
        raise DocumentError(
            f"{source}: law: its state space at {sample_time_s} s has a coefficient of {largest:.3g}, over "
            f"the limit {MAX_COEFFICIENT:g}; scale the law"
        )
    try:
        conditioned = A - anti_windup_gain(A, B, C, D) @ C
    except np.linalg.LinAlgError:
        conditioned = np.full_like(A, np.inf)
    if not np.all(np.isfinite(conditioned)) or np.any(np.abs(np.linalg.eigvals(conditioned)) > 1.0 - 1e-10):
        raise DocumentError(
            f"{source}: law: a mode that does not decay is not seen in the output or not moved by the "
            "input, so that nothing bounds it while the valve is limited; give a minimal realisation"
        )


class LawNumbers(NamedTuple):
    """All numbers of a law at run time. Matrices are lists of rows; n is the number of states."""

    A: list[list[float]]
    """n rows of n."""
    B: list[list[float]]
    """n rows of 2, for r and y."""
    C: list[float]
    D: list[float]
    """2 values, for r and y."""
    L: list[float]
    """Anti-windup gain."""
    slowest: list[float]
    """The mode nearest to an integrator, scaled to C x = 1; 0 if no mode is seen in the output."""
    settled: list[list[float]]
    """n rows of 2: the state for constant r and y in which all modes except the slowest are at rest."""
    pole: float
    """Modulus of the slowest mode's eigenvalue: 1 for an integrator, 0 if no mode is seen in the output."""
    rest_gain: list[float]
    """Output at rest for constant r and y, 2 values in volts per unit.

    It is empty if the law does not come to rest, because it integrates or is unstable.
    """


def law_numbers(law: Law, sample_time_s: float) -> LawNumbers:
    """Compute the numbers with which a law runs at ``sample_time_s``."""
    A, B, C, D = realise(law, sample_time_s)
    n = A.shape[0]
    slowest, pole = _slowest_mode(A, C)
    # State in which all modes except the slowest are at rest, for constant r and y.
    deflated = np.eye(n) - A + slowest @ C
    settled = np.linalg.lstsq(deflated, B - slowest @ D, rcond=None)[0]
    return LawNumbers(
        A.tolist(),
        B.tolist(),
        C[0].tolist(),
        D[0].tolist(),
        anti_windup_gain(A, B, C, D)[:, 0].tolist(),
        slowest[:, 0].tolist(),
        settled.tolist(),
        pole,
        _rest_gain(A, B, C, D),
    )


class Matching(NamedTuple):
    """How a law took over: its output was matched to a voltage, as far as the law can be matched."""

    jump_v: float
    """Output in volts minus the voltage to which it was matched: 0 unless no mode is seen in the output."""
    drift_v: float
    """Voltage by which the output then moves by itself while r and y are constant; 0 for an integrator."""
    time_constant_s: float
    """Time constant of this motion in seconds; 0 if it is a jump."""


class ControlLaw:
    """Controller of one axis at run time.

    In each period call ``output``, limit what it returns, then call ``advance`` with the limited value.
    """

    def __init__(self, law: Law, sample_time_s: float) -> None:
        self._use(law_numbers(law, sample_time_s), sample_time_s)

    @classmethod
    def of_numbers(cls, numbers: LawNumbers, sample_time_s: float) -> ControlLaw:
        """Return the law of which :func:`law_numbers` computed the numbers, perhaps in another process."""
        law = cls.__new__(cls)
        law._use(numbers, sample_time_s)
        return law

    def _use(self, numbers: LawNumbers, sample_time_s: float) -> None:
        self._sample_time_s = sample_time_s
        self._numbers = numbers
        self._A = [tuple(row) for row in numbers.A]
        self._Br = [row[0] for row in numbers.B]
        self._By = [row[1] for row in numbers.B]
        self._C = numbers.C
        self._Dr, self._Dy = numbers.D
        self._L = numbers.L
        self._x = [0.0] * len(numbers.A)
        self._r = self._y = self._u = 0.0

    def initialise(self, r: float, y: float, u: float) -> None:
        """Take over without a jump: set the state so that the next ``output(r, y)`` is ``u``.

        The state is the one after r and y have been constant for a long time, except for the slowest mode,
        which is the integrator where the law has one. This mode is set so that the output is ``u``. A law
        without dynamics has no state; its output is then not ``u``.
        """
        n = len(self._x)
        x = np.array(self._numbers.settled).reshape(n, 2) @ np.array([[r], [y]])
        self._x = x[:, 0].tolist()
        x = x + np.array(self._numbers.slowest).reshape(n, 1) * (u - self.output(r, y))
        self._x = x[:, 0].tolist()

    def match(self, r: float, y: float, u: float) -> Matching:
        """Take over from another law that was given r and y and whose output after the limits was ``u``.

        The next ``output(r, y)`` is ``u``, as after :meth:`initialise`. Returns what remains of a bump.
        """
        self.initialise(r, y, u)
        output, pole, rest_gain = self.output(r, y), self._numbers.pole, self._numbers.rest_gain
        rest_v = rest_gain[0] * r + rest_gain[1] * y if rest_gain else output
        if not any(self._numbers.slowest):
            return Matching(output - u, 0.0, 0.0)
        is_decaying = 0.0 < pole < 1.0 and bool(rest_gain)
        time_constant_s = -self._sample_time_s / math.log(pole) if is_decaying else 0.0
        return Matching(0.0, rest_v - output, time_constant_s)

    def output(self, r: float, y: float) -> float:
        """Return u in volts for setpoint r and position y in the axis' unit. The state does not change."""
        u = sum(map(mul, self._C, self._x), self._Dr * r + self._Dy * y)
        self._r, self._y, self._u = r, y, u
        return u

    def advance(self, u_applied: float) -> None:
        """Step to the next sample. ``u_applied`` is the output after the limits, in volts."""
        x, r, y = self._x, self._r, self._y
        excess = u_applied - self._u
        self._x = [
            sum(map(mul, row, x), br * r + by * y + gain * excess)
            for row, br, by, gain in zip(self._A, self._Br, self._By, self._L, strict=True)
        ]


def anti_windup_gain(A: Matrix, B: Matrix, C: Matrix, D: Matrix) -> Matrix:
    """Return the gain L (n, 1) of the Kalman predictor of x+ = A x + B v, u = C x + D v + noise.

    A - L C is stable. Shapes: A (n, n), B (n, m), C (1, n), D (1, m); v is white noise in every input of the
    law. The Riccati equation is solved by structure-preserving doubling (Chu, Fan, Lin, Wang 2004) after the
    cross term has been removed. Without the small measurement noise, zeros on the unit circle would ring;
    Tustin's rule puts one at -1 in a strictly proper law.
    """
    n, m = B.shape
    if n == 0:
        return np.zeros((0, 1))
    impulse_response = [D, *(C @ np.linalg.matrix_power(A, k) @ B for k in range(n))]
    scale = max(float(np.max(np.abs(impulse_response))), 1e-12)
    R = D @ D.T / m + (0.1 * scale) ** 2
    S = B @ D.T / m
    gain_direct = S / R
    # Dual discrete-time algebraic Riccati equation: P = F P F' - F P C' (R + C P C')^-1 C P F' + Q
    F = A - gain_direct @ C
    Q = B @ B.T / m - gain_direct @ S.T
    E, G, H = F.T.copy(), C.T @ C / R, Q
    for _ in range(60):
        W = np.linalg.inv(np.eye(n) + G @ H)
        step = E.T @ H @ W @ E
        G = G + E @ W @ G @ E.T
        E = E @ W @ E
        H = H + step
        if np.abs(step).max() <= 1e-14 * max(np.abs(H).max(), 1e-300):
            break
    P = 0.5 * (H + H.T)
    return np.asarray((A @ P @ C.T + S) / (R + C @ P @ C.T), dtype=np.float64)


def _slowest_mode(A: Matrix, C: Matrix) -> tuple[Matrix, float]:
    """Return the mode (n, 1) that is seen in the output and is nearest to an integrator, scaled to C x = 1.

    The second value is the modulus of its eigenvalue. If no mode is seen in the output, both are 0.
    """
    eigenvalues, modes = np.linalg.eig(A)
    seen = (C @ modes)[0]
    if not np.any(seen):
        return np.zeros((A.shape[0], 1)), 0.0
    slowest = np.argmax(np.abs(seen) / (np.abs(1.0 - eigenvalues) + 1e-9))
    mode = np.asarray((modes[:, [slowest]] / seen[slowest]).real, dtype=np.float64)
    return mode, float(np.abs(eigenvalues[slowest]))


def _rest_gain(A: Matrix, B: Matrix, C: Matrix, D: Matrix) -> list[float]:
    """Return the law's gain for constant r and y, or an empty list if it does not come to rest."""
    n = A.shape[0]
    if np.any(np.abs(np.linalg.eigvals(A)) > 1.0 - INTEGRATOR_TOLERANCE):
        return []
    gain: list[float] = (C @ np.linalg.solve(np.eye(n) - A, B) + D)[0].tolist()
    return gain


def _realise_pid(pid: PidLaw, ts: float) -> Realisation:
    """Sample eq. (19) by Tustin's rule: 1/s is Ts/2 (z+1)/(z-1), the derivative is g (z-1)/(z-beta)."""
    beta = (2.0 * pid.tau_d - ts) / (2.0 * pid.tau_d + ts)
    g = 2.0 * pid.kd / (2.0 * pid.tau_d + ts)
    half = 0.5 * pid.ki * ts
    A = np.diag([1.0, beta])
    B = np.array([[1.0, -1.0], [pid.c, -1.0]])
    C = np.array([[2.0 * half, g * (beta - 1.0)]])
    D = np.array([[pid.kp * pid.b + half + g * pid.c, -(pid.kp + half + g)]])
    kept = [i for i, gain in enumerate((pid.ki, pid.kd)) if gain != 0.0]
    return Realisation(A[np.ix_(kept, kept)], B[kept], C[:, kept], D)


def _realise_transfer_function(num: Matrix, den: Matrix) -> Realisation:
    """Return the observer companion form of num(z)/den(z)."""
    n = len(den) - 1
    a = den[1:] / den[0]
    b = np.concatenate([np.zeros(n + 1 - len(num)), num]) / den[0]
    A = np.hstack([-a.reshape(n, 1), np.eye(n, max(n - 1, 0))]) if n else np.zeros((0, 0))
    B = (b[1:] - a * b[0]).reshape(n, 1)
    C = np.eye(1, n) if n else np.zeros((1, 0))
    return Realisation(A, _from_error(B), C, _from_error(b[:1].reshape(1, 1)))


def _from_error(columns: Matrix) -> Matrix:
    """Return the columns for [r, y] that belong to a column for e = r - y."""
    return np.hstack([columns, -columns])
