"""A continuous model that comes close to a sampled one that has no exact counterpart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from design.identification.estimators.continuous_fit import fit_continuous
from design.identification.models.held_discretisation import hold
from design.identification.models.inverse_hold import NoContinuousModelError
from design.identification.models.model import ContinuousModel, DiscreteModel
from design.identification.models.structures import ContinuousPoles
from design.identification.records.experiment import Experiment

_FITTED_SAMPLES = 3000
"""Length of the random inputs with which the model is found and judged."""


@dataclass(frozen=True)
class Nearest:
    """A continuous model that comes close to a sampled one that has no exact counterpart."""

    model: ContinuousModel
    fit_percent: float
    """Fit of its output to that of the sampled model, for white inputs held over a few samples."""


def nearest_continuous(model: DiscreteModel) -> Nearest:
    """Return a continuous model with a dead time whose sampled output is close to that of ``model``.

    It has the order of ``model`` without poles at 0, and is fitted to the response to a random input. Raises
    NoContinuousModelError for an unstable model.
    """
    if not model.stable:
        raise NoContinuousModelError(
            "the sampled model is unstable: no continuous model is fitted to its response"
        )
    order = max(int(np.count_nonzero(np.abs(model.poles_z) > 1e-3)), 1)
    dead_samples = model.nk + len(model.b) + len(model.f) - 2
    structure = ContinuousPoles(
        real=order % 2, pairs=order // 2, zeros=order - 1, max_dead_time_s=dead_samples * model.sample_time_s
    )
    random = np.random.default_rng(0)
    fitted, other = (np.repeat(random.choice([-1.0, 1.0], _FITTED_SAMPLES // held), held) for held in (2, 3))
    record = Experiment(fitted, model.simulate(fitted), model.sample_time_s, name="sampled model")
    found = fit_continuous([record], structure).continuous
    assert found is not None
    expected = model.simulate(other)
    error = np.linalg.norm(hold(found, model.sample_time_s).simulate(other) - expected)
    return Nearest(found, 100.0 * (1.0 - float(error / np.linalg.norm(expected - expected.mean()))))
