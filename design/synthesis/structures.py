"""Controller and weight structures: parameters with boxes, and what they are as polynomials and as a law.

To add one, write a small class: ``parameters`` and ``controller`` (batched); ``law`` has a default, Tustin's
rule at the loop's period, which is also how every structure is verified in a sampled loop. No searching.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from design.errors import DesignError
from design.mathematics import polynomials as poly
from design.mathematics.polynomials import Array
from design.models.controller import Controller, one_degree_of_freedom
from design.models.realisation import observer_form, tustin
from design.models.sampling import to_z
from design.models.transfer_function import TransferFunction
from design.search.bounds import Parameter, SearchBounds
from hil.core.controller_file import Law, PidLaw, StateSpaceLaw, TransferFunctionLaw


@runtime_checkable
class Structure(Protocol):
    """What a structure must offer; ``controller`` gets values (n, p), one row a candidate."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is to be found."""
        ...

    def controller(self, values: Array) -> Controller:
        """Polynomials (n, k) in s of n candidates."""
        ...

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """What the daemon runs for one candidate."""
        ...


def setpoint_parameters(structure: Structure) -> tuple[str, ...]:
    """Parameters on which the feedback, and so every margin, does not depend: they shape setpoint steps.

    Found by trying, so that it is true of any structure.
    """
    random, box = np.random.default_rng(0), SearchBounds(structure.parameters)
    points = random.random((8, len(box)))
    num, den, _ = structure.controller(box.decode(points))
    unseen = []
    for i, name in enumerate(box.names):
        moved = points.copy()
        moved[:, i] = random.random(len(points))
        changed = structure.controller(box.decode(moved))
        if np.array_equal(num, changed.num) and np.array_equal(den, changed.den):
            unseen.append(name)
    return tuple(unseen)


class TustinLaw(ABC):
    """The default law: the structure's polynomials by Tustin's rule."""

    @abstractmethod
    def controller(self, values: Array) -> Controller:
        """Polynomials (n, k) in s of n candidates."""

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """What the daemon runs for one candidate."""
        return tustin_law(self.controller(np.array([values], dtype=float)), period_s)


def tustin_law(controller: Controller, period_s: float) -> Law:
    """One controller (1, k) by Tustin's rule: a transfer function, or a state space where that keeps digits.

    Beyond first order the coefficients in z of slow poles lie too close together; two degrees of freedom
    need a state space in any case.
    """
    num, den, num_r = (np.atleast_2d(p) for p in controller)
    one_degree = np.array_equal(num, num_r)
    if one_degree and den.shape[-1] <= 2:
        feedback = to_z(TransferFunction(num, den), period_s)
        return TransferFunctionLaw(num=feedback.num[0].tolist(), den=feedback.den[0].tolist())
    inputs = (num,) if one_degree else (num_r, -num)
    A, B, C, D = (matrix[0].tolist() for matrix in tustin(observer_form(den, *inputs), period_s))
    return StateSpaceLaw(A=A, B=B, C=C, D=D, inputs="e" if one_degree else "r, y")


def _box(*names: str, low: float = 0.01, high: float = 100.0) -> tuple[Parameter, ...]:
    return tuple(Parameter(name, low, high) for name in names)


@dataclass(frozen=True)
class Proportional(TustinLaw):
    """K = kp."""

    parameters: tuple[Parameter, ...] = _box("kp")

    def controller(self, values: Array) -> Controller:
        """See Structure."""
        return one_degree_of_freedom(values, np.ones_like(values))

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """See Structure."""
        return PidLaw(kp=float(values[0]), ki=0.0)


@dataclass(frozen=True)
class ProportionalIntegral(TustinLaw):
    """K = kp + ki/s."""

    parameters: tuple[Parameter, ...] = _box("kp", "ki")

    def controller(self, values: Array) -> Controller:
        """See Structure."""
        return one_degree_of_freedom(values, np.array([[1.0, 0.0]]))

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """See Structure."""
        kp, ki = map(float, values)
        return PidLaw(kp=kp, ki=ki)


@dataclass(frozen=True)
class ProportionalDerivative(TustinLaw):
    """K = kp + kd s/(tau_d s + 1)."""

    parameters: tuple[Parameter, ...] = _box("kp", "kd", "tau_d")

    def controller(self, values: Array) -> Controller:
        """See Structure."""
        kp, kd, tau_d = values.T
        return one_degree_of_freedom(_columns(kp * tau_d + kd, kp), _columns(tau_d, np.ones_like(kp)))

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """See Structure."""
        kp, kd, tau_d = map(float, values)
        return PidLaw(kp=kp, ki=0.0, kd=kd, tau_d=tau_d)


@dataclass(frozen=True)
class ProportionalIntegralDerivative(TustinLaw):
    """PID with filtered derivative, eq. (19): K = kp + ki/s + kd s/(tau_d s + 1)."""

    parameters: tuple[Parameter, ...] = _box("kp", "ki", "kd", "tau_d")

    def controller(self, values: Array) -> Controller:
        """See Structure."""
        return one_degree_of_freedom(*_pid(*values.T))

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """See Structure."""
        kp, ki, kd, tau_d = map(float, values)
        return PidLaw(kp=kp, ki=ki, kd=kd, tau_d=tau_d)


@dataclass(frozen=True)
class TwoDegreeOfFreedomPid(TustinLaw):
    """PID with setpoint weights: u = kp (b r - y) + ki/s (r - y) + kd s/(tau_d s + 1) (c r - y)."""

    parameters: tuple[Parameter, ...] = (
        *_box("kp", "ki", "kd", "tau_d"),
        Parameter("b", 0.0, 1.0, "linear"),
        Parameter("c", 0.0, 1.0, "linear"),
    )

    def controller(self, values: Array) -> Controller:
        """See Structure."""
        kp, ki, kd, tau_d, b, c = values.T
        num, den = _pid(kp, ki, kd, tau_d)
        return Controller(num, den, _pid(b * kp, ki, c * kd, tau_d)[0])

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """See Structure."""
        kp, ki, kd, tau_d, b, c = map(float, values)
        return PidLaw(kp=kp, ki=ki, kd=kd, tau_d=tau_d, b=b, c=c)


@dataclass(frozen=True)
class LeadLag(TustinLaw):
    """K = k (t1 s + 1)/(t2 s + 1): lead where t1 > t2, lag where t1 < t2."""

    parameters: tuple[Parameter, ...] = (*_box("k"), *_box("t1", "t2", low=0.001, high=100.0))

    def controller(self, values: Array) -> Controller:
        """See Structure."""
        k, t1, t2 = values.T
        return one_degree_of_freedom(_columns(k * t1, k), _columns(t2, np.ones_like(k)))


@dataclass(frozen=True)
class ProportionalIntegralLead(TustinLaw):
    """K = (kp + ki/s) (t1 s + 1)/(t2 s + 1)."""

    parameters: tuple[Parameter, ...] = (*_box("kp", "ki"), *_box("t1", "t2", low=0.001, high=100.0))

    def controller(self, values: Array) -> Controller:
        """See Structure."""
        kp, ki, t1, t2 = values.T
        one = np.ones_like(kp)
        num = poly.multiply(_columns(kp, ki), _columns(t1, one))
        return one_degree_of_freedom(num, poly.multiply(_columns(t2, one), np.array([[1.0, 0.0]])))


@dataclass(frozen=True)
class FreeTransferFunction(TustinLaw):
    """K of given orders, num (b_m … b_0) over s^i times a monic den (a_{n-1} … a_0); i integrators.

    Coefficients are searched in a linear coding by default, as signs are not known.
    """

    num_order: int
    den_order: int
    integrators: int = 0
    parameters: tuple[Parameter, ...] = field(default=())

    def __post_init__(self) -> None:
        if self.num_order > self.den_order + self.integrators:
            raise DesignError(
                f"free transfer function: num of order {self.num_order} over den of order "
                f"{self.den_order + self.integrators} is improper"
            )
        if not self.parameters:
            names = [f"b{k}" for k in range(self.num_order, -1, -1)]
            names += [f"a{k}" for k in range(self.den_order - 1, -1, -1)]
            object.__setattr__(self, "parameters", _box(*names, high=1e4))

    def controller(self, values: Array) -> Controller:
        """See Structure."""
        m = self.num_order + 1
        den = np.concatenate([np.ones((len(values), 1)), values[:, m:]], axis=-1)
        return one_degree_of_freedom(values[:, :m], np.pad(den, ((0, 0), (0, self.integrators))))


@dataclass(frozen=True)
class IntegralWeight(TustinLaw):
    """W1 = kw (s + a)/(s + b), eq. (3); b is small and fixed, for near-integral action."""

    b: float = 0.001
    parameters: tuple[Parameter, ...] = _box("kw", "a", high=50.0)

    def controller(self, values: Array) -> Controller:
        """See Structure."""
        kw, a = values.T
        return one_degree_of_freedom(_columns(kw, kw * a), np.array([[1.0, self.b]]))


STRUCTURES: Mapping[str, Structure] = {
    "p": Proportional(),
    "pi": ProportionalIntegral(),
    "pd": ProportionalDerivative(),
    "pid": ProportionalIntegralDerivative(),
    "pid-2dof": TwoDegreeOfFreedomPid(),
    "lead-lag": LeadLag(),
    "pi-lead": ProportionalIntegralLead(),
}
"""By the names that a design file uses; "free" takes orders, see FreeTransferFunction."""


def _pid(kp: Array, ki: Array, kd: Array, tau_d: Array) -> tuple[Array, Array]:
    zero = np.zeros_like(kp)
    return _columns(kp * tau_d + kd, kp + ki * tau_d, ki), _columns(tau_d, zero + 1.0, zero)


def _columns(*coefficients: Array) -> Array:
    return np.stack(coefficients, axis=-1)
