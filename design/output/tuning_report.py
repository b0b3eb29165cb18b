"""Write the report of a tuning as one HTML page, and print its verdict to the terminal."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

from rich.console import Console
from rich.table import Table
from rich.text import Text

from design.closed_loop.comparison import eps_text
from design.closed_loop.specifications import Reading
from design.output.page import render_page
from design.output.provenance import versions
from design.output.terminal import print_wrapped
from design.output.tuning_figures import step_figure
from design.output.tuning_results import (
    LABELS,
    MEASURED_ERROR_ALLOWANCE,
    Condition,
    MeasuredReading,
    Model,
    Tuning,
    Verified,
    measured_readings,
    value_text,
)
from design.output.tuning_verdict import Outcome, verdict
from design.robustness.loop_shaping import shaped
from design.robustness.nu_gap import nu_gap

_GOOD, _BAD, _SOFT = "good", "bad", "soft"
_STYLES = {"GOOD": "well", "CAUTION": "caution", "BAD": ""}
"""Style of a statement by its outcome; without one it is red."""
_OUTCOME_STYLES = {Outcome.GOOD: "green", Outcome.CAUTION: "yellow", Outcome.BAD: "red"}
_NOT_JUDGED_NOTE = (
    "* not judged: eq. (9) limits crossover and low-frequency gain of the shaped plant, not of the loop with "
    "the designed controller; and a measured steady-state error contains friction, so that one over the "
    f"limit by at most {value_text('error', MEASURED_ERROR_ALLOWANCE)} of the step is neither met nor missed"
)
"""Explanation of the values that are marked as not judged."""
_TERMINAL_STYLES = {_GOOD: "green", _BAD: "red", _SOFT: "dim"}


@dataclass(frozen=True)
class _Cell:
    """One value of a table, its style, and the heading of its column."""

    label: str
    text: str
    style: str = ""


@dataclass(frozen=True)
class _Row:
    """One specification: its limit, then a prediction for each model and a measurement for each step."""

    label: str
    limit: str
    cells: list[_Cell]


@dataclass(frozen=True)
class _GapRow:
    """ν-gaps of one model to all models, and what they mean."""

    name: str
    cells: list[_Cell]
    eps: str
    stability: str
    is_good: bool


@dataclass(frozen=True)
class _ModelRow:
    """One identified model."""

    name: str
    condition: str
    action: str
    fit: str
    warnings: tuple[str, ...]
    href: str


def write_tuning_report(tuning: Tuning, path: Path) -> None:
    """Write the page of a tuning to ``path``. Links are relative to it. Raises RecordingError."""
    path.write_text(render_tuning(tuning, path.parent), encoding="utf-8")


def render_tuning(tuning: Tuning, directory: Path) -> str:
    """Return the page as HTML, with links relative to ``directory``."""
    design, job = tuning.design, tuning.job
    names = [model.condition.name for model in tuning.models]
    gaps = [guarantee.gap for guarantee in design.guarantees]
    missed = {model.condition.name for model, _ in tuning.missed_predictions}
    parameters = ", ".join(f"{name} {value:.5g}" for name, value in design.designed.parameters.items())
    return render_page(
        "tuning_report.html",
        title=f"Tuning of the axis {job.axis}",
        conditions=f"Conditions: {', '.join(names)}",
        controller=design.designed.name,
        parameters=parameters,
        bus=job.bus or "the simulated arm, in lockstep",
        verdict=verdict(tuning),
        styles=_STYLES,
        warnings=tuning.warnings,
        eps=design.eps,
        largest_gap=f"{max(gaps):.3f}" if gaps else "–",
        met_predicted=len(names) - len(missed),
        met_measured=sum(not verified.failures for verified in tuning.verified),
        models=[_model_row(model, directory) for model in tuning.models],
        measured_names=[verified.condition.name for verified in tuning.verified],
        specifications=_specification_rows(tuning),
        not_judged_note=_NOT_JUDGED_NOTE,
        figures=[step_figure(tuning, verified) for verified in tuning.verified],
        gaps=_gap_rows(tuning),
        structure=job.structure,
        duration_s=job.duration_s,
        amplitude_v=job.amplitude,
        links=_links(tuning, directory),
        versions=versions(),
    )


def print_tuning(console: Console, tuning: Tuning) -> None:
    """Print the verdict, and specification, prediction and measurement of every condition."""
    table = Table("condition", "specification", box=None, pad_edge=False)
    for heading in ("limit", "predicted", "measured"):
        table.add_column(heading, justify="right")
    rows = _specification_rows(tuning)
    count = len(tuning.models)
    for number, model in enumerate(tuning.models):
        for row in rows:
            cells = [row.cells[number], *row.cells[count + number : count + number + 1]]
            table.add_row(
                Text(model.condition.name if row is rows[0] else ""),
                row.label,
                row.limit,
                *(Text(cell.text, _TERMINAL_STYLES.get(cell.style, "")) for cell in cells),
            )
    console.print(table)
    if any(cell.text.endswith("*") for row in rows for cell in row.cells):
        print_wrapped(console, _NOT_JUDGED_NOTE, "dim")
    for guarantee in tuning.design.guarantees:
        relation = "below" if guarantee.guaranteed else "not below"
        print_wrapped(
            console,
            f"{guarantee.plant.name}: ν-gap to the nominal model {guarantee.gap:.3f}, {relation} ε "
            f"{guarantee.eps:.3f}",
        )
    print_wrapped(console, "")
    for statement in verdict(tuning):
        print_wrapped(
            console, f"{statement.outcome.value} {statement.text}", _OUTCOME_STYLES[statement.outcome]
        )
    for warning in (*tuning.warnings, *_model_warnings(tuning.models)):
        print_wrapped(console, f"warning: {warning}", "yellow")


def _model_warnings(models: Sequence[Model]) -> list[str]:
    return [f"{m.condition.name}: {warning}" for m in models for warning in m.identification.warnings]


def _specification_rows(tuning: Tuning) -> list[_Row]:
    """Return a row for each specification. Steps that were not measured have no cells."""
    judged, predictions = tuning.judged, tuning.predictions
    measured = [
        {r.quantity: r for r in measured_readings(verified.measured, tuning.design_file)}
        for verified in tuning.verified
    ]
    rows = []
    for number, specification in enumerate(tuning.design.design_file.specifications.requested()):
        quantity = specification.quantity
        predicted = [
            _predicted_cell(model, read[number], quantity in judged)
            for model, read in zip(tuning.models, predictions, strict=True)
        ]
        steps = [
            _measured_cell(verified, read.get(quantity))
            for verified, read in zip(tuning.verified, measured, strict=True)
        ]
        sign = "≤" if specification.kind.is_upper_limit else "≥"
        limit = f"{sign} {value_text(quantity, specification.limit)}"
        rows.append(_Row(LABELS[quantity], limit, predicted + steps))
    return rows


def _predicted_cell(model: Model, reading: Reading, is_judged: bool) -> _Cell:
    return _cell(
        f"predicted, {model.condition.name}", reading.quantity, reading.value, reading.met, is_judged
    )


def _measured_cell(verified: Verified, reading: MeasuredReading | None) -> _Cell:
    label = f"measured, {verified.condition.name}"
    if reading is None:
        return _Cell(label, "–", _SOFT)
    return _cell(label, reading.quantity, reading.value, reading.met, not reading.uses_allowance)


def _cell(label: str, quantity: str, value: float, met: bool, is_judged: bool) -> _Cell:
    text = value_text(quantity, value)
    if not is_judged:
        return _Cell(label, f"{text} *", _SOFT)
    return _Cell(label, f"{text} {'✓' if met else '✗'}", _GOOD if met else _BAD)


def _gap_rows(tuning: Tuning) -> list[_GapRow]:
    problem = tuning.design.problem
    plants = [
        shaped(replace(problem, plant=model.plant).loop_plant, problem.weight) for model in tuning.models
    ]
    eps = tuning.design.eps
    margins = [eps, *(guarantee.eps_there for guarantee in tuning.design.guarantees)]
    rows = []
    for i, (model, margin) in enumerate(zip(tuning.models, margins, strict=True)):
        gaps = [0.0 if i == j else nu_gap(plants[i], other) for j, other in enumerate(plants)]
        cells = [
            _Cell(f"ν-gap to {other.condition.name}", f"{gap:.4f}", "" if j == 0 else _SOFT)
            for j, (other, gap) in enumerate(zip(tuning.models, gaps, strict=True))
        ]
        is_guaranteed = gaps[0] < eps
        if i == 0:
            text = "the margin ε belongs to this model" if margin > 0.0 else "unstable"
        elif is_guaranteed:
            text = "guaranteed: the ν-gap is below ε"
        else:
            text = "stable by direct computation, not guaranteed by ε" if margin > 0.0 else "unstable"
        is_good = margin > 0.0 and is_guaranteed
        rows.append(_GapRow(model.condition.name, cells, eps_text(margin), text, is_good))
    return rows


def _model_row(model: Model, directory: Path) -> _ModelRow:
    return _ModelRow(
        model.plant.name,
        model.condition.name,
        _action(model.condition),
        f"{model.identification.fit_percent:.2f}",
        model.identification.warnings,
        _href(model.plant_file, directory),
    )


def _action(condition: Condition) -> str:
    parts = [condition.instruction, *condition.events]
    if condition.centre:
        parts.append(f"about the position {condition.centre:g}")
    return "; ".join(part for part in parts if part) or "nothing: the rig as it is"


def _links(tuning: Tuning, directory: Path) -> list[tuple[str, str]]:
    """Return label and address of every file of the tuning."""
    design = tuning.controller_file.parent
    files = [
        ("report of the design", design / "report.html"),
        ("controller file", tuning.controller_file),
        *((f"model of {m.condition.name}", m.plant_file) for m in tuning.models),
        *((f"measured step, {v.condition.name}", v.recording) for v in tuning.verified),
    ]
    return [(f"{label}: {path.name}", _href(path, directory)) for label, path in files]


def _href(path: Path, directory: Path) -> str:
    """Return the relative address of a file, so that the results folder can be moved."""
    return quote(Path(os.path.relpath(path, directory)).as_posix())
