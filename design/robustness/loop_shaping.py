"""H-infinity loop shaping of one plant by Riccati equations, in state space.

This is the synthesis of McFarlane and Glover: eqs. (5) to (7), (A.1), (A.2) and (B.2) of the paper; Glover
and McFarlane 1989; Skogestad and Postlethwaite, Multivariable Feedback Control, 2nd ed., sec. 9.4. The plant
has one input and one output, and need not be strictly proper. A sampled plant is given in the bilinear plane
(see :mod:`design.models.plant`), which leaves every norm as it is. For many plants at once there is
:mod:`design.robustness.central_controller`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.errors import DesignError
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array
from design.models.realisation import StateSpace, realise
from design.models.transfer_function import TransferFunction


class LoopShaping(NamedTuple):
    """The controller K∞ for one shaped plant, its γ, and the smallest possible γ; negative feedback."""

    controller: StateSpace
    gamma: float
    gamma_opt: float


def shaped(G: TransferFunction, W: TransferFunction) -> TransferFunction:
    """Return the shaped plant Gs = G W1 of eq. (7), with W2 = 1."""
    return TransferFunction(poly.multiply(G.num, W.num), poly.multiply(G.den, W.den))


def riccati_solutions(Gs: StateSpace) -> tuple[Array, Array]:
    """Return the solutions Z of (A.1) and X of (A.2), each (n, n).

    Raises DesignError if the shaped plant has an uncontrollable or unobservable mode on the imaginary axis.
    """
    from scipy.linalg import solve_continuous_are

    A, B, C, D = Gs
    S = np.eye(B.shape[1]) + D.T @ D
    R = np.eye(C.shape[0]) + D @ D.T
    try:
        X = solve_continuous_are(A, B, C.T @ C, S, s=C.T @ D)
        Z = solve_continuous_are(A.T, C.T, B @ B.T, R, s=B @ D.T)
    except np.linalg.LinAlgError as error:
        raise DesignError(
            f"the shaped plant has an uncontrollable or unobservable mode on the imaginary axis: {error}"
        ) from None
    return np.asarray(Z), np.asarray(X)


def gamma_opt(Gs: StateSpace) -> float:
    """Return γ_opt = (1 + λ_max(XZ))^(1/2) of Appendix A; the optimal margin is ε_opt = 1/γ_opt."""
    Z, X = riccati_solutions(Gs)
    return _gamma_opt(Z, X)


def normalised_left_coprime_factors(Gs: StateSpace) -> StateSpace:
    """Return the stable factors [N M] of Appendix B, with Gs = M^-1 N and N N~ + M M~ = 1.

    The system has p outputs and m + p inputs for a plant of p outputs and m inputs.
    """
    A, B, C, D = Gs
    Z, _ = riccati_solutions(Gs)
    R = np.eye(C.shape[0]) + D @ D.T
    H = -(B @ D.T + Z @ C.T) @ np.linalg.inv(R)
    root = np.linalg.inv(np.linalg.cholesky(R))
    return StateSpace(A + H @ C, np.hstack([B + H @ D, H]), root @ C, np.hstack([root @ D, root]))


def check_factor(factor: float) -> None:
    """Raise DesignError unless ``factor``, in γ = factor γ_opt, is over 1."""
    if not factor > 1.0:
        raise DesignError(
            f"gamma_factor {factor} is not over 1: gamma must be over gamma_opt; choose a factor such as 1.1"
        )


def synthesise(Gs: TransferFunction, factor: float = 1.1) -> LoopShaping:
    """Return the controller K∞ of eq. (6) for γ = factor γ_opt.

    Raises DesignError unless ``factor`` is over 1: at 1 the formulas divide by zero.
    """
    check_factor(factor)
    plant = realise(Gs)
    A, B, C, D = plant
    Z, X = riccati_solutions(plant)
    optimum = _gamma_opt(Z, X)
    gamma = factor * optimum
    S = np.eye(B.shape[1]) + D.T @ D
    F = -np.linalg.solve(S, D.T @ C + B.T @ X)
    L = (1.0 - gamma**2) * np.eye(len(A)) + X @ Z
    gain = gamma**2 * np.linalg.solve(L.T, Z @ C.T)
    controller = StateSpace(A + B @ F + gain @ (C + D @ F), np.asarray(gain), -B.T @ X, D.T)
    return LoopShaping(controller, gamma, optimum)


def _gamma_opt(Z: Array, X: Array) -> float:
    if not len(Z):
        return 1.0
    return float(np.sqrt(1.0 + np.abs(np.linalg.eigvals(X @ Z)).max()))
