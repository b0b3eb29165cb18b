"""Records in which the output acts on the input, or comes before it."""

from __future__ import annotations

from collections.abc import Iterator

from design.identification.checks.causality import later_input_share
from design.identification.checks.expectations import Expectations
from design.identification.checks.feedback import feedback
from design.identification.findings import Finding, Kind, Severity
from design.identification.models.structures import Armax, BoxJenkins, ContinuousPoles, Structure
from design.identification.records.experiment import Experiment

MAX_FEEDBACK = 0.3
"""Ratio of the input's prediction errors with and without the output, below which the loop is closed."""
MAX_LATER_INPUT = 0.05
"""Share of the output's prediction error that later inputs may explain."""


def check_loop(experiment: Experiment, structure: Structure, expected: Expectations) -> list[Finding]:
    """Find a closed loop that the structure does not allow for or, in open loop, a shift in time."""
    reason = _closed_because(experiment, expected)
    if reason is None:
        return list(_time_shift(experiment, structure))
    return [] if isinstance(structure, BoxJenkins | Armax) else [_closed_loop(experiment, structure, *reason)]


def _closed_because(experiment: Experiment, expected: Expectations) -> tuple[float, str] | None:
    """Return the figure and the reason why a controller acted, or None."""
    if expected.closed_loop is not None:
        return (0.0, "as stated") if expected.closed_loop else None
    found = feedback(experiment)
    if found is None or found.with_output >= MAX_FEEDBACK:
        return None
    percent = 100.0 * found.with_output
    return percent, (
        f"with {experiment.names.y} known, it is predicted with an error of only {percent:.3g} % of that "
        f"without (limit {100.0 * MAX_FEEDBACK:g} %)"
    )


def _closed_loop(experiment: Experiment, structure: Structure, figure: float, reason: str) -> Finding:
    return Finding(
        kind=Kind.FEEDBACK,
        severity=Severity.WARN,
        record=experiment.name,
        signal=experiment.names.u,
        figure=figure,
        limit=100.0 * MAX_FEEDBACK,
        unit="%",
        text=(
            f"a controller computed it from {experiment.names.y}: {reason}. {structure} is biased if the "
            f"noise in {experiment.names.y} is strong"
        ),
        remedy="record in open loop, or choose ARMAX or BJ",
    )


def _time_shift(experiment: Experiment, structure: Structure) -> Iterator[Finding]:
    nk = 1 if isinstance(structure, ContinuousPoles) else structure.nk
    share = later_input_share(experiment, nk)
    if share <= MAX_LATER_INPUT:
        return
    names = experiment.names
    yield Finding(
        kind=Kind.TIME_SHIFT,
        severity=Severity.WARN,
        record=experiment.name,
        signal=names.y,
        figure=100.0 * share,
        limit=100.0 * MAX_LATER_INPUT,
        unit="%",
        text=(
            f"{100.0 * share:.3g} % of what its past does not explain depends on values of {names.u} that "
            f"come later than nk = {nk} allows (limit {100.0 * MAX_LATER_INPUT:g} %): it answers before "
            "its input"
        ),
        remedy="check the times of both columns and the transport delay, or use a smaller nk",
    )
