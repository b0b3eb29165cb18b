"""What can be said against a model after it was fitted.

A record may be bad in ways that only a model shows: friction, drift, a missing dead time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from design.identification.analysis.comparison import Comparison, compare, overall_fit
from design.identification.analysis.residuals import ResidualAnalysis
from design.identification.analysis.uncertainty import Properties
from design.identification.checks.dynamics_checks import check_dynamics, share_from_input
from design.identification.checks.expectations import Expectations
from design.identification.checks.fit_checks import check_fit
from design.identification.checks.motion_checks import check_drift, check_stalls
from design.identification.checks.plant_checks import check_known_plant, check_time_scale, check_uncertainty
from design.identification.estimators.estimate import Estimate
from design.identification.findings import Finding, Kind, Severity
from design.identification.models.structures import ContinuousPoles, OutputError

MAX_MISSING_DYNAMICS = 0.15
"""Share of the error that earlier inputs explain, above which friction cannot be judged."""
ROUNDING = 1e-7
"""Ratio of the model's error to the output's standard deviation up to which the error is rounding."""


def check_model(
    estimate: Estimate,
    validation: Sequence[Comparison],
    analysis: ResidualAnalysis,
    properties: Properties,
    expected: Expectations,
    drift: bool,
) -> list[Finding]:
    """Return the findings about a model and, as far as the model shows them, about its record."""
    stable = estimate.discrete.stable
    fitted = [compare(estimate.discrete, experiment, drift=drift) for experiment in estimate.experiments]
    found = list(check_fit(estimate, fitted, validation)) if stable else []
    found += [
        *_search(estimate),
        *_stability(estimate),
        *check_time_scale(estimate),
        *check_uncertainty(estimate, properties),
        *check_known_plant(estimate, properties, expected),
    ]
    if stable and not drift:
        found += check_drift(estimate)
    if isinstance(estimate.structure, OutputError | ContinuousPoles) and _has_error(estimate):
        found += check_dynamics(estimate, analysis, overall_fit(fitted))
        if share_from_input(analysis) < MAX_MISSING_DYNAMICS:
            found += check_stalls([*fitted, *validation], expected)
    return found


def _has_error(estimate: Estimate) -> bool:
    """Return False if the error is nothing but rounding."""
    spreads = [float(np.std(experiment.y[experiment.observed])) for experiment in estimate.experiments]
    return estimate.noise_std > ROUNDING * max(spreads)


def _search(estimate: Estimate) -> Iterator[Finding]:
    if not estimate.converged:
        yield Finding(
            kind=Kind.NOT_CONVERGED,
            severity=Severity.WARN,
            record=estimate.experiments[0].name,
            signal=str(estimate.structure),
            figure=0.0,
            limit=0.0,
            unit="",
            text="the search for the parameters ended before it had converged",
            remedy="choose a smaller structure, or record longer",
        )
    for parameter in estimate.at_bound:
        value = float(estimate.parameters.values[estimate.parameters.names.index(parameter)])
        yield Finding(
            kind=Kind.SEARCH_BOUND,
            severity=Severity.WARN,
            record=estimate.experiments[0].name,
            signal=parameter,
            figure=value,
            limit=value,
            unit="",
            text=f"{value:.4g} lies at a search bound",
            remedy="choose a smaller structure: the record does not show this parameter",
        )


def _stability(estimate: Estimate) -> Iterator[Finding]:
    largest = float(np.abs(estimate.discrete.poles_z).max(initial=0.0))
    if largest > 1.0 + 1e-12:
        yield Finding(
            kind=Kind.UNSTABLE,
            severity=Severity.WARN,
            record=estimate.experiments[0].name,
            signal=str(estimate.structure),
            figure=largest,
            limit=1.0,
            unit="",
            text=(
                f"the model is unstable: its largest pole in z has modulus {largest:.6g} (limit 1). No "
                "free-running simulation can confirm it"
            ),
            remedy="compare it with a measured frequency response, or stabilise the plant and record again",
        )
