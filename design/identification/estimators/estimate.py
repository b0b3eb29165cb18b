"""What an estimator returns: a model, its uncertainty, and what the data left unexplained."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from design.identification.models.model import ContinuousModel, DiscreteModel
from design.identification.models.structures import Structure
from design.identification.records.experiment import Experiment
from design.mathematics.polynomials import Array


class Models(NamedTuple):
    """A sampled model and, where the structure is continuous, the model that it is sampled from."""

    discrete: DiscreteModel
    continuous: ContinuousModel | None = None


@dataclass(frozen=True, eq=False)
class Parameters:
    """Estimated parameters with their covariance.

    They are coordinates in which a model is well conditioned: coefficients in powers of 1 - z^-1, or
    logarithms. ``build`` turns a vector of them into the models.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    build: Callable[[Array], Models]


class Offsets(NamedTuple):
    """What was estimated of an experiment beside the model."""

    output_offset: float | None
    """Output at which the model rests for an input of 0. None for a plant with an integrator."""
    input_offset: float | None
    """Input that keeps the model's output at rest at 0 or, with an integrator, anywhere."""
    drift_per_s: float
    """Slope of the output that no input explains. 0 where it was not estimated."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """A model of one structure, fitted to one or more experiments."""

    structure: Structure
    parameters: Parameters
    experiments: tuple[Experiment, ...]
    """The data it was fitted to, with the transport delay removed if that was asked for."""
    residuals: tuple[Array, ...]
    """Prediction errors e (N,) of each experiment, NaN where a sample does not count."""
    offsets: tuple[Offsets, ...]
    noise_std: float
    """Standard deviation of e, corrected for the number of unknowns."""
    noise_order: int
    """Order of the autoregression that describes e. 0 means that e is white."""
    cost: float
    """Sum of squares of the weighted e."""
    samples: int
    """Number of output samples that counted."""
    unknowns: int
    """Number of all estimated values: parameters, initial states, offsets and drifts."""
    converged: bool
    at_bound: tuple[str, ...] = ()
    """Names of the parameters that a search bound holds."""

    @property
    def discrete(self) -> DiscreteModel:
        """The sampled model."""
        return self.parameters.build(self.parameters.values).discrete

    @property
    def continuous(self) -> ContinuousModel | None:
        """The continuous model that was fitted. None for the sampled structures; see ``inverse_hold``."""
        return self.parameters.build(self.parameters.values).continuous

    @property
    def aic(self) -> float:
        """Akaike's criterion N log(cost / N) + 2 d for d unknowns. A smaller value is better."""
        return self._criterion(2.0)

    @property
    def bic(self) -> float:
        """Schwarz's criterion N log(cost / N) + d log N for d unknowns. A smaller value is better."""
        return self._criterion(float(np.log(self.samples)))

    def _criterion(self, price: float) -> float:
        floor = np.finfo(float).tiny
        return self.samples * float(np.log(max(self.cost / self.samples, floor))) + price * self.unknowns


def offsets_of(
    discrete: DiscreteModel, experiments: Sequence[Experiment], common: dict[int, Array], integrators: int
) -> tuple[Offsets, ...]:
    """Return the offsets, from the powers of the relative time that were fitted to each experiment."""
    found = []
    for index, experiment in enumerate(experiments):
        values = common.get(index)
        if values is None:
            found.append(Offsets(None, None, 0.0))
            continue
        duration = max(len(experiment) - 1, 1) * experiment.sample_time_s
        slope = float(values[1]) / duration if len(values) > 1 else 0.0
        if integrators:
            # Behind an integrator a constant input is a ramp: its slope over the velocity gain.
            velocity = (
                float(np.sum(discrete.b) / _without_integrator(discrete.f).sum()) / experiment.sample_time_s
            )
            found.append(Offsets(None, -float(values[0]) / duration / velocity, 0.0))
            continue
        gain = discrete.gain
        balance = -float(values[0]) / gain if np.isfinite(gain) and gain else None
        found.append(Offsets(float(values[0]), balance, slope))
    return tuple(found)


def _without_integrator(f: Array) -> Array:
    """Return f / (1 - z^-1) for f with a root at z = 1."""
    return np.cumsum(f)[:-1]
