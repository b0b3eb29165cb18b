"""Choose the figures that a design gets, and number them as in the paper if the plant is the paper's."""

from __future__ import annotations

from dataclasses import replace

from design.models.measured_record import ModelFit
from design.output.figures import (
    Figure,
    candidate_styles,
    convergence,
    identification,
    open_loops,
    robustness,
    step_responses,
)
from design.paper.printed import is_paper_plant
from design.synthesis.procedure import Design

PAPER_NUMBERS = {
    "identification": "Fig. 5",
    "weight-convergence": "Fig. 6",
    "open-loops": "Fig. 7",
    "controller-convergence": "Fig. 8",
    "tuning-rules": "Fig. 9",
    "step-responses": "Fig. 10",
    "multiplicative-perturbation": "Fig. 11 (a)",
    "additive-perturbation": "Fig. 11 (b)",
    "disturbance-gain": "Fig. 11 (c)",
}
"""Keys of all figures, in the order of the report, and the paper's figures that they correspond to."""

TUNED = ("ZN", "TLC")
"""Names of the candidates from tuning rules, which have a figure of step responses of their own."""
_NOT_IN_BODE_DIAGRAM = (*TUNED, "PI")


def design_figures(design: Design, measured: ModelFit | None = None) -> list[Figure]:
    """Draw the figures of a design in the order of :data:`PAPER_NUMBERS`.

    ``identification`` needs a measured record; ``tuning-rules`` needs a tuning rule with a stable loop. The
    titles bear the paper's figure numbers only if the plant is the paper's.
    """
    figures = [
        *([identification(measured, design.plant.output_unit)] if measured is not None else []),
        *_search_and_loop_figures(design),
        *_step_figures(design),
        *_robustness_figures(design),
    ]
    if not is_paper_plant(design.plant):
        return figures
    return [replace(figure, title=f"{PAPER_NUMBERS[figure.key]}. {figure.title}") for figure in figures]


def _search_and_loop_figures(design: Design) -> list[Figure]:
    shown = [c for c in design.candidates if c.name not in _NOT_IN_BODE_DIAGRAM]
    return [
        convergence(
            design.weight.search,
            "weight-convergence",
            "Convergence of weight selection",
            "best ε_opt",
            None,
        ),
        open_loops(design.problem, shown, candidate_styles(design.candidates)),
        convergence(
            design.synthesis.search,
            "controller-convergence",
            "Convergence of the synthesis",
            "best ε",
            design.synthesis.eps_opt,
        ),
    ]


def _step_figures(design: Design) -> list[Figure]:
    stable = [pair for pair in zip(design.candidates, design.measures, strict=True) if pair[1].stable]
    tuned = [pair for pair in stable if pair[0].name in TUNED]
    others = [pair for pair in stable if pair[0].name not in TUNED]
    styles = candidate_styles(design.candidates)
    specifications = design.design_file.specifications.requested()
    figures = []
    if tuned:
        figures.append(
            step_responses(
                "tuning-rules",
                "Step responses, Ziegler-Nichols and Tyreus-Luyben",
                "Controllers that the tuning rules give for the same loop.",
                design.problem,
                tuned,
                styles,
                specifications,
            )
        )
    figures.append(
        step_responses(
            "step-responses",
            f"Step responses, {design.designed.name} and loop shaping",
            "The structured controller beside the full-order controller that it approximates.",
            design.problem,
            others,
            styles,
            specifications,
        )
    )
    return figures


def _robustness_figures(design: Design) -> tuple[Figure, Figure, Figure]:
    stable = [c for c, measures in zip(design.candidates, design.measures, strict=True) if measures.stable]
    return robustness(design.problem, stable, candidate_styles(design.candidates))
