"""Intervals of gain, poles, zeros, modes and dead time of a model, and of its frequency response.

The covariance of the parameters is carried over by the delta method: a quantity is differentiated along the
principal axes of the covariance, each by a small share of its own standard deviation. Intervals are those
of the normal distribution that large samples tend to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from design.identification.estimators.estimate import Estimate, Models, Parameters
from design.identification.models.inverse_hold import NoContinuousModelError, invert_hold
from design.identification.models.model import ContinuousModel, logarithms
from design.mathematics.polynomials import Array, ComplexArray

LEVEL = 0.95
"""Confidence level of an interval if none is asked for."""
_STEP = 0.02
"""Step of the differences, in standard deviations along a principal axis."""
_MAX_STEP = 0.05
"""Largest step of a parameter, as a share of 1 plus its modulus. The logarithm of a pole that the record does
not show has a standard deviation of hundreds; a full step would overflow."""


@dataclass(frozen=True)
class Quantity:
    """A real number with its standard deviation."""

    value: float
    std: float

    def interval(self, level: float = LEVEL) -> tuple[float, float]:
        """Return the confidence interval at this level."""
        reach = NormalDist().inv_cdf(0.5 + 0.5 * level) * self.std
        return self.value - reach, self.value + reach


@dataclass(frozen=True, eq=False)
class Root:
    """A pole or zero in rad/s, with the covariance (2, 2) of its real and imaginary part."""

    value: complex
    covariance: Array

    @property
    def std(self) -> float:
        """Standard deviation of the distance from the true value."""
        return float(np.sqrt(np.trace(self.covariance)))

    def ellipse(self, level: float = LEVEL, points: int = 60) -> ComplexArray:
        """Return the outline (points,) of the confidence region. It is a line for a real root."""
        values, axes = np.linalg.eigh(self.covariance)
        reach = np.sqrt(-2.0 * np.log(1.0 - level) * np.maximum(values, 0.0))
        angle = np.linspace(0.0, 2.0 * np.pi, points)
        around = axes @ (reach[:, None] * np.stack([np.cos(angle), np.sin(angle)]))
        return np.asarray(self.value + around[0] + 1j * around[1])


@dataclass(frozen=True)
class Mode:
    """An oscillatory pole pair: natural frequency in rad/s and damping ratio."""

    natural_frequency_rad_s: Quantity
    damping: Quantity


@dataclass(frozen=True, eq=False)
class Properties:
    """What a model says about the plant, with standard deviations."""

    gain: Quantity | None
    """Static gain. None for a model with an integrator."""
    velocity_gain: Quantity | None
    """Static gain times the slowest pole, per s and input unit. None without a slow real pole."""
    poles: tuple[Root, ...]
    """Continuous poles, slowest first."""
    zeros: tuple[Root, ...] | None
    """Zeros of the continuous model. None if the sampled model has no continuous counterpart."""
    modes: tuple[Mode, ...]
    dead_time_s: Quantity
    """Dead time in the model. Whole samples of a sampled structure have a standard deviation of 0."""


@dataclass(frozen=True, eq=False)
class ResponseBand:
    """Frequency response with its standard deviations, arrays (k,)."""

    omega_rad_s: Array
    response: ComplexArray
    magnitude_std: Array
    """Standard deviation of the magnitude, as a share of it."""
    phase_std_rad: Array


def propagate(parameters: Parameters, function: Callable[[Models], Array]) -> tuple[Array, Array]:
    """Return values (k,) of a function of the models, and their covariance (k, k)."""
    values, axes = np.linalg.eigh(_scaled(parameters.covariance))
    sizes = np.sqrt(np.maximum(np.diag(parameters.covariance), 0.0))
    factor = sizes[:, None] * axes * np.sqrt(np.maximum(values, 0.0))
    at_estimate = function(parameters.build(parameters.values))
    slopes = []
    for axis in factor.T:
        if not axis.any():
            continue
        step = min(_STEP, _MAX_STEP / float(np.max(np.abs(axis) / (1.0 + np.abs(parameters.values)))))
        ahead, behind = (
            function(parameters.build(parameters.values + sign * step * axis)) for sign in (1.0, -1.0)
        )
        slopes.append((ahead - behind) / (2.0 * step))
    J = np.array(slopes).reshape(-1, len(at_estimate))
    return at_estimate, J.T @ J


def properties(estimate: Estimate) -> Properties:
    """Return the gain, poles, zeros, modes and dead time of an estimate, with standard deviations."""
    models = estimate.parameters.build(estimate.parameters.values)
    poles = _poles(models)
    poles = poles[np.argsort(np.abs(poles), kind="stable")]
    continuous = _continuous(models)
    zeros = np.zeros(0, dtype=np.complex128) if continuous is None else continuous.zeros
    integrating = bool((np.abs(poles) == 0.0).any())
    slowest = bool(len(poles)) and poles[0].imag == 0.0

    def all_of(candidate: Models) -> Array:
        found = _matched(_poles(candidate), poles)
        other = _continuous(candidate) if len(zeros) else None
        roots = np.concatenate([found, zeros if other is None else _matched(other.zeros, zeros)])
        gain, velocity = _gains(candidate, found)
        dead = _dead_time_s(candidate)
        return np.concatenate(
            [[gain, velocity, dead], np.abs(found), -found.real / np.abs(found), roots.real, roots.imag]
        )

    with np.errstate(divide="ignore", invalid="ignore"):
        values, covariance = propagate(estimate.parameters, all_of)
    std = np.sqrt(np.diag(covariance))
    n, count = len(poles), len(poles) + len(zeros)

    def quantity(i: int) -> Quantity:
        return Quantity(float(values[i]), float(std[i]))

    first = 3 + 2 * n
    roots = []
    for i, value in enumerate(np.concatenate([poles, zeros])):
        rows = [first + i, first + count + i]
        roots.append(Root(complex(value), covariance[np.ix_(rows, rows)]))
    modes = [Mode(quantity(3 + i), quantity(3 + n + i)) for i in range(n) if poles[i].imag > 0.0]
    return Properties(
        gain=None if integrating else quantity(0),
        velocity_gain=quantity(1) if slowest else None,
        poles=tuple(roots[:n]),
        zeros=None if continuous is None else tuple(roots[n:]),
        modes=tuple(modes),
        dead_time_s=quantity(2),
    )


def coefficients(estimate: Estimate) -> tuple[tuple[str, ...], Array, Array]:
    """Return names, values (k,) and covariance (k, k) of the sampled model's coefficients.

    They are coefficients in powers of z^-1.

    They are b, f without its leading 1, and those of c and d, for ARX and ARMAX those of c alone.
    """
    model = estimate.discrete
    shared_noise = model.d is model.f

    def all_of(models: Models) -> Array:
        parts = [models.discrete.b, models.discrete.f[1:], models.discrete.c[1:]]
        return np.concatenate(parts if shared_noise else [*parts, models.discrete.d[1:]])

    lists = [("b", len(model.b), 0), ("f", len(model.f), 1), ("c", len(model.c), 1)]
    lists += [] if shared_noise else [("d", len(model.d), 1)]
    names = tuple(f"{letter}{i}" for letter, count, first in lists for i in range(first, count))
    values, covariance = propagate(estimate.parameters, all_of)
    return names, values, covariance


def response_band(estimate: Estimate, omega_rad_s: ArrayLike) -> ResponseBand:
    """Return the frequency response of the sampled model, hold included, with its uncertainty."""
    omega = np.asarray(omega_rad_s, dtype=float)

    def response(models: Models) -> Array:
        G = models.discrete.at(omega)
        return np.concatenate([G.real, G.imag])

    values, covariance = propagate(estimate.parameters, response)
    k = len(omega)
    G = values[:k] + 1j * values[k:]
    diagonal = np.diag(covariance)
    real, imaginary, mixed = diagonal[:k], diagonal[k:], np.diag(covariance[:k, k:])
    size = np.maximum(np.abs(G), np.finfo(float).tiny)
    x, y = G.real / size, G.imag / size
    along = x * x * real + y * y * imaginary + 2.0 * x * y * mixed
    across = y * y * real + x * x * imaginary - 2.0 * x * y * mixed
    return ResponseBand(
        omega, G, np.sqrt(np.maximum(along, 0.0)) / size, np.sqrt(np.maximum(across, 0.0)) / size
    )


def _scaled(covariance: Array) -> Array:
    """Return the correlation matrix, 0 in rows of a parameter without variance."""
    sizes = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    return covariance / sizes / sizes[:, None]


def _poles(models: Models) -> ComplexArray:
    if models.continuous is not None:
        return models.continuous.poles
    return logarithms(models.discrete.f, models.discrete.sample_time_s)


def _continuous(models: Models) -> ContinuousModel | None:
    if models.continuous is not None:
        return models.continuous
    try:
        return invert_hold(models.discrete)
    except NoContinuousModelError:
        return None


def _dead_time_s(models: Models) -> float:
    if models.continuous is not None:
        return models.continuous.dead_time_s
    return max(models.discrete.nk - 1, 0) * models.discrete.sample_time_s


def _gains(models: Models, poles: ComplexArray) -> tuple[float, float]:
    """Return the static gain, and its product with the first pole, which stays finite for an integrator."""
    gain = models.discrete.gain
    if not len(poles):
        return gain, np.nan
    if models.continuous is not None:
        others = np.prod(-poles[1:]).real if len(poles) > 1 else 1.0
        return gain, float(models.continuous.num[-1] / others)
    return gain, gain * abs(poles[0])


def _matched(found: ComplexArray, nominal: ComplexArray) -> ComplexArray:
    """Return the roots in the order of the nominal ones that they are nearest to."""
    remaining = list(found)
    ordered = []
    for value in nominal:
        if not remaining:
            ordered.append(complex(value))
            continue
        nearest = int(np.argmin(np.abs(np.array(remaining) - value)))
        ordered.append(complex(remaining.pop(nearest)))
    return np.array(ordered, dtype=np.complex128)
