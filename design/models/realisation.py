"""Conversions between state space and polynomials, and between the bilinear plane and z.

All of them are written to keep their digits: time is scaled by the fastest pole, so that no entry of a matrix
dwarfs the others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.errors import DesignError
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array
from design.models.transfer_function import TransferFunction


class StateSpace(NamedTuple):
    """x' = A x + B u, y = C x + D u: A (..., n, n), B (..., n, m), C (..., p, n), D (..., p, m).

    In z, the left side is the state one period later.
    """

    A: Array
    B: Array
    C: Array
    D: Array


def observer_form(den: Array, *nums: Array) -> StateSpace:
    """Return B systems with one output and one input for each numerator, all over ``den`` (B, n + 1).

    The output is the first state plus D u. No ``den`` may begin with 0.
    """
    n = den.shape[-1] - 1
    size = max(len(den), *(len(num) for num in nums))
    lead = den[:, :1]
    a = den[:, 1:] / lead
    b = np.stack(
        [np.broadcast_to(poly.add(num, np.zeros((1, n + 1))) / lead, (size, n + 1)) for num in nums], axis=-1
    )
    degrees = np.arange(1.0, n + 1.0)
    with np.errstate(divide="ignore"):
        speed = np.exp((np.log(np.abs(a)) / degrees).max(axis=-1, initial=-np.inf))[:, None]
    speed = np.where(speed > 0.0, speed, 1.0)
    A = np.zeros((len(den), n, n))
    if n:
        A[:, :, 0] = -a / speed**degrees * speed
        A[:, np.arange(n - 1), np.arange(1, n)] = speed
    B = (b[:, 1:] - a[:, :, None] * b[:, :1]) / (speed ** (degrees - 1.0))[:, :, None]
    return StateSpace(A, B, np.eye(1, n)[None], b[:, :1])


def realise(H: TransferFunction) -> StateSpace:
    """Return a state space of one transfer function."""
    return StateSpace(*(matrix[0] for matrix in observer_form(np.atleast_2d(H.den), np.atleast_2d(H.num))))


def transfer_function(H: StateSpace) -> TransferFunction:
    """Return the transfer function of a system with one input and one output."""
    A, B, C, D = H
    den = poly.from_roots(np.linalg.eigvals(A).astype(np.complex128)).real
    return TransferFunction(poly.add(numerator(A, B, C, den), D[0, 0] * den), den)


def numerator(A: Array, B: Array, C: Array, den: Array) -> Array:
    """Return the numerator (n,) of C (sI - A)^-1 B over ``den``, which must be det(sI - A).

    It is fitted to its values at points spread over all magnitudes of the poles, each relative to its own
    size. So slow and fast zeros are equally precise.
    """
    n = len(A)
    moduli = np.abs(np.linalg.eigvals(A))
    moduli = moduli[moduli > 1e-12 * moduli.max(initial=0.0)]
    if not len(moduli):
        moduli = np.ones(1)
    k = np.arange(8 * n)
    golden = 0.5 * np.sqrt(5.0) - 0.5
    radii = np.geomspace(0.2 * moduli.min(), 5.0 * moduli.max(), len(k))
    s = radii * np.exp(1j * np.pi * ((0.5 + k * golden) % 1.0))
    resolvents = np.linalg.solve(s[:, None, None] * np.eye(n) - A, np.broadcast_to(B, (len(s), n, 1)))
    values = (C @ resolvents)[:, 0, 0] * np.polyval(den, s)
    size = np.abs(values)
    if not size.all():
        return np.zeros(max(n, 1))
    rows = s[:, None] ** np.arange(n - 1, -1, -1) / size[:, None]
    columns = np.abs(rows).max(axis=0, initial=0.0)
    rows, right = rows / columns, values / size
    fitted = np.linalg.lstsq(
        np.concatenate([rows.real, rows.imag]), np.concatenate([right.real, right.imag]), rcond=None
    )[0]
    return np.asarray(fitted / columns)


def tustin(H: StateSpace, period_s: float) -> StateSpace:
    """Return a system of the bilinear plane in z, by Tustin's rule; for such a system the rule is exact."""
    A, B, C, D = H
    half, eye = 0.5 * period_s, np.eye(A.shape[-1])
    inverse = np.linalg.inv(eye - half * A)
    return StateSpace(
        (eye + half * A) @ inverse, period_s * inverse @ B, C @ inverse, D + half * C @ inverse @ B
    )


def inverse_tustin(H: StateSpace, period_s: float) -> StateSpace:
    """Return a system in z as a system of the bilinear plane, the inverse of :func:`tustin`.

    Raises DesignError if it has a pole at z = -1, which is at infinity in the bilinear plane.
    """
    A, B, C, D = H
    plus = np.eye(len(A)) + A
    if len(A) and np.linalg.norm(plus, -2) < 1e-12:
        raise DesignError(
            "the law has a pole at z = -1, which means infinite gain at half the sampling frequency; "
            "move this pole inside the unit circle"
        )
    inverse = np.linalg.inv(plus)
    return StateSpace(
        2.0 / period_s * (A - np.eye(len(A))) @ inverse,
        2.0 / period_s * inverse @ B,
        2.0 * C @ inverse,
        D - C @ inverse @ B,
    )
