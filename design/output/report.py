"""The report of a design: one HTML file without references to anything outside it.

Gathers what the template says and the figures; no mathematics of its own. Table 1 of the paper stands in the
captions of Fig. 11.
"""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib import resources
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from design.closed_loop.comparison import Measures, delay_text, number_text, table_rows
from design.closed_loop.specifications import ROUNDING, Specification
from design.mathematics.polynomials import Array
from design.models.measured_record import ModelFit
from design.models.transfer_function import TransferFunction
from design.output import figures
from design.output.advice import hints, warnings
from design.output.figures import Figure
from design.robustness.loop_shaping import shaped
from design.synthesis.procedure import Design
from hil.core.documents import to_json

if TYPE_CHECKING:
    from design.paper.verdicts import Verdict

NO_RECORD = (
    "Fig. 5 compares the model with a measured record, and none was given: "
    "<code>hil design plant.json --measured record.csv</code>, columns <code>time_s,u,y</code>."
)


TUNED = ("ZN", "TLC")
"""Candidates of Fig. 9; the others are in Fig. 10."""


def design_figures(design: Design, measured: ModelFit | None = None) -> list[Figure]:
    """Figs 5 to 11 for this design, in the paper's order; Fig. 5 only with a record."""
    problem, specifications = design.problem, design.design_file.specifications.asked_for()
    styles = figures.styles(design.candidates)
    pairs = list(zip(design.candidates, design.measures, strict=True))
    stable = [pair for pair in pairs if pair[1].stable]
    tuned = [pair for pair in stable if pair[0].name in TUNED]
    shaped_ones = [pair for pair in stable if pair[0].name not in TUNED]
    followed = [candidate for candidate, _ in pairs if candidate.name not in (*TUNED, "PI")]
    found = [figures.identification(measured, design.plant.output_unit)] if measured is not None else []
    found += [
        figures.convergence(
            design.weight.search,
            "fig6-weight-convergence",
            "Fig. 6. Convergence of weight selection",
            "best ε_opt",
            None,
        ),
        figures.open_loops(problem, followed, styles),
        figures.convergence(
            design.synthesis.search,
            "fig8-convergence",
            "Fig. 8. Convergence of the synthesis",
            "best ε",
            design.synthesis.eps_opt,
        ),
    ]
    if tuned:
        found.append(
            figures.steps(
                "fig9-tuning-rules",
                "Fig. 9. Step responses, Ziegler-Nichols and Tyreus-Luyben",
                "What rules of thumb give on the same loop.",
                problem,
                tuned,
                styles,
                specifications,
            )
        )
    found.append(
        figures.steps(
            "fig10-steps",
            f"Fig. 10. Step responses, {design.designed.name} and loop shaping",
            "The structured controller beside the full-order one that it approximates.",
            problem,
            shaped_ones,
            styles,
            specifications,
        )
    )
    found += figures.robustness(problem, [candidate for candidate, _ in stable], styles)
    return found


def render(
    design: Design,
    drawn: Sequence[Figure],
    *,
    title: str,
    measured: ModelFit | None = None,
    verdicts: Sequence[Verdict] = (),
) -> str:
    """The report as HTML."""
    from jinja2 import Environment

    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string(
        resources.files("design.output").joinpath("report.html").read_text("utf-8")
    )
    problem = design.problem
    rows = table_rows(design.plant.output_unit)
    limits = {s.quantity: s.limit for s in design.design_file.specifications.asked_for()}
    return template.render(
        title=title,
        design=design,
        eps=design.eps,
        eps_opt=problem.eps_opt,
        cards=_cards(design.measures[0]),
        warnings=warnings(design),
        hints=hints(design),
        specifications=_specification_rows(design),
        table=[
            (
                row,
                [
                    (
                        row.text(m),
                        row.specified_as in limits
                        and not row.value(m) <= limits[row.specified_as or ""] * (1.0 + ROUNDING),
                    )
                    for m in design.measures
                ],
            )
            for row in rows
        ],
        figures=drawn,
        no_record=NO_RECORD if measured is None else "",
        verdicts=verdicts,
        plant_tf=mathml(design.plant.rational_part, "G", design.plant.dead_time_s),
        weight_tf=mathml(problem.weight, "W 1"),
        shaped_tf=mathml(shaped(design.plant.rational_part, problem.weight), "G s", design.plant.dead_time_s),
        loop=loop_text(design),
        delay=delay_text(problem.rig_sampling),
        laws=[(c.name, c.method, _parameters(c.parameters), to_json(c.law)) for c in design.candidates],
        design_file=to_json(design.design_file),
        versions=versions(),
        guaranteed_gain_db=20.0 * float(np.log10((1.0 + design.eps) / (1.0 - design.eps))),
        guaranteed_phase_deg=2.0 * float(np.degrees(np.arcsin(design.eps))),
    )


def versions() -> dict[str, str]:
    """Of what a result depends on."""
    names = ("pneumatic-hil", "numpy", "scipy")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}


def loop_text(design: Design) -> str:
    """The loop that was designed for, in words."""
    rig = design.problem.rig_sampling
    sampled = f"zero-order hold at {rig.period_s:g} s, {delay_text(rig, design.plant)}, K by Tustin's rule"
    if design.problem.sampling is None:
        return f"continuous (the rig's loop, for comparison: {sampled})"
    return f"sampled: {sampled}"


def mathml(H: TransferFunction, name: str, dead_time_s: float = 0.0) -> str:
    """Return H(s) with its dead time as MathML; ``name`` is a symbol and its index, such as "W 1"."""
    symbol, _, index = name.partition(" ")
    head = f"<msub><mi>{symbol}</mi><mi>{index}</mi></msub>" if index else f"<mi>{symbol}</mi>"
    argument = '<mo stretchy="false">(</mo><mi>s</mi><mo stretchy="false">)</mo>'
    num, den = (f"<mrow>{_polynomial(np.ravel(p))}</mrow>" for p in H)
    delay = (
        f"<msup><mi>e</mi><mrow><mo>−</mo><mn>{dead_time_s:.5g}</mn><mi>s</mi></mrow></msup>"
        if dead_time_s
        else ""
    )
    fraction = f"<mfrac>{num}{den}</mfrac>{delay}"
    return f'<math display="block"><mrow>{head}{argument}<mo>=</mo>{fraction}</mrow></math>'


def _polynomial(p: Array) -> str:
    terms: list[str] = []
    for i, coefficient in enumerate(p.tolist()):
        power = len(p) - 1 - i
        if coefficient == 0.0:
            continue
        sign = "−" if coefficient < 0.0 else ("+" if terms else "")
        size = f"{abs(coefficient):.5g}"
        number = "" if size == "1" and power else f"<mn>{size}</mn>"
        symbol = {0: "", 1: "<mi>s</mi>"}.get(power, f"<msup><mi>s</mi><mn>{power}</mn></msup>")
        terms.append((f"<mo>{sign}</mo>" if sign else "") + number + symbol)
    return "".join(terms) or "<mn>0</mn>"


def _specification_rows(design: Design) -> list[dict[str, str | bool]]:
    """Each specification with its reading, for the loop that selects the weight and for the designed one."""
    asked = design.design_file.specifications.asked_for()
    binding = design.design_file.controller.must_meet_specifications
    rows: list[dict[str, str | bool]] = []
    for specification, selecting, designed in zip(
        asked, design.weight.readings, design.designed_readings, strict=True
    ):
        same = selecting.reading == designed.reading
        rows.append(
            {
                "quantity": specification.quantity,
                "limit": _limit(specification),
                "reading": selecting.reading,
                "selecting": selecting.value_text,
                "selecting_met": selecting.met,
                "designed": designed.value_text + ("" if same else ", of GK"),
                "judged": same or binding,
                "designed_met": designed.met,
            }
        )
    return rows


def _limit(specification: Specification) -> str:
    sign = "≤" if specification.kind.is_upper_limit else "≥"
    return f"{sign} {specification.limit:g} {specification.kind.unit}".rstrip()


def _parameters(parameters: object) -> str:
    return ", ".join(f"{name} {value:.6g}" for name, value in dict(parameters).items())  # type: ignore[call-overload]


def _cards(m: Measures) -> dict[str, str]:
    return {
        "gain": number_text(20.0 * float(np.log10(m.gain_margin)), 1),
        "phase": number_text(float(np.degrees(m.phase_margin_rad)), 0),
        "settling": number_text(m.settling_s, 2),
        "overshoot": number_text(100.0 * m.overshoot, 2, vanishing=True),
        "error": number_text(100.0 * m.error, 3, vanishing=True),
        "disturbance": number_text(m.disturbance_peak, 4),
        "bandwidth": number_text(m.bandwidth_rad_s, 2),
    }
