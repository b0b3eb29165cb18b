"""A model's simulation beside the data: is it good enough, and if not, why?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from design.errors import DesignError
from design.identification.analysis.comparison import Comparison, compare, overall_fit
from design.identification.checks.stalls import sensor_noise
from design.identification.estimators.estimate import Estimate
from design.identification.estimators.output_error import fit_output_error
from design.identification.findings import Finding, Kind, Severity
from design.identification.models.structures import OutputError
from design.identification.records.experiment import Experiment

POOR_PERCENT = 70.0
"""Fit on validation data below which a model is reported as poor."""
REFUSED_PERCENT = 10.0
"""Fit on validation data below which no model is given."""
MAX_FIT_LOSS = 10.0
"""Difference in per cent between the fits on estimation and validation data above which it is reported."""
EXPLAINED_PERCENT = 90.0
"""Fit below which an error that the sensor does not explain is reported."""
MAX_NOISE_RATIO = 10.0
"""Ratio of the model's error to the sensor's noise above which it is reported."""
SWAPPED_GAIN = 20.0
"""Fit in per cent by which the reversed model must be better to show swapped channels."""
SWAPPED_SAMPLES = 6000
"""Number of samples to which a model from y to u is fitted."""


def check_fit(
    estimate: Estimate, fitted: Sequence[Comparison], validation: Sequence[Comparison]
) -> Iterator[Finding]:
    """Judge the fits of a stable model on the data that were fitted, and on the others."""
    own, other = overall_fit(fitted), overall_fit(validation)
    explained = min(other, *(comparison.input_percent for comparison in validation))
    if not explained >= REFUSED_PERCENT:
        worst = min(validation, key=lambda comparison: comparison.input_percent).experiment
        yield _no_fit(estimate, own, explained, worst)
        return
    if other < POOR_PERCENT:
        yield Finding(
            kind=Kind.POOR_FIT,
            severity=Severity.WARN,
            record=validation[0].experiment.name,
            signal=validation[0].experiment.names.y,
            figure=other,
            limit=POOR_PERCENT,
            unit="%",
            text=(
                f"the model's free-running simulation follows it to {other:.3g} % only (limit "
                f"{POOR_PERCENT:g} %)"
            ),
            remedy="raise the amplitude, look at the residuals, or choose another structure",
        )
    if own - other > MAX_FIT_LOSS:
        yield Finding(
            kind=Kind.POOR_FIT,
            severity=Severity.WARN,
            record=validation[0].experiment.name,
            signal="fit",
            figure=own - other,
            limit=MAX_FIT_LOSS,
            unit="%",
            text=(
                f"the fit is {own:.3g} % on the data that were fitted, {other:.3g} % on the others (limit "
                f"of the difference {MAX_FIT_LOSS:g} %)"
            ),
            remedy=(
                "choose a smaller structure, record longer, or make both records under the same conditions"
            ),
        )
    if own < EXPLAINED_PERCENT:
        yield from _beyond_the_sensor(estimate)


def _beyond_the_sensor(estimate: Estimate) -> Iterator[Finding]:
    first = estimate.experiments[0]
    noise = max(sensor_noise(experiment) for experiment in estimate.experiments)
    ratio = estimate.noise_std / noise if noise else 0.0
    if ratio > MAX_NOISE_RATIO:
        yield Finding(
            kind=Kind.NOT_EXPLAINED,
            severity=Severity.WARN,
            record=first.name,
            signal=first.names.y,
            figure=ratio,
            limit=MAX_NOISE_RATIO,
            unit="",
            text=(
                f"the model's error is {ratio:.3g} times the noise of the sensor (limit "
                f"{MAX_NOISE_RATIO:g}): the plant does something that the model does not, or is disturbed"
            ),
            remedy="look for end stops, friction or saturation in the record; choose another structure",
        )


def _no_fit(estimate: Estimate, own: float, explained: float, validation: Experiment) -> Finding:
    """Return the reason why a model explains next to nothing of the record ``validation``.

    A model that follows its own data shows that the columns of the other record are wrong.
    """
    names, record = estimate.experiments[0].names, validation.name
    percent = max(explained, 0.0)
    suspected = estimate.experiments if own < POOR_PERCENT else [validation]
    swapped = _fit_of_swapped(suspected)
    if swapped > max(POOR_PERCENT, (own if own < POOR_PERCENT else percent) + SWAPPED_GAIN):
        return Finding(
            kind=Kind.SWAPPED,
            severity=Severity.REFUSE,
            record=record,
            signal=f"{names.u} and {names.y}",
            figure=swapped,
            limit=POOR_PERCENT,
            unit="%",
            text=(
                f"{names.u} follows from {names.y} to {swapped:.3g} %, but {names.y} from {names.u} to "
                f"{percent:.3g} %"
            ),
            remedy="exchange the two columns" + (f" of {record}" if own >= POOR_PERCENT else ""),
        )
    return Finding(
        kind=Kind.POOR_FIT,
        severity=Severity.REFUSE,
        record=record,
        signal=names.y,
        figure=explained,
        limit=REFUSED_PERCENT,
        unit="%",
        text=(
            f"{names.u} explains {percent:.3g} % of it in a free-running simulation (limit "
            f"{REFUSED_PERCENT:g} %)"
        ),
        remedy=(
            "raise the amplitude above friction and noise; check that both channels belong to one axis and "
            "one "
            "time; if the output drifts, estimate the drift; for an unstable plant, record in closed loop "
            "and choose ARMAX"
        ),
    )


def _fit_of_swapped(experiments: Sequence[Experiment]) -> float:
    """Fit in per cent of a small model from y to u."""
    swapped = [
        Experiment(np.where(e.observed, e.y, np.nan), e.u, e.sample_time_s).part(0, SWAPPED_SAMPLES)
        for e in experiments
    ]
    try:
        model = fit_output_error(swapped, OutputError(2, 2, 1)).discrete
    except DesignError:
        return -np.inf
    return overall_fit([compare(model, experiment) for experiment in swapped])
