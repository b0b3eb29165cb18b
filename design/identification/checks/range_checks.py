"""A record beside the limits of the actuator and the ends of the travel."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from design.identification.checks.expectations import Expectations
from design.identification.findings import Finding, Kind, Severity
from design.identification.records.experiment import Experiment
from design.mathematics.polynomials import Array, Flags

MAX_AT_LIMIT = 0.01
"""Share of samples at a limit of the actuator above which saturation is reported."""
MAX_BEYOND_INPUT_RANGE = 0.05
"""Excess over the actuator's range, as a share of it, above which the unit must be wrong."""
MAX_BEYOND_TRAVEL = 0.2
"""Excess over the travel, as a share of it, above which the unit must be wrong."""
MAX_AT_STOPS = 0.2
"""Share of samples at the ends of the travel above which a record is refused."""
STOP_MARGIN = 0.01
"""Share of the travel next to its ends that counts as reached."""
SCALES = {1000.0: "thousandths of the unit", 100.0: "hundredths of the unit", 180.0 / np.pi: "degrees"}
"""Usual factors of a wrong unit."""


def check_input_range(experiment: Experiment, expected: Expectations) -> Iterator[Finding]:
    """Find an input in a wrong unit, or at the limits of the actuator."""
    if expected.input_range is None:
        return
    (low, high), names = expected.input_range, experiment.names
    u = experiment.u[np.isfinite(experiment.u)]
    outside = _outside(u, low, high, MAX_BEYOND_INPUT_RANGE)
    if outside is not None:
        yield Finding(
            kind=Kind.UNITS,
            severity=Severity.REFUSE,
            record=experiment.name,
            signal=names.u,
            figure=outside,
            limit=_nearer(outside, low, high),
            unit=names.u_unit,
            text=(
                f"it reaches {outside:.4g} {names.u_unit}, but the actuator takes {low:g} to {high:g} "
                f"{names.u_unit}{_guess(outside, low, high)}"
            ),
            remedy=(
                "give it in the right unit, as an offset from the actuator's centre; if the actuator limited "
                "it, record the limited value"
            ),
        )
        return
    margin = 1e-6 * (high - low)
    share = float(np.mean((u >= high - margin) | (u <= low + margin)))
    if share > MAX_AT_LIMIT:
        yield Finding(
            kind=Kind.SATURATION,
            severity=Severity.WARN,
            record=experiment.name,
            signal=names.u,
            figure=100.0 * share,
            limit=100.0 * MAX_AT_LIMIT,
            unit="%",
            text=(
                f"{100.0 * share:.3g} % of it lies at a limit of the actuator (limit "
                f"{100.0 * MAX_AT_LIMIT:g} %)"
            ),
            remedy="lower the amplitude",
        )


def check_travel(experiment: Experiment, expected: Expectations) -> Iterator[Finding]:
    """Find an output in a wrong unit, or at the ends of the travel."""
    if expected.travel is None:
        return
    (low, high), names = expected.travel, experiment.names
    outside = _outside(experiment.y[experiment.observed], low, high, MAX_BEYOND_TRAVEL)
    if outside is not None:
        yield Finding(
            kind=Kind.UNITS,
            severity=Severity.REFUSE,
            record=experiment.name,
            signal=names.y,
            figure=outside,
            limit=_nearer(outside, low, high),
            unit=names.y_unit,
            text=(
                f"it reaches {outside:.4g} {names.y_unit}, but the travel is {low:g} to {high:g} "
                f"{names.y_unit}{_guess(outside, low, high)}"
            ),
            remedy="give it in the right unit, with its zero where the travel has it",
        )
        return
    share = float(np.mean(_at_stops(experiment, expected.travel)[experiment.observed]))
    if share > 0.0:
        yield Finding(
            kind=Kind.END_STOPS,
            severity=Severity.REFUSE if share > MAX_AT_STOPS else Severity.WARN,
            record=experiment.name,
            signal=names.y,
            figure=100.0 * share,
            limit=100.0 * MAX_AT_STOPS,
            unit="%",
            text=(
                f"{100.0 * share:.3g} % of it lies at an end of the travel (limit {100.0 * MAX_AT_STOPS:g} "
                "%); these samples are left out"
            ),
            remedy="centre the axis first, measure the actuator's offset, or lower the amplitude",
        )


def without_stops(experiment: Experiment, expected: Expectations) -> Experiment:
    """Return the record without the periods at an end stop.

    No linear model holds there. Each ends a stretch, and the state after it is estimated anew.
    """
    if expected.travel is None:
        return experiment
    stopped = _at_stops(experiment, expected.travel)
    return experiment.interrupted(stopped) if stopped.any() else experiment


def _at_stops(experiment: Experiment, travel: tuple[float, float]) -> Flags:
    low, high = travel
    margin = STOP_MARGIN * (high - low)
    return np.asarray((experiment.y > high - margin) | (experiment.y < low + margin))


def _outside(values: Array, low: float, high: float, margin: float) -> float | None:
    """Return the value farthest outside the range, if it leaves it by more than a share of its width."""
    excess = np.maximum(values - high, low - values)
    worst = int(np.argmax(excess))
    return float(values[worst]) if excess[worst] > margin * (high - low) else None


def _nearer(value: float, low: float, high: float) -> float:
    return high if value > high else low


def _guess(outside: float, low: float, high: float) -> str:
    """Return the usual factors by which the value, divided, would lie in the range."""
    limit = _nearer(outside, low, high)
    ratio = outside / limit if limit else 0.0
    reasons = [reason for factor, reason in SCALES.items() if 3.0 < ratio <= 1.2 * factor]
    return f": in {' or '.join(reasons)}?" if reasons else ""
