"""Recommend what to do with a finished design: run its controller or not, and what may improve it.

The decision is made here, from figures that the design contains; printers and reports only show it. This is
step 5 (is the weight compatible?) and step 9 (does the loop meet the specifications?) of the paper's
procedure. The rig's loop, further plants and a measured record are judged too.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from design.closed_loop.comparison import Measures, eps_text
from design.models.measured_record import ModelFit
from design.synthesis.procedure import Design
from design.synthesis.weight_selection import MIN_EPS


class Action(Enum):
    """Recommended action with the designed controller."""

    RUN = "run"
    """Run the controller; there is no objection."""
    DO_NOT_RUN = "do not run"
    """Do not run the controller, because of the objections; it is written to a file nevertheless."""
    UNSTABLE = "unstable"
    """Do not run the controller: its loop is unstable on the rig, and it is not written to a file."""


@dataclass(frozen=True)
class Recommendation:
    """Recommendation on a finished design: an action, its reasons, and hints for another search."""

    action: Action
    objections: tuple[str, ...]
    """Reasons against running the designed controller, each with a remedy."""
    warnings: tuple[str, ...]
    """Warnings that the plant files contain, each with the name of its plant."""
    hints: tuple[str, ...]
    """Changes to the design file that may give a larger margin."""
    unstable: tuple[str, ...]
    """Names of the candidates whose loop is unstable on the rig; they are not written to files."""


def recommend(design: Design, measured: ModelFit | None = None) -> Recommendation:
    """Return the recommendation on a design.

    ``measured`` is a record of the plant beside its model; a poor fit is an objection.
    """
    objections = [
        *_margin_objections(design),
        *_specification_objections(design),
        *(
            f"plant {guarantee.plant.name} is unstable with this controller: set further_plants.worst_case = "
            "true in the design file to design against it, or remove it from further_plants.files"
            for guarantee in design.guarantees
            if not guarantee.eps_there
        ),
    ]
    if measured is not None and measured.doubt:
        objections.append(measured.doubt)
    unstable = tuple(
        candidate.name
        for candidate, measures in zip(design.candidates, design.measures, strict=True)
        if is_unstable_on_rig(measures)
    )
    if design.designed.name in unstable:
        action = Action.UNSTABLE
    else:
        action = Action.DO_NOT_RUN if objections else Action.RUN
    return Recommendation(
        action, tuple(objections), tuple(_plant_warnings(design)), tuple(_hints(design)), unstable
    )


def is_unstable_on_rig(measures: Measures) -> bool:
    """Return whether the rig's loop (hold, period, delay) is unstable, according to the plant's model."""
    return not measures.eps_sampled > 0.0


def _margin_objections(design: Design) -> list[str]:
    objections = []
    eps, eps_opt = design.eps, design.problem.eps_opt
    if not design.weight.is_compatible:
        objections.append(
            f"ε_opt {design.weight.eps_opt:.3f} is below {MIN_EPS}: no loop that meets these specifications "
            "is robust; relax them, or change weight.structure in the design file"
        )
    elif eps < MIN_EPS and eps > 0.9 * eps_opt:
        objections.append(
            f"ε {eps:.3f} is below {MIN_EPS}, and no controller has more than {eps_opt:.3f} with this "
            "weight: relax the specifications"
        )
    elif eps < MIN_EPS:
        objections.append(
            f"ε {eps:.3f} is below {MIN_EPS}: the controller structure does not suit the plant; choose "
            f"another controller.structure{_missing_integrator(design)}"
        )
    eps_on_rig = design.measures[0].eps_sampled
    if design.problem.sampling is None and eps_on_rig < MIN_EPS:
        objections.append(
            f"in the rig's loop, with its hold and delay, ε is {eps_text(eps_on_rig)}, below {MIN_EPS}: set "
            'loop.design = "sampled" in the design file'
        )
    return objections


def _specification_objections(design: Design) -> list[str]:
    """Return an objection if the designed loop misses a specification that is judged on it."""
    missed = [
        designed
        for selecting, designed in zip(design.weight.readings, design.designed_readings, strict=True)
        if selecting.reading == designed.reading and not designed.met
    ]
    if not missed:
        return []
    return [
        "the designed loop misses specifications:"
        + "".join(f"\n  {reading}" for reading in missed)
        + "\n  set controller.must_meet_specifications = true in the design file to make the search meet them"
    ]


def _missing_integrator(design: Design) -> str:
    """Return a note if the weight has a gain at low frequency that the controller structure lacks."""
    feedback, W = design.designed.controller.feedback, design.problem.weight
    with np.errstate(divide="ignore"):
        own, of_weight = (abs(np.ravel(H.num)[-1] / np.ravel(H.den)[-1]) for H in (feedback, W))
    if not own < 0.1 * of_weight:
        return ""
    return (
        f". At low frequency the controller has a gain of {own:.3g} and the weight one of {of_weight:.3g}: a "
        'structure with an integrator suits, or weight.structure = "p" or "lead-lag"'
    )


def _plant_warnings(design: Design) -> list[str]:
    plants = [design.plant, *(guarantee.plant for guarantee in design.guarantees)]
    return [f"plant {plant.name}: {warning}" for plant in plants for warning in plant.warnings]


def _hints(design: Design) -> list[str]:
    parts = (("weight", design.weight), ("controller", design.synthesis))
    hints = [
        f"{', '.join(part.at_bounds)} of the {name}: at a search bound; widen {name}.search_ranges in the "
        "design file unless the bound is intended, and check that the plant file states the right units"
        for name, part in parts
        if part.at_bounds
    ]
    hints += [
        f"the search for the {name} was still improving when it had used its {part.search.evaluations} "
        f"evaluations: raise search.{name}_evaluations in the design file"
        for name, part in parts
        if part.search.was_still_gaining
    ]
    return hints
