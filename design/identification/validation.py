"""A model beside data: free-running simulation, and the fit in per cent.

The simulation uses the measured input alone. Its initial state and the record's offset are fitted to the record,
for a record seldom begins at rest at 0; everything else is the model's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from design.identification.experiment import Experiment
from design.identification.models import DiscreteModel
from design.identification.simulation_error import Dynamics, SimulationError
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
    """100 (1 - |y - simulated| / |y - mean y|) over the samples that count. -inf where the simulation diverges."""

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
    simulated = np.full(len(experiment), np.nan)
    found = data.simulate(Dynamics(model.f, model.b[:, None], model.nk)) if data.residuals else None
    if found is None:
        return Comparison(experiment, simulated, -np.inf)
    # Not with the gain that fits this record best, but with the model's.
    for stretch, output in data.outputs(found.with_gains(np.ones(1))):
        simulated[stretch.start : stretch.start + len(stretch)] = output
    return Comparison(experiment, simulated, fit_percent(experiment, simulated))


def fit_percent(experiment: Experiment, simulated: Array) -> float:
    """100 (1 - |y - simulated| / |y - mean y|) over the samples that count, with their weights."""
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
    """Fit in per cent over several records together. Each record keeps its own mean."""
    if not comparisons:
        return float("nan")
    errors = spreads = 0.0
    for comparison in comparisons:
        if not np.isfinite(comparison.fit_percent):
            return -np.inf
        counts = comparison.experiment.observed & np.isfinite(comparison.simulated)
        weights, y = comparison.experiment.weights[counts], comparison.experiment.y[counts]
        errors += float(weights @ (y - comparison.simulated[counts]) ** 2)
        spreads += float(weights @ (y - np.average(y, weights=weights)) ** 2)
    return 100.0 * (1.0 - float(np.sqrt(errors / spreads))) if spreads else -np.inf
