"""The search for dynamics as a least-squares problem, whatever parameters describe them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from design.identification.estimators.pole_sections import PoleSections
from design.identification.estimators.simulation_error import Dynamics, Simulated, SimulationError, Slopes
from design.identification.models.difference_basis import basis
from design.identification.models.model import rooted
from design.mathematics.polynomials import Array


class Parametrisation(Protocol):
    """Dynamics as a function of p parameters within bounds."""

    @property
    def max_step(self) -> float:
        """Largest change of a parameter in one step of a search."""
        ...

    def bounds(self, samples: int) -> tuple[Array, Array]:
        """Return the lower and upper bounds (p,) of θ for a record of this many samples."""
        ...

    def dynamics(self, theta: Array) -> Dynamics | None:
        """Return the dynamics at θ (p,). None where they are not admissible."""
        ...

    def slopes(self, theta: Array) -> Slopes:
        """Return the derivatives of the dynamics by θ."""
        ...


@dataclass(frozen=True)
class Candidate:
    """Parameters and their simulation over the data."""

    theta: Array
    simulated: Simulated

    @property
    def cost(self) -> float:
        """Sum of squared, weighted simulation errors."""
        return self.simulated.cost


class DynamicsProblem:
    """Simulation error as a function of θ: a Problem for ``levenberg_marquardt.minimise``."""

    def __init__(self, data: SimulationError, parameters: Parametrisation) -> None:
        self.data, self.parameters = data, parameters
        self.longest = max((len(stretch) for stretch in data.stretches), default=1)
        self.sample_time_s = data.experiments[0].sample_time_s
        self.lower, self.upper = parameters.bounds(self.longest)
        self.max_step = parameters.max_step
        self.residuals, self.scale = data.residuals, data.scale

    def trial(self, theta: Array) -> Candidate | None:
        """Simulate the model at θ over the data. None where θ is not admissible."""
        dynamics = self.parameters.dynamics(theta)
        simulated = None if dynamics is None else self.data.simulate(dynamics)
        return None if simulated is None else Candidate(theta, simulated)

    def linearised(self, trial: Candidate) -> tuple[Array, Array]:
        """Return J (r, p) and e (r,): the residuals near the trial are e - J δ, up to an orthogonal part."""
        return eliminated(*self.data.linearised(trial.simulated, self.parameters.slopes(trial.theta)))


@dataclass(frozen=True)
class FreeCoefficients:
    """F and B by their own coefficients, in powers of 1 - z^-1; F stable. Any stable F can be reached."""

    nb: int
    nf: int
    lag: int
    max_step: float = np.inf

    def bounds(self, samples: int) -> tuple[Array, Array]:
        """Return the lower and upper bounds (p,) of θ for a record of this many samples."""
        return np.full(self.nf, -np.inf), np.full(self.nf, np.inf)

    def dynamics(self, theta: Array) -> Dynamics | None:
        """Return the dynamics at θ (p,). None where they are not admissible."""
        f = np.concatenate([[1.0], basis(self.nf) @ theta])
        if not (np.abs(rooted(f)) < 1.0).all():
            return None
        return Dynamics(f, basis(self.nb), self.lag)

    def slopes(self, theta: Array) -> Slopes:
        """Return the derivatives of the dynamics by θ."""
        return Slopes(basis(self.nf), np.zeros((self.nb, self.nb, self.nf)))


@dataclass(frozen=True)
class FreeNumerator:
    """F by its poles in logarithms; B free."""

    sections: PoleSections
    nb: int
    lag: int
    max_step: float = 2.0

    def bounds(self, samples: int) -> tuple[Array, Array]:
        """Return the lower and upper bounds (p,) of θ for a record of this many samples."""
        return self.sections.bounds(samples)

    def dynamics(self, theta: Array) -> Dynamics:
        """Return the dynamics at θ (p,). None where they are not admissible."""
        return Dynamics(self.sections.f(theta), np.eye(self.nb), self.lag)

    def slopes(self, theta: Array) -> Slopes:
        """Return the derivatives of the dynamics by θ."""
        return Slopes(self.sections.f_and_slopes(theta)[1][1:], np.zeros((self.nb, self.nb, len(theta))))


def eliminated(A: Array, J: Array, e: Array) -> tuple[Array, Array]:
    """Return J and e without the part that the columns of A, which enter linearly, explain."""
    sizes = np.linalg.norm(A, axis=0)
    Q = np.linalg.qr(A / np.where(sizes > 0.0, sizes, 1.0))[0]
    return J - Q @ (Q.T @ J), e - Q @ (Q.T @ e)
