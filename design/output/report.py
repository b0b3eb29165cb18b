"""Render the report of a design: one HTML file that refers to nothing outside itself.

This module collects what the template ``report.html`` shows; it computes nothing of the design. Table 1 of
the paper stands in the captions of the robustness figures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from design.closed_loop.comparison import Measures, delay_text, number_text, table_rows
from design.closed_loop.specifications import ROUNDING, Reading, Specification
from design.models.measured_record import ModelFit
from design.output.figures import Figure
from design.output.mathml import transfer_function_formula
from design.output.page import render_page
from design.output.provenance import versions
from design.paper.printed import is_paper_plant
from design.robustness.loop_shaping import shaped
from design.synthesis.procedure import Design
from design.synthesis.recommendation import Recommendation
from hil.core.documents import to_json

if TYPE_CHECKING:
    from design.paper.checked_claim import CheckedClaim

NO_RECORD = (
    "No measured record was given, so the model is not compared with one. To compare it: "
    "<code>hil design plant.json --measured record.csv</code>, with the columns <code>time_s,u,y</code>."
)


@dataclass(frozen=True)
class _Cell:
    """One value of the comparison table."""

    name: str
    """Name of the candidate."""
    text: str
    is_missed: bool
    """The value is outside its specification."""


@dataclass(frozen=True)
class _SpecificationRow:
    """One specification with its readings, for the loop that selects the weight and for the designed loop."""

    quantity: str
    limit: str
    reading: str
    selecting: str
    selecting_met: bool
    designed: str
    designed_met: bool
    is_judged: bool
    """The specification applies to the designed loop too."""


def render(
    design: Design,
    figures: Sequence[Figure],
    recommendation: Recommendation,
    *,
    title: str,
    measured: ModelFit | None = None,
    claims: Sequence[CheckedClaim] = (),
) -> str:
    """Return the report as HTML; ``claims`` are the paper's, for the report of its reproduction."""
    problem = design.problem
    G, dead_time_s = design.plant.rational_part, design.plant.dead_time_s
    return render_page(
        "report.html",
        title=title,
        design=design,
        is_paper=is_paper_plant(design.plant),
        eps=design.eps,
        eps_opt=problem.eps_opt,
        cards=_cards(design.measures[0]),
        parameters=_parameters_text(design.designed.parameters),
        recommendation=recommendation,
        specifications=_specification_rows(design),
        table=_comparison_table(design),
        figures=figures,
        no_record=NO_RECORD if measured is None else "",
        claims=claims,
        plant_tf=transfer_function_formula(G, "G", dead_time_s),
        weight_tf=transfer_function_formula(problem.weight, "W 1"),
        shaped_tf=transfer_function_formula(shaped(G, problem.weight), "G s", dead_time_s),
        delay=delay_text(problem.rig_sampling, design.plant),
        laws=[(c.name, c.method, _parameters_text(c.parameters), to_json(c.law)) for c in design.candidates],
        design_file=to_json(design.design_file),
        versions=versions(),
        guaranteed_gain_db=20.0 * float(np.log10((1.0 + design.eps) / (1.0 - design.eps))),
        guaranteed_phase_deg=2.0 * float(np.degrees(np.arcsin(design.eps))),
    )


def _comparison_table(design: Design) -> list[tuple[str, str, list[_Cell]]]:
    """Return label, unit and cells of each row."""
    limits = {s.quantity: s.limit for s in design.design_file.specifications.requested()}

    def is_missed(quantity: str | None, value: float) -> bool:
        return quantity in limits and not value <= limits[quantity] * (1.0 + ROUNDING)

    return [
        (
            row.label,
            row.unit,
            [
                _Cell(candidate.name, row.text(measures), is_missed(row.specified_as, row.value(measures)))
                for candidate, measures in zip(design.candidates, design.measures, strict=True)
            ],
        )
        for row in table_rows(design.plant.output_unit)
    ]


def _specification_rows(design: Design) -> list[_SpecificationRow]:
    specifications = design.design_file.specifications.requested()
    is_binding = design.design_file.controller.must_meet_specifications
    nyquist_rad_s = design.measures[0].nyquist_rad_s
    rows = []
    for specification, selecting, designed in zip(
        specifications, design.weight.readings, design.designed_readings, strict=True
    ):
        is_same = selecting.reading == designed.reading
        rows.append(
            _SpecificationRow(
                quantity=specification.quantity,
                limit=_limit_text(specification),
                reading=selecting.reading,
                selecting=_reading_text(selecting, nyquist_rad_s),
                selecting_met=selecting.met,
                designed=_reading_text(designed, nyquist_rad_s) + ("" if is_same else ", of GK"),
                designed_met=designed.met,
                is_judged=is_same or is_binding,
            )
        )
    return rows


def _limit_text(specification: Specification) -> str:
    sign = "≤" if specification.kind.is_upper_limit else "≥"
    return f"{sign} {specification.limit:g} {specification.kind.unit}".rstrip()


def _reading_text(reading: Reading, nyquist_rad_s: float) -> str:
    if reading.unit == "rad/s" and not np.isfinite(reading.value):
        return _no_crossing_text(nyquist_rad_s)
    return reading.value_text


def _no_crossing_text(nyquist_rad_s: float) -> str:
    if np.isfinite(nyquist_rad_s):
        return f"above the Nyquist frequency {nyquist_rad_s:.1f} rad/s"
    return "no crossing"


def _parameters_text(parameters: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.6g}" for name, value in parameters.items())


def _cards(m: Measures) -> dict[str, str]:
    """Return the figures of the summary at the top."""
    if not np.isfinite(m.bandwidth_rad_s):
        bandwidth = _no_crossing_text(m.nyquist_rad_s)
    else:
        bandwidth = f"at {number_text(m.bandwidth_rad_s, 2)} rad/s"
    return {
        "gain": number_text(20.0 * float(np.log10(m.gain_margin)), 1),
        "phase": number_text(float(np.degrees(m.phase_margin_rad)), 0),
        "settling": number_text(m.settling_s, 2),
        "overshoot": number_text(100.0 * m.overshoot, 2, vanishing=True),
        "error": number_text(100.0 * m.error, 3, vanishing=True),
        "disturbance": number_text(m.disturbance_peak, 4),
        "bandwidth": bandwidth,
    }
