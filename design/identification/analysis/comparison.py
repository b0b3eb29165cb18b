"""A model beside data: free-running simulation, and the fit in per cent.

The simulation uses the measured input alone. Its initial state and the record's offset are fitted to the
record, for a record seldom begins at rest at 0; everything else is the model's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from design.identification.estimators.simulation_error import Dynamics, SimulationError
from design.identification.models.model import DiscreteModel
from design.identification.records.experiment import Experiment, Stretch
from design.mathematics.polynomials import Array

_INTEGRATOR = 1e-12
"""Distance from z = 1 at which a pole counts as an integrator."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A record and a model's free-running simulation of it, arrays (N,)."""

    experiment: Experiment
    simulated: Array
    """Model output with the fitted initial state and offset. NaN where no input is known."""
    fit_percent: float
    """100 (1 - |y - simulated| / |y - mean y|) over the samples that count. NaN for an unstable model."""
    input_percent: float
    """What the input explains: the fit with the best motion without an input in place of the mean of y."""

    @property
    def error(self) -> Array:
        """y - simulated (N,), NaN where a sample does not count."""
        return np.where(self.experiment.observed, self.experiment.y - self.simulated, np.nan)


def compare(model: DiscreteModel, experiment: Experiment, *, drift: bool = False) -> Comparison:
    """Simulate a record with a model. ``drift`` also fits a slope of the output."""
    poles = model.poles_z
    integrators = int(np.count_nonzero(np.abs(poles - 1.0) < _INTEGRATOR)) if len(poles) else 0
    data = SimulationError(
        [experiment],
        skipped=max(0, model.nk + len(model.b) - 1 - model.order),
        drift=drift,
        integrators=min(integrators, 1),
    )
    unstable = bool(len(poles)) and float(np.abs(poles).max()) > 1.0 + _INTEGRATOR
    # The factor of the numerator is 1: the model's own gain, not the one that fits this record best.
    found = (
        None
        if unstable or not data.residuals
        else data.simulate(Dynamics(model.f, model.b[:, None], model.nk))
    )
    if found is None:
        return Comparison(experiment, np.full(len(experiment), np.nan), np.nan, np.nan)
    simulated, free = (
        _placed(experiment, data.outputs(found.with_gains(np.array([gain])))) for gain in (1.0, 0.0)
    )
    fit = fit_percent(experiment, simulated)
    without_input = fit_percent(experiment, free)
    share = (100.0 - fit) / (100.0 - without_input) if without_input < 100.0 else np.inf
    return Comparison(experiment, simulated, fit, 100.0 * (1.0 - share))


def _placed(experiment: Experiment, outputs: list[tuple[Stretch, Array]]) -> Array:
    found = np.full(len(experiment), np.nan)
    for stretch, output in outputs:
        found[stretch.start : stretch.start + len(stretch)] = output
    return found


def fit_percent(experiment: Experiment, simulated: Array) -> float:
    """Return 100 (1 - |y - simulated| / |y - mean y|) over the samples that count, with their weights."""
    counts = experiment.observed & np.isfinite(simulated)
    root = np.sqrt(experiment.weights[counts])
    y = experiment.y[counts]
    if not len(y):
        return -np.inf
    spread = float(np.linalg.norm(root * (y - np.average(y, weights=root * root))))
    error = float(np.linalg.norm(root * (y - simulated[counts])))
    if spread == 0.0:
        return -np.inf if error > 0.0 else 100.0
    return 100.0 * (1.0 - error / spread)


def overall_fit(comparisons: Sequence[Comparison]) -> float:
    """Fit in per cent over several records together. Each keeps its own mean. NaN for an unstable model."""
    if not comparisons:
        return float("nan")
    errors = spreads = 0.0
    for comparison in comparisons:
        if np.isnan(comparison.fit_percent):
            return float("nan")
        counts = comparison.experiment.observed & np.isfinite(comparison.simulated)
        weights, y = comparison.experiment.weights[counts], comparison.experiment.y[counts]
        errors += float(weights @ (y - comparison.simulated[counts]) ** 2)
        spreads += float(weights @ (y - np.average(y, weights=weights)) ** 2)
    return 100.0 * (1.0 - float(np.sqrt(errors / spreads))) if spreads else -np.inf
