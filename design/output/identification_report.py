"""Write the report of an identification: one HTML page that refers to nothing outside itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from design.identification.analysis.comparison import compare
from design.identification.analysis.uncertainty import Properties, Quantity, Root
from design.identification.findings import Finding, Severity
from design.identification.identify import Identification
from design.identification.models.model import DiscreteModel
from design.identification.order_search import OrderTable, Row
from design.models.plant import Plant
from design.models.transfer_function import TransferFunction
from design.output.identification_figures import (
    bode_figure,
    output_figures,
    pole_zero_figure,
    residual_figure,
)
from design.output.mathml import transfer_function_formula
from design.output.page import render_page
from design.output.provenance import versions

JOINT_ORDER = 3
"""Largest order up to which the true parameters lie inside their joint ellipsoid as often as they should."""
AMBIGUOUS_ORDER = 6
"""Order from which different sets of poles often explain a record equally well.

In a third of random records of order 6, the model that fits best has other poles than the true system.
"""
_SIGNS = {
    Severity.REFUSE: ("Refused", ""),
    Severity.WARN: ("Warning", "caution"),
    Severity.NOTE: ("Note", "hint"),
}
"""Word and style of each severity."""


@dataclass(frozen=True)
class _FindingText:
    """One finding as the page shows it."""

    severity: str
    style: str
    kind: str
    record: str
    signal: str
    text: str
    figure: str
    remedy: str


@dataclass(frozen=True)
class _Property:
    """One property of the model with its 95 % interval."""

    label: str
    value: str
    interval: str
    unit: str


@dataclass(frozen=True)
class _RecordRow:
    """One record and the model's fit on it."""

    name: str
    use: str
    samples: int
    duration: str
    fit: str


@dataclass(frozen=True)
class _OrderRow:
    """One structure of the search for orders."""

    structure: str
    fit: str
    aic: str
    bic: str
    unknowns: str
    note: str


def write_identification_report(
    identification: Identification, plant: Plant, path: Path, table: OrderTable | None = None
) -> None:
    """Write the report of an identified plant to ``path``; ``table`` is the search for orders, if any."""
    path.write_text(render_identification(identification, plant, table), encoding="utf-8")


def _rest_note(identification: Identification) -> str:
    """Return what the sentence "the model explains them" is limited by; empty if by nothing."""
    if identification.residuals.from_input.passed:
        return ""
    return (
        " except for a correlation of the residuals with earlier inputs, whose size the figure of the "
        "residuals states"
    )


def render_identification(
    identification: Identification, plant: Plant, table: OrderTable | None = None
) -> str:
    """Return the report as HTML."""
    discrete, unit = identification.discrete, plant.output_unit
    warnings = len(identification.warnings)
    known = identification.properties
    return render_page(
        "identification_report.html",
        title=f"Identified plant: {plant.name}",
        plant=plant,
        structure=str(identification.structure),
        period_s=discrete.sample_time_s,
        verdict=_verdict(identification),
        warnings=warnings,
        fit=_percent(identification.fit_percent),
        estimation_fit=_percent(identification.estimation_fit_percent),
        dead_time=f"{1000.0 * identification.dead_time_s:.4g} ms",
        delay_note=_delay_note(identification.contains_delay_samples),
        findings=[_finding_text(finding) for finding in identification.findings],
        rest_note=_rest_note(identification),
        output_figures=output_figures(identification.validation, unit),
        records=_record_rows(identification),
        properties=_property_rows(known, unit),
        interval_note=interval_note(identification.discrete.order),
        zeros_note=_zeros_note(known),
        figures=[
            bode_figure(identification, unit),
            residual_figure(identification),
            pole_zero_figure(known),
        ],
        orders=[] if table is None else _order_rows(table, str(identification.structure)),
        continuous_note=_continuous_note(identification),
        continuous_tf=transfer_function_formula(plant.rational_part, "G", plant.dead_time_s),
        discrete_tf=transfer_function_formula(TransferFunction(*discrete.in_z), "G", variable="z", digits=8),
        noise_tf=_noise_formula(discrete),
        nk=discrete.nk,
        facts=_facts(identification, plant),
        versions=versions(),
    )


def _verdict(identification: Identification) -> str:
    fit = identification.fit_percent
    if not np.isfinite(fit):
        return "The model is unstable, so it cannot be simulated freely. Do not design a controller with it."
    follows = f"The model follows data that were not fitted to {fit:.2f} %."
    count = len(identification.warnings)
    if not count:
        return f"{follows} There is no warning: it can be used for a design."
    warnings = "1 warning makes" if count == 1 else f"{count} warnings make"
    return f"{follows} However, {warnings} it doubtful; read what was found before you design with it."


def _delay_note(samples: int) -> str:
    if not samples:
        return "the rig's transport delay is not in the model; a design adds it"
    periods = "1 period" if samples == 1 else f"{samples} periods"
    return f"it contains {periods} of the rig's transport delay, which a design does not count again"


def _finding_text(finding: Finding) -> _FindingText:
    severity, style = _SIGNS[finding.severity]
    figure, limit = (_number(value, finding.unit) for value in (finding.figure, finding.limit))
    return _FindingText(
        severity,
        style,
        finding.kind.value,
        finding.record,
        finding.signal,
        finding.text,
        f"{figure}, compared with {limit}",
        finding.remedy,
    )


def _record_rows(identification: Identification) -> list[_RecordRow]:
    fitted = [
        (compare(identification.discrete, experiment), "fit the model")
        for experiment in identification.estimate.experiments
    ]
    others = [(comparison, "validate it") for comparison in identification.validation]
    return [
        _RecordRow(
            comparison.experiment.name,
            use,
            int(np.count_nonzero(comparison.experiment.observed)),
            f"{len(comparison.experiment) * comparison.experiment.sample_time_s:.4g}",
            _percent(comparison.fit_percent).removesuffix(" %"),
        )
        for comparison, use in fitted + others
    ]


def _property_rows(known: Properties, unit: str) -> list[_Property]:
    rows = []
    if known.gain is not None:
        rows.append(_property("static gain", known.gain, f"{unit}/V"))
    if known.velocity_gain is not None:
        rows.append(_property("velocity gain", known.velocity_gain, f"{unit}/s/V"))
    rows += [_root("pole", root) for root in known.poles if root.value.imag >= 0.0]
    rows += [_root("zero", root) for root in known.zeros or () if root.value.imag >= 0.0]
    for mode in known.modes:
        rows.append(_property("natural frequency", mode.natural_frequency_rad_s, "rad/s"))
        rows.append(_property("damping ratio", mode.damping, ""))
    dead = Quantity(1000.0 * known.dead_time_s.value, 1000.0 * known.dead_time_s.std)
    rows.append(_property("dead time", dead, "ms"))
    return rows


def _property(label: str, quantity: Quantity, unit: str) -> _Property:
    return _Property(label, _number(quantity.value), _interval(quantity), unit)


def _root(label: str, root: Root) -> _Property:
    """Return a real root, or a pair by its upper member."""
    real, imaginary = (
        Quantity(value, float(np.sqrt(max(float(root.covariance[i, i]), 0.0))))
        for i, value in enumerate((root.value.real, root.value.imag))
    )
    if imaginary.value == 0.0:
        return _Property(label, _number(real.value), _interval(real), "rad/s")
    return _Property(
        f"{label} pair",
        f"{_number(real.value)} ± {_number(imaginary.value)} j",
        f"real {_interval(real)}; imaginary {_interval(imaginary)}",
        "rad/s",
    )


def _interval(quantity: Quantity) -> str:
    if quantity.std == 0.0:
        return "fixed by the structure"
    low, high = quantity.interval()
    if not (np.isfinite(low) and np.isfinite(high)):
        return "unknown"
    return f"{_number(low)} to {_number(high)}"


def interval_note(order: int) -> str:
    """Return what the intervals of a model of this order do not say."""
    if order >= AMBIGUOUS_ORDER:
        return (
            f"They describe models close to this one only. At order {AMBIGUOUS_ORDER} and above, other sets "
            "of poles often explain a record as well, and the intervals do not contain those. Rely on the "
            "frequency response with its band below the fastest pole, or choose a smaller order."
        )
    if order > JOINT_ORDER:
        return (
            "Each holds by itself, with the others left open. A joint region of all parameters is not given: "
            f"above order {JOINT_ORDER} it is no ellipsoid."
        )
    return ""


def _zeros_note(known: Properties) -> str:
    if known.zeros is None:
        return "The sampled model has no continuous counterpart, so it has no zeros in s."
    return "" if known.zeros else "The continuous model has no zeros."


def _order_rows(table: OrderTable, chosen: str) -> list[_OrderRow]:
    def note(row: Row) -> str:
        if row.estimate is None:
            return f"no model: {row.reason}"
        return "chosen" if str(row.structure) == chosen else ""

    return [
        _OrderRow(
            str(row.structure),
            "–" if row.estimate is None else _percent(row.fit_percent).removesuffix(" %"),
            "–" if row.estimate is None else f"{row.aic:.1f}".replace("-", "−"),
            "–" if row.estimate is None else f"{row.bic:.1f}".replace("-", "−"),
            "–" if row.estimate is None else str(row.estimate.unknowns),
            note(row),
        )
        for row in sorted(table.rows, key=lambda row: row.bic)
    ]


def _continuous_note(identification: Identification) -> str:
    if identification.estimate.continuous is not None:
        return "Continuous, as it was fitted:"
    if identification.continuous is not None:
        return "Continuous, the inverse of the zero-order hold of the sampled model:"
    nearest = identification.nearest
    if nearest is None:
        return "Continuous: the sampled model has no continuous counterpart. The plant file holds:"
    return (
        "Continuous: the sampled model has no exact counterpart. The plant file holds the nearest model that "
        f"has one, which follows it to {nearest.fit_percent:.4g} %:"
    )


def _noise_formula(discrete: DiscreteModel) -> str:
    """Return C/D as a formula; an empty text for white noise."""
    if len(discrete.c) == 1 and len(discrete.d) == 1:
        return ""
    length = max(len(discrete.c), len(discrete.d))
    c, d = (np.concatenate([p, np.zeros(length - len(p))]) for p in (discrete.c, discrete.d))
    return transfer_function_formula(TransferFunction(c, d), "H", variable="z", digits=8)


def _facts(identification: Identification, plant: Plant) -> list[tuple[str, str]]:
    estimate = identification.estimate
    conditions = ((f"condition: {key}", _plain(value)) for key, value in plant.conditions.items())
    offsets = [
        (f"offset of {experiment.name}", _offset_text(offset.input_offset, offset.output_offset, plant))
        for experiment, offset in zip(estimate.experiments, estimate.offsets, strict=True)
    ]
    drifts = [
        (f"drift of {experiment.name}", f"{offset.drift_per_s:.4g} {plant.output_unit}/s")
        for experiment, offset in zip(estimate.experiments, estimate.offsets, strict=True)
        if offset.drift_per_s
    ]
    search = "it converged" if estimate.converged else "it did not converge"
    return [
        ("structure", str(identification.structure)),
        ("description", plant.description or "none"),
        ("input and output", f"{plant.input_unit} to {plant.output_unit}"),
        ("period", f"{identification.discrete.sample_time_s:g} s"),
        ("dead time, dead_time_s", f"{plant.dead_time_s:g} s"),
        ("rig's delay in it, contains_delay_samples", f"{plant.contains_delay_samples} periods"),
        ("estimation", f"{estimate.samples} samples, {estimate.unknowns} unknowns; {search}"),
        ("noise, standard deviation", f"{_number(estimate.noise_std)} {plant.output_unit}"),
        *offsets,
        *drifts,
        *conditions,
        ("recording, SHA-256", plant.recording or "not known"),
    ]


def _offset_text(input_offset: float | None, output_offset: float | None, plant: Plant) -> str:
    parts = [
        f"{name} {_number(value, unit)}"
        for name, value, unit in (
            ("input", input_offset, plant.input_unit),
            ("output", output_offset, plant.output_unit),
        )
        if value is not None
    ]
    return ", ".join(parts) or "none"


def _plain(value: bool | float | str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else f"{value:g}"


def _number(value: float, unit: str = "") -> str:
    """Return a value with its unit; a value that is not finite as a sign or a word."""
    if np.isnan(value):
        text = "unknown"
    elif np.isinf(value):
        text = "∞" if value > 0.0 else "−∞"
    else:
        text = f"{value:.4g}".replace("-", "−")
    return f"{text} {unit}".rstrip()


def _percent(value: float) -> str:
    return f"{value:.2f} %" if np.isfinite(value) else "none"
