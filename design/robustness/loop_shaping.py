"""H-infinity loop shaping by the book: Appendices A and B, and McFarlane-Glover synthesis, in state space.

Eqs. (5) to (7), (A.1), (A.2), (B.2); Glover and McFarlane 1989; Skogestad and Postlethwaite, sec. 9.4. Any
plant with one input and one output, strictly proper or not; sampled ones in the bilinear plane (``plant``),
which keeps every norm. For one plant at a time; ``central_controller`` has the same for thousands.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.errors import DesignError
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array
from design.models.plant import TransferFunction
from design.models.realisation import StateSpace, realise


class LoopShaping(NamedTuple):
    """A synthesis for one shaped plant: K∞ for negative feedback, γ asked for, and the best there is."""

    controller: StateSpace
    gamma: float
    gamma_opt: float


def shaped(G: TransferFunction, W: TransferFunction) -> TransferFunction:
    """Gs = G W1, eq. (7) with W2 = 1."""
    return TransferFunction(poly.multiply(G.num, W.num), poly.multiply(G.den, W.den))


def riccati_solutions(Gs: StateSpace) -> tuple[Array, Array]:
    """Z of (A.1) and X of (A.2), each (n, n)."""
    from scipy.linalg import solve_continuous_are

    A, B, C, D = Gs
    S = np.eye(B.shape[1]) + D.T @ D
    R = np.eye(C.shape[0]) + D @ D.T
    try:
        X = solve_continuous_are(A, B, C.T @ C, S, s=C.T @ D)
        Z = solve_continuous_are(A.T, C.T, B @ B.T, R, s=B @ D.T)
    except np.linalg.LinAlgError as error:
        raise DesignError(
            f"the shaped plant has an uncontrollable or unobservable mode on the axis: {error}"
        ) from None
    return np.asarray(Z), np.asarray(X)


def gamma_opt(Gs: StateSpace) -> float:
    """γ_opt = (1 + λ_max(XZ))^(1/2), Appendix A; ε_opt is its inverse."""
    Z, X = riccati_solutions(Gs)
    return _gamma_opt(Z, X)


def normalised_left_coprime_factors(Gs: StateSpace) -> StateSpace:
    """[N M] of Appendix B: Gs = M^-1 N with N N~ + M M~ = 1, both stable. Outputs p, inputs m + p."""
    A, B, C, D = Gs
    Z, _ = riccati_solutions(Gs)
    R = np.eye(C.shape[0]) + D @ D.T
    H = -(B @ D.T + Z @ C.T) @ np.linalg.inv(R)
    root = np.linalg.inv(np.linalg.cholesky(R))
    return StateSpace(A + H @ C, np.hstack([B + H @ D, H]), root @ C, np.hstack([root @ D, root]))


def check_factor(factor: float) -> None:
    """Refuse γ = factor γ_opt unless it is over γ_opt. Raises DesignError."""
    if not factor > 1.0:
        raise DesignError(f"gamma must be over gamma_opt: factor {factor} is not over 1")


def synthesise(Gs: TransferFunction, factor: float = 1.1) -> LoopShaping:
    """K∞ of eq. (6) for γ = factor γ_opt; factor must be over 1 (at 1 the formulas divide by zero)."""
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
