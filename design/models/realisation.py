"""State space and polynomials, back and forth, and between the bilinear plane and z; without losing digits.

Realisations are in time scaled by the fastest pole, so that no entry dwarfs the others. No control
engineering.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.errors import DesignError
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array
from design.models.plant import TransferFunction, numerator


class StateSpace(NamedTuple):
    """x' = A x + B u, y = C x + D u: A (..., n, n), B (..., n, m), C (..., p, n), D (..., p, m)."""

    A: Array
    B: Array
    C: Array
    D: Array


def observer_form(den: Array, *nums: Array) -> StateSpace:
    """One output, one input a numerator, batched over (B, n + 1); the output is the first state plus D u."""
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
    """State space of one num/den."""
    return StateSpace(*(matrix[0] for matrix in observer_form(np.atleast_2d(H.den), np.atleast_2d(H.num))))


def transfer_function(H: StateSpace) -> TransferFunction:
    """num/den of a system with one input and one output."""
    A, B, C, D = H
    den = poly.from_roots(np.linalg.eigvals(A).astype(np.complex128)).real
    return TransferFunction(poly.add(numerator(A, B, C, den), D[0, 0] * den), den)


def sampled(H: StateSpace, period_s: float) -> StateSpace:
    """From the bilinear plane to z: Tustin's rule, exact for what is given there."""
    A, B, C, D = H
    half, eye = 0.5 * period_s, np.eye(A.shape[-1])
    inverse = np.linalg.inv(eye - half * A)
    return StateSpace(
        (eye + half * A) @ inverse, period_s * inverse @ B, C @ inverse, D + half * C @ inverse @ B
    )


def unsampled(H: StateSpace, period_s: float) -> StateSpace:
    """From z to the bilinear plane, the inverse of :func:`sampled`. Raises DesignError."""
    A, B, C, D = H
    plus = np.eye(len(A)) + A
    if len(A) and np.linalg.norm(plus, -2) < 1e-12:
        raise DesignError("the law has a pole at z = -1: infinite gain at half the sampling frequency")
    inverse = np.linalg.inv(plus)
    return StateSpace(
        2.0 / period_s * (A - np.eye(len(A))) @ inverse,
        2.0 / period_s * inverse @ B,
        2.0 * C @ inverse,
        D - C @ inverse @ B,
    )
