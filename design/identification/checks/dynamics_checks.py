"""Dynamics that a model lacks: a dead time, or more poles and zeros."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from design.identification.analysis.residuals import ResidualAnalysis
from design.identification.estimators.dynamics_problem import DynamicsProblem, FreeNumerator
from design.identification.estimators.estimate import Estimate
from design.identification.estimators.levenberg_marquardt import minimise
from design.identification.estimators.pole_sections import PoleSections, from_poles
from design.identification.estimators.simulation_error import SimulationError
from design.identification.findings import Finding, Kind, Severity
from design.identification.models.model import logarithms

MAX_DEAD_SAMPLES = 12
"""Number of delays that are tried."""
SAMPLES = 12_000
"""Number of samples of each experiment on which delays are tried."""
MIN_IMPROVEMENT = 0.02
"""Share of the simulation error's variance that a delay must remove to be suggested."""
NEARLY_BEST = 0.1
"""Share of the largest improvement that a shorter delay may leave."""
NOTED_LOST_PERCENT = 1.0
"""Fit in per cent that a missing dead time must cost to be reported."""
MAX_LOST_PERCENT = 2.0
"""Fit in per cent that a missing dead time may cost before the model is doubtful."""


def share_from_input(analysis: ResidualAnalysis) -> float:
    """Return the share of the error's variance that the input of the most telling lag explains."""
    return float(np.max(analysis.from_input.values**2, initial=0.0))


def check_dynamics(estimate: Estimate, analysis: ResidualAnalysis, fit: float) -> Iterator[Finding]:
    """Find a dead time that the structure lacks or, if none helps, say that dynamics are missing.

    A dead time that costs less than NOTED_LOST_PERCENT of the fit is not reported.
    """
    if analysis.from_input.passed or not np.isfinite(fit):
        return
    first, nk = estimate.experiments[0], estimate.discrete.nk
    suggested = _delay(estimate)
    if suggested is None:
        probability = analysis.from_input.probability
        yield Finding(
            kind=Kind.NOT_EXPLAINED,
            severity=Severity.NOTE,
            record=first.name,
            signal=first.names.y,
            figure=probability,
            limit=1.0 - analysis.from_input.level,
            unit="",
            text=(
                f"the model's error depends on earlier values of {first.names.u} (probability by chance "
                f"{probability:.1g}): some dynamics are missing"
            ),
            remedy="try a larger structure",
        )
        return
    samples, improvement = suggested
    lost = (100.0 - fit) * (1.0 - float(np.sqrt(1.0 - improvement)))
    if lost <= NOTED_LOST_PERCENT:
        return
    is_doubtful = lost > MAX_LOST_PERCENT
    limit = MAX_LOST_PERCENT if is_doubtful else NOTED_LOST_PERCENT
    yield Finding(
        kind=Kind.DEAD_TIME,
        severity=Severity.WARN if is_doubtful else Severity.NOTE,
        record=first.name,
        signal=first.names.y,
        figure=samples,
        limit=nk,
        unit="samples",
        text=(
            f"a delay of nk = {samples} instead of {nk} would raise the fit by {lost:.3g} % (limit "
            f"{limit:g} %)"
        ),
        remedy=f"use nk = {samples}, or a continuous structure with a dead time",
    )


def _delay(estimate: Estimate) -> tuple[int, float] | None:
    """Return the shortest delay that lowers the error nearly as far as any, and the share that it removes."""
    model = estimate.discrete
    sections = PoleSections.of_order(model.order, model.sample_time_s)
    theta = from_poles(logarithms(model.f, model.sample_time_s), sections) if model.stable else None
    if theta is None or not len(theta):
        return None
    parts = [experiment.part(0, SAMPLES) for experiment in estimate.experiments]
    data = SimulationError(parts, skipped=MAX_DEAD_SAMPLES + len(model.b))
    costs = {}
    for nk in range(model.nk, model.nk + MAX_DEAD_SAMPLES):
        outcome = minimise(DynamicsProblem(data, FreeNumerator(sections, len(model.b), nk)), theta, 1e-2, 12)
        if outcome is None:
            return None
        costs[nk], theta = outcome.trial.cost, outcome.theta
    present, least = costs[model.nk], min(costs.values())
    if not present - least > MIN_IMPROVEMENT * present:
        return None
    shortest = min(nk for nk, cost in costs.items() if cost <= least + NEARLY_BEST * (present - least))
    return shortest, 1.0 - costs[shortest] / present
