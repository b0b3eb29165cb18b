"""What can be said against a record before a model is fitted to it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from design.identification.checks.expectations import Expectations
from design.identification.checks.loop_checks import check_loop
from design.identification.checks.range_checks import check_input_range, check_travel
from design.identification.findings import Finding, Kind, Severity
from design.identification.least_squares import triangle
from design.identification.models.structures import Structure, parameters_of
from design.identification.records.experiment import Experiment, runs
from design.mathematics.polynomials import Array

MIN_SAMPLES_PER_PARAMETER = 10
"""Number of output samples for each parameter of the model below which a record is refused."""
MIN_SAMPLES = 50
"""Number of output samples below which a record is refused, whatever the model."""
MIN_VALIDATION_SAMPLES = 20
"""Number of output samples below which a record cannot validate a model."""
MAX_PERIOD_ERROR = 0.02
"""Relative difference of the sample time from the rig's period above which a record is refused."""
MAX_MISSING = 0.05
"""Share of missing samples above which the gaps are reported."""
REFUSED_MISSING = 0.8
"""Share of missing samples above which a record is refused."""
MIN_USABLE = 0.5
"""Share of the record that must lie in stretches of known inputs of a useful length."""
MAX_INTERRUPTIONS = 0.01
"""Places at which the input is unknown, as a share of the samples, above which their effect is reported."""
USEFUL_STRETCH = 5
"""Useful length of a stretch, in samples for each parameter of the model."""
PERSISTENCE = 1e-11
"""Smallest singular value of the delayed inputs, as a share of the largest, that counts as excitation."""
MAX_EXCITATION_SAMPLES = 20_000
"""Number of inputs whose excitation is measured."""
SMALLEST_SPREAD = 1e-50
"""Range of a signal up to which it counts as constant."""
MIN_LEVELS = 20
"""Number of different output values below which the resolution is reported."""
_INPUT_HELD = "if the actuator kept its last input in the gaps of the table, give --input-held"
"""Remedy for gaps in the input."""


def check_record(experiment: Experiment, structure: Structure, expected: Expectations) -> list[Finding]:
    """Return the findings about one record that a model is to be fitted to."""
    found = list(_size(experiment, structure))
    if any(finding.severity is Severity.REFUSE for finding in found):
        return found
    return [
        *found,
        *_period(experiment, expected),
        *_constant_input(experiment),
        *_constant_output(experiment),
        *_excitation(experiment, structure),
        *check_input_range(experiment, expected),
        *check_travel(experiment, expected),
        *_resolution(experiment),
        *check_loop(experiment, structure, expected),
    ]


def check_validation(experiment: Experiment, expected: Expectations) -> list[Finding]:
    """Return the findings about one record that a model is to be compared with."""
    count = int(np.count_nonzero(np.isfinite(experiment.u) & experiment.observed))
    if count < MIN_VALIDATION_SAMPLES:
        finding = Finding(
            kind=Kind.TOO_FEW_SAMPLES,
            severity=Severity.REFUSE,
            record=experiment.name,
            signal=experiment.names.y,
            figure=count,
            limit=MIN_VALIDATION_SAMPLES,
            unit="samples",
            text=f"{count} samples for the validation, {MIN_VALIDATION_SAMPLES} are needed",
            remedy="record longer, or give a record for the validation",
        )
        return [finding]
    remedy = "excite the plant throughout, or give a record for the validation"
    return [
        *(replace(finding, remedy=remedy) for finding in _constant_input(experiment)),
        *_constant_output(experiment),
        *check_input_range(experiment, expected),
        *check_travel(experiment, expected),
    ]


def _size(experiment: Experiment, structure: Structure) -> Iterator[Finding]:
    count = int(np.count_nonzero(experiment.observed))
    needed = max(MIN_SAMPLES, MIN_SAMPLES_PER_PARAMETER * parameters_of(structure))
    if count < needed:
        yield Finding(
            kind=Kind.TOO_FEW_SAMPLES,
            severity=Severity.REFUSE,
            record=experiment.name,
            signal=experiment.names.y,
            figure=count,
            limit=needed,
            unit="samples",
            text=f"{count} samples that are known and count, {needed} are needed for {structure}",
            remedy="record longer, or choose a smaller structure",
        )
        return
    yield from _missing(experiment)
    yield from _stretches(experiment, structure)
    yield from _interruptions(experiment)


def _missing(experiment: Experiment) -> Iterator[Finding]:
    missing = 1.0 - float(np.mean(np.isfinite(experiment.y) & np.isfinite(experiment.u)))
    if missing <= MAX_MISSING:
        return
    refused = missing > REFUSED_MISSING
    limit = REFUSED_MISSING if refused else MAX_MISSING
    yield Finding(
        kind=Kind.GAPS,
        severity=Severity.REFUSE if refused else Severity.WARN,
        record=experiment.name,
        signal=experiment.names.y,
        figure=100.0 * missing,
        limit=100.0 * limit,
        unit="%",
        text=f"{100.0 * missing:.3g} % of the samples are missing (limit {100.0 * limit:g} %)",
        remedy="look for lost frames, and record again",
    )


def _stretches(experiment: Experiment, structure: Structure) -> Iterator[Finding]:
    needed = USEFUL_STRETCH * parameters_of(structure)
    lengths = [last - first for first, last in runs(np.isfinite(experiment.u))]
    usable = sum(length for length in lengths if length >= needed) / len(experiment)
    if usable < MIN_USABLE:
        yield Finding(
            kind=Kind.GAPS,
            severity=Severity.REFUSE,
            record=experiment.name,
            signal=experiment.names.u,
            figure=100.0 * usable,
            limit=100.0 * MIN_USABLE,
            unit="%",
            text=(
                f"only {100.0 * usable:.3g} % of the record lies in stretches of {needed} or more periods "
                f"with a known input (limit {100.0 * MIN_USABLE:g} %); the longest has "
                f"{max(lengths, default=0)}"
            ),
            remedy=f"record without interruptions, or {_INPUT_HELD}",
        )


def _interruptions(experiment: Experiment) -> Iterator[Finding]:
    count = len(list(runs(np.isfinite(experiment.u)))) - 1
    share = count / len(experiment)
    if share <= MAX_INTERRUPTIONS:
        return
    yield Finding(
        kind=Kind.GAPS,
        severity=Severity.NOTE,
        record=experiment.name,
        signal=experiment.names.u,
        figure=100.0 * share,
        limit=100.0 * MAX_INTERRUPTIONS,
        unit="%",
        text=(
            f"the input is unknown at {count} places, {100.0 * share:.3g} % of the samples (limit "
            f"{100.0 * MAX_INTERRUPTIONS:g} %). The plant's state is estimated anew after each, which makes "
            "the model less accurate"
        ),
        remedy=_INPUT_HELD,
    )


def _period(experiment: Experiment, expected: Expectations) -> Iterator[Finding]:
    known, given = expected.sample_time_s, experiment.sample_time_s
    if known is not None and abs(given / known - 1.0) > MAX_PERIOD_ERROR:
        yield Finding(
            kind=Kind.SAMPLE_TIME,
            severity=Severity.REFUSE,
            record=experiment.name,
            signal="sample time",
            figure=given,
            limit=known,
            unit="s",
            text=(
                f"{given:.6g} s, but the rig's period is {known:.6g} s (limit of the difference "
                f"{100.0 * MAX_PERIOD_ERROR:g} %)"
            ),
            remedy="give the true sample time, in seconds",
        )


def _constant_input(experiment: Experiment) -> Iterator[Finding]:
    names, u = experiment.names, experiment.u[np.isfinite(experiment.u)]
    if _is_constant(u):
        yield Finding(
            kind=Kind.CONSTANT_INPUT,
            severity=Severity.REFUSE,
            record=experiment.name,
            signal=names.u,
            figure=float(np.ptp(u)),
            limit=0.0,
            unit=names.u_unit,
            text=f"it stays at {u[0]:.6g} {names.u_unit}",
            remedy="excite the plant; check that the right channel was recorded",
        )


def _constant_output(experiment: Experiment) -> Iterator[Finding]:
    names, y = experiment.names, experiment.y[experiment.observed]
    if _is_constant(y):
        yield Finding(
            kind=Kind.CONSTANT_OUTPUT,
            severity=Severity.REFUSE,
            record=experiment.name,
            signal=names.y,
            figure=float(np.ptp(y)),
            limit=0.0,
            unit=names.y_unit,
            text=f"it stays at {y[0]:.6g} {names.y_unit}",
            remedy=(
                "check the sensor, its wire and the channel; raise the amplitude if the plant did not move"
            ),
        )


def _is_constant(values: Array) -> bool:
    return float(np.ptp(values)) <= max(1e-9 * float(np.abs(values).max()), SMALLEST_SPREAD)


def _excitation(experiment: Experiment, structure: Structure) -> Iterator[Finding]:
    """Compare the rank of the delayed inputs: a constant excites one parameter, a sine two, and so on."""
    needed = parameters_of(structure)
    first, last = max(runs(np.isfinite(experiment.u)), key=lambda span: span[1] - span[0])
    u = experiment.u[first : min(last, first + MAX_EXCITATION_SAMPLES)]
    u = u - u.mean()
    if len(u) <= 2 * needed or not u.any():
        return
    delayed = np.lib.stride_tricks.sliding_window_view(u, needed)
    singular = np.linalg.svd(triangle(delayed.T), compute_uv=False)
    order = int(np.count_nonzero(singular > PERSISTENCE * singular[0]))
    if order < needed:
        yield Finding(
            kind=Kind.EXCITATION,
            severity=Severity.REFUSE,
            record=experiment.name,
            signal=experiment.names.u,
            figure=order,
            limit=needed,
            unit="",
            text=f"it excites {order} parameters, {structure} has {needed}",
            remedy="use a PRBS, a multisine with more lines or a chirp, or a smaller structure",
        )


def _resolution(experiment: Experiment) -> Iterator[Finding]:
    levels = len(np.unique(experiment.y[experiment.observed][:MAX_EXCITATION_SAMPLES]))
    if levels < MIN_LEVELS:
        yield Finding(
            kind=Kind.RESOLUTION,
            severity=Severity.WARN,
            record=experiment.name,
            signal=experiment.names.y,
            figure=levels,
            limit=MIN_LEVELS,
            unit="",
            text=f"it takes only {levels} different values (limit {MIN_LEVELS})",
            remedy="raise the amplitude, or use a converter of finer resolution",
        )
