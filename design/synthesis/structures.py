"""Structures of controllers and weights: parameters with search ranges, polynomials, and control laws.

A structure is a small class with ``parameters``, ``controller`` (polynomials of many candidates at once) and
``law`` (what the gateway runs). :class:`TustinLaw` supplies ``law`` by Tustin's rule at the loop's period;
every structure is also verified that way in a sampled loop. To add a structure, write such a class and enter
it in :data:`STRUCTURES`, or name it in a design file as ``file.py:Class``.
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
    """Interface of a structure with p parameters; ``values`` (n, p) has one row for each candidate."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters with their search ranges, in the order of the columns of ``values``."""
        ...

    def controller(self, values: Array) -> Controller:
        """Return the polynomials (n, k) in s of n candidates."""
        ...

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """Return the law that the gateway runs for one candidate, at a period in seconds."""
        ...


def setpoint_parameters(structure: Structure) -> tuple[str, ...]:
    """Return the names of the parameters that shape the setpoint response only.

    The feedback, and with it every margin, does not depend on them. They are found by changing each parameter
    at a few random points, which works for any structure.
    """
    random, bounds = np.random.default_rng(0), SearchBounds(structure.parameters)
    points = random.random((8, len(bounds)))
    num, den, _ = structure.controller(bounds.decode(points))
    without_effect = []
    for i, name in enumerate(bounds.names):
        moved = points.copy()
        moved[:, i] = random.random(len(points))
        changed = structure.controller(bounds.decode(moved))
        if np.array_equal(num, changed.num) and np.array_equal(den, changed.den):
            without_effect.append(name)
    return tuple(without_effect)


def structure_name(structure: Structure) -> str:
    """Return the name that a design file has for a structure; a user's own has the name of its class."""
    return _NAMES.get(type(structure), type(structure).__name__)


class TustinLaw(ABC):
    """Base class that derives the law from the structure's polynomials by Tustin's rule."""

    @abstractmethod
    def controller(self, values: Array) -> Controller:
        """Return the polynomials (n, k) in s of n candidates."""

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """Return the law that the gateway runs for one candidate, at a period in seconds."""
        return tustin_law(self.controller(np.array([values], dtype=float)), period_s)


def tustin_law(controller: Controller, period_s: float) -> Law:
    """Sample one controller (1, k) by Tustin's rule.

    The law is a transfer function up to first order, and a state space beyond, since the coefficients in z of
    several slow poles lose too many digits. Two degrees of freedom always need a state space.
    """
    num, den, num_r = (np.atleast_2d(p) for p in controller)
    one_degree = np.array_equal(num, num_r)
    if one_degree and den.shape[-1] <= 2:
        feedback = to_z(TransferFunction(num, den), period_s)
        return TransferFunctionLaw(num=feedback.num[0].tolist(), den=feedback.den[0].tolist())
    inputs = (num,) if one_degree else (num_r, -num)
    A, B, C, D = (matrix[0].tolist() for matrix in tustin(observer_form(den, *inputs), period_s))
    return StateSpaceLaw(A=A, B=B, C=C, D=D, inputs="e" if one_degree else "r, y")


def _parameters(*names: str, low: float = 0.01, high: float = 100.0) -> tuple[Parameter, ...]:
    return tuple(Parameter(name, low, high) for name in names)


@dataclass(frozen=True)
class Proportional(TustinLaw):
    """K = kp."""

    parameters: tuple[Parameter, ...] = _parameters("kp")

    def controller(self, values: Array) -> Controller:
        """See :class:`Structure`."""
        return one_degree_of_freedom(values, np.ones_like(values))

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """See :class:`Structure`."""
        return PidLaw(kp=float(values[0]), ki=0.0)


@dataclass(frozen=True)
class ProportionalIntegral(TustinLaw):
    """K = kp + ki/s."""

    parameters: tuple[Parameter, ...] = _parameters("kp", "ki")

    def controller(self, values: Array) -> Controller:
        """See :class:`Structure`."""
        return one_degree_of_freedom(values, np.array([[1.0, 0.0]]))

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """See :class:`Structure`."""
        kp, ki = map(float, values)
        return PidLaw(kp=kp, ki=ki)


@dataclass(frozen=True)
class ProportionalDerivative(TustinLaw):
    """K = kp + kd s/(tau_d s + 1)."""

    parameters: tuple[Parameter, ...] = _parameters("kp", "kd", "tau_d")

    def controller(self, values: Array) -> Controller:
        """See :class:`Structure`."""
        kp, kd, tau_d = values.T
        return one_degree_of_freedom(_columns(kp * tau_d + kd, kp), _columns(tau_d, np.ones_like(kp)))

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """See :class:`Structure`."""
        kp, kd, tau_d = map(float, values)
        return PidLaw(kp=kp, ki=0.0, kd=kd, tau_d=tau_d)


@dataclass(frozen=True)
class ProportionalIntegralDerivative(TustinLaw):
    """PID with filtered derivative, eq. (19): K = kp + ki/s + kd s/(tau_d s + 1)."""

    parameters: tuple[Parameter, ...] = _parameters("kp", "ki", "kd", "tau_d")

    def controller(self, values: Array) -> Controller:
        """See :class:`Structure`."""
        return one_degree_of_freedom(*_pid(*values.T))

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """See :class:`Structure`."""
        kp, ki, kd, tau_d = map(float, values)
        return PidLaw(kp=kp, ki=ki, kd=kd, tau_d=tau_d)


@dataclass(frozen=True)
class TwoDegreeOfFreedomPid(TustinLaw):
    """PID with setpoint weights: u = kp (b r - y) + ki/s (r - y) + kd s/(tau_d s + 1) (c r - y)."""

    parameters: tuple[Parameter, ...] = (
        *_parameters("kp", "ki", "kd", "tau_d"),
        Parameter("b", 0.0, 1.0, "linear"),
        Parameter("c", 0.0, 1.0, "linear"),
    )

    def controller(self, values: Array) -> Controller:
        """See :class:`Structure`."""
        kp, ki, kd, tau_d, b, c = values.T
        num, den = _pid(kp, ki, kd, tau_d)
        return Controller(num, den, _pid(b * kp, ki, c * kd, tau_d)[0])

    def law(self, values: Sequence[float], period_s: float) -> Law:
        """See :class:`Structure`."""
        kp, ki, kd, tau_d, b, c = map(float, values)
        return PidLaw(kp=kp, ki=ki, kd=kd, tau_d=tau_d, b=b, c=c)


@dataclass(frozen=True)
class LeadLag(TustinLaw):
    """K = k (t1 s + 1)/(t2 s + 1): lead where t1 > t2, lag where t1 < t2."""

    parameters: tuple[Parameter, ...] = (*_parameters("k"), *_parameters("t1", "t2", low=0.001, high=100.0))

    def controller(self, values: Array) -> Controller:
        """See :class:`Structure`."""
        k, t1, t2 = values.T
        return one_degree_of_freedom(_columns(k * t1, k), _columns(t2, np.ones_like(k)))


@dataclass(frozen=True)
class ProportionalIntegralLead(TustinLaw):
    """K = (kp + ki/s) (t1 s + 1)/(t2 s + 1)."""

    parameters: tuple[Parameter, ...] = (
        *_parameters("kp", "ki"),
        *_parameters("t1", "t2", low=0.001, high=100.0),
    )

    def controller(self, values: Array) -> Controller:
        """See :class:`Structure`."""
        kp, ki, t1, t2 = values.T
        one = np.ones_like(kp)
        num = poly.multiply(_columns(kp, ki), _columns(t1, one))
        return one_degree_of_freedom(num, poly.multiply(_columns(t2, one), np.array([[1.0, 0.0]])))


@dataclass(frozen=True)
class FreeTransferFunction(TustinLaw):
    """K with freely chosen coefficients: num (b_m … b_0) over s^i times a monic den (a_{n-1} … a_0).

    ``integrators`` is i. All coefficients are positive in the default search ranges, 0.01 to 10000 in
    logarithms; a design file gives others.
    """

    num_order: int
    den_order: int
    integrators: int = 0
    parameters: tuple[Parameter, ...] = field(default=())

    def __post_init__(self) -> None:
        if self.num_order > self.den_order + self.integrators:
            raise DesignError(
                f"controller.orders: num of order {self.num_order} over den of order "
                f"{self.den_order + self.integrators} (integrators included) is improper; a controller "
                "cannot answer before its input: raise den or integrators, or lower num"
            )
        if not self.parameters:
            names = [f"b{k}" for k in range(self.num_order, -1, -1)]
            names += [f"a{k}" for k in range(self.den_order - 1, -1, -1)]
            object.__setattr__(self, "parameters", _parameters(*names, high=1e4))

    def controller(self, values: Array) -> Controller:
        """See :class:`Structure`."""
        m = self.num_order + 1
        den = np.concatenate([np.ones((len(values), 1)), values[:, m:]], axis=-1)
        return one_degree_of_freedom(values[:, :m], np.pad(den, ((0, 0), (0, self.integrators))))


@dataclass(frozen=True)
class IntegralWeight(TustinLaw):
    """W1 = kw (s + a)/(s + b), eq. (3); the small, fixed b in rad/s makes it almost an integrator."""

    b: float = 0.001
    parameters: tuple[Parameter, ...] = _parameters("kw", "a", high=50.0)

    def controller(self, values: Array) -> Controller:
        """See :class:`Structure`."""
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
"""Shipped structures by the names that a design file uses.

The structure "free" is missing, since it is made from its orders; see :class:`FreeTransferFunction`.
"""

_NAMES: Mapping[type, str] = {
    **{type(structure): name for name, structure in STRUCTURES.items()},
    FreeTransferFunction: "free",
    IntegralWeight: "integral",
}


def _pid(kp: Array, ki: Array, kd: Array, tau_d: Array) -> tuple[Array, Array]:
    zero = np.zeros_like(kp)
    return _columns(kp * tau_d + kd, kp + ki * tau_d, ki), _columns(tau_d, zero + 1.0, zero)


def _columns(*coefficients: Array) -> Array:
    return np.stack(coefficients, axis=-1)
