"""Is a table in the units that it is read in? The orders of magnitude of a pneumatic axis decide."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from design.identification.findings import Finding, Kind, Severity
from design.identification.records.experiment import Experiment
from design.mathematics.polynomials import Array

MAX_SAMPLE_TIME_S = 1.0
"""Sample time above which the times are probably in ms. Control loops of such axes run at 0.001 to 0.1 s."""
MIN_SAMPLE_TIME_S = 2e-5
"""Sample time below which the unit of the times is doubted."""


class Range(NamedTuple):
    """Largest range of a signal that is usual in a unit, and what is probably wrong above it."""

    limit: float
    remedy: str


USUAL_RANGES = {
    "m": Range(3.0, "if it is in mm or cm, convert it to m"),
    "rad": Range(13.0, "if it is in degrees, convert it to rad"),
    "V": Range(30.0, "if it is in mV or per cent, convert it to V"),
}
"""Usual ranges, largest minus smallest value, by unit: strokes under 3 m, two turns, valves of 10 or 20 V."""


def check_units(experiment: Experiment) -> Iterator[Finding]:
    """Find a sample time, an input or an output that no pneumatic axis has in the stated unit."""
    yield from _sample_time(experiment)
    names = experiment.names
    yield from _range(experiment, names.u, names.u_unit, experiment.u)
    yield from _range(experiment, names.y, names.y_unit, experiment.y)


def _sample_time(experiment: Experiment) -> Iterator[Finding]:
    period_s = experiment.sample_time_s
    if MIN_SAMPLE_TIME_S <= period_s <= MAX_SAMPLE_TIME_S:
        return
    is_long = period_s > MAX_SAMPLE_TIME_S
    limit = MAX_SAMPLE_TIME_S if is_long else MIN_SAMPLE_TIME_S
    yield Finding(
        kind=Kind.SAMPLE_TIME,
        severity=Severity.WARN,
        record=experiment.name,
        signal="sample time",
        figure=period_s,
        limit=limit,
        unit="s",
        text=f"{period_s:.6g} s is unusual for a pneumatic axis (limit {limit:g} s)",
        remedy=f"if the times are in {'ms' if is_long else 'other units'}, convert them to s",
    )


def _range(experiment: Experiment, name: str, unit: str, values: Array) -> Iterator[Finding]:
    usual = USUAL_RANGES.get(unit)
    known = values[np.isfinite(values)]
    if usual is None or not len(known):
        return
    found = float(np.ptp(known))
    if found <= usual.limit:
        return
    yield Finding(
        kind=Kind.UNITS,
        severity=Severity.WARN,
        record=experiment.name,
        signal=name,
        figure=found,
        limit=usual.limit,
        unit=unit,
        text=(
            f"its values span {found:.4g} {unit}, which is unusual for a pneumatic axis (limit "
            f"{usual.limit:g} {unit})"
        ),
        remedy=usual.remedy,
    )
