"""Motions that no linear model makes: standing still, and drifting."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from design.identification.analysis.comparison import Comparison
from design.identification.checks.expectations import Expectations
from design.identification.checks.stalls import find_stalls
from design.identification.estimators.covariance import noise_autoregression
from design.identification.estimators.estimate import Estimate
from design.identification.estimators.simulation_error import Dynamics, SimulationError
from design.identification.findings import Finding, Kind, Severity
from design.identification.models.model import DiscreteModel
from design.identification.records.experiment import Experiment

MAX_STALLED = 0.005
"""Share of clear motions of the model in which the output may stand still."""
REFUSED_STALLED = 0.3
"""Share of clear motions of the model without a motion of the output above which no model is given."""
MAX_DRIFT = 0.1
"""Drift over a record, as a share of the output's standard deviation, above which it is reported."""
DRIFT_SIGNIFICANCE = 4.0
"""Number of standard deviations of the drift's estimate above which it counts as real."""


def check_stalls(comparisons: Sequence[Comparison], expected: Expectations) -> Iterator[Finding]:
    """Find friction, and end stops that are not known."""
    for comparison in comparisons:
        stalls = find_stalls(comparison)
        if stalls.between > MAX_STALLED:
            yield _friction(comparison.experiment, stalls.between)
        if stalls.at_extremes > MAX_STALLED and expected.travel is None:
            yield _unknown_stop(comparison.experiment, stalls.at_extremes)


def _friction(experiment: Experiment, share: float) -> Finding:
    refused = share > REFUSED_STALLED
    limit = 100.0 * (REFUSED_STALLED if refused else MAX_STALLED)
    return Finding(
        kind=Kind.FRICTION,
        severity=Severity.REFUSE if refused else Severity.WARN,
        record=experiment.name,
        signal=experiment.names.y,
        figure=100.0 * share,
        limit=limit,
        unit="%",
        text=(
            f"it stands still in {100.0 * share:.3g} % of the times at which the model moves clearly "
            f"(limit {limit:g} %): friction or a dead zone holds it"
        ),
        remedy="raise the amplitude",
    )


def _unknown_stop(experiment: Experiment, share: float) -> Finding:
    return Finding(
        kind=Kind.END_STOPS,
        severity=Severity.WARN,
        record=experiment.name,
        signal=experiment.names.y,
        figure=100.0 * share,
        limit=100.0 * MAX_STALLED,
        unit="%",
        text=(
            f"it stands still at its extreme values in {100.0 * share:.3g} % of the times at which the "
            f"model moves clearly (limit {100.0 * MAX_STALLED:g} %): an end stop, a converter at its "
            "limit, or friction"
        ),
        remedy=(
            "state the travel, so that these samples are left out; centre the axis, or lower the amplitude"
        ),
    )


def check_drift(estimate: Estimate) -> Iterator[Finding]:
    """Find a slope of the output that the input does not explain, with the dynamics that were found."""
    for experiment in estimate.experiments:
        measured = _drift(estimate.discrete, experiment)
        if measured is None:
            continue
        drift, std = measured
        limit = MAX_DRIFT * float(np.std(experiment.y[experiment.observed]))
        unit = experiment.names.y_unit
        if abs(drift) > DRIFT_SIGNIFICANCE * std and abs(drift) > limit:
            yield Finding(
                kind=Kind.DRIFT,
                severity=Severity.WARN,
                record=experiment.name,
                signal=experiment.names.y,
                figure=drift,
                limit=limit,
                unit=unit,
                text=f"it drifts by {drift:.3g} {unit} over the record (limit {limit:.3g} {unit})",
                remedy=(
                    "estimate the drift with the model, or look for its cause (temperature, supply, a leak)"
                ),
            )


def _drift(model: DiscreteModel, experiment: Experiment) -> tuple[float, float] | None:
    """Return the drift over the record, and its standard deviation. None where nothing can be simulated."""
    data = SimulationError(
        [experiment], skipped=max(0, model.nk + len(model.b) - 1 - model.order), drift=True
    )
    found = data.simulate(Dynamics(model.f, model.b[:, None], model.nk)) if data.residuals else None
    if found is None:
        return None
    parts = data.fitted(found)
    errors = [np.where(part.stretch.root_weight > 0.0, part.residual, 0.0) for part in parts]
    noise = noise_autoregression(errors)
    # Slow noise counts: what matters is the noise's spectrum at frequency 0.
    variance = (
        sum(float(e @ e) for e in errors) / data.residuals * noise.innovation / float(noise.a.sum()) ** 2
    )
    # A line from -0.5 to 0.5 has the mean square 1/12.
    return float(parts[0].common[1]), float(np.sqrt(12.0 * variance / data.residuals))
