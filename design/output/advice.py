"""What is said of a finished design: what speaks against running it, and what another search might do better.

Words alone; every figure in them comes from the design.
"""

from __future__ import annotations

import numpy as np

from design.closed_loop.comparison import eps_text
from design.synthesis.procedure import Design
from design.synthesis.weight_selection import LEAST_COMPATIBLE


def hints(design: Design) -> list[str]:
    """Return the warnings of the plants' files, and what another search might do better."""
    plants = [design.plant, *(guarantee.plant for guarantee in design.guarantees)]
    found = [f"plant {plant.name}: {warning}" for plant in plants for warning in plant.warnings]
    found += [
        f"{', '.join(names)} of the {what}: at a wall of the box; widen it, unless that is wanted, or "
        "see whether the plant is in other units than its file says"
        for what, names in (
            ("weight", design.weight.at_bounds),
            ("controller", design.synthesis.at_bounds),
        )
        if names
    ]
    found += [
        f"the search of the {what} was still gaining when its {search.evaluations} evaluations were used "
        f"up: raise search.{what}_evaluations"
        for what, search in (
            ("weight", design.weight.search),
            ("controller", design.synthesis.search),
        )
        if search.was_still_gaining
    ]
    return found


def warnings(design: Design) -> list[str]:
    """What speaks against running this controller, or asks for another design (steps 5 and 9)."""
    found = []
    if not design.weight.compatible:
        found.append(
            f"ε_opt {design.weight.eps_opt:.3f} is under {LEAST_COMPATIBLE}: these specifications leave no "
            "robust loop; relax them or change the weight structure"
        )
    elif design.eps < LEAST_COMPATIBLE and design.eps > 0.9 * design.problem.eps_opt:
        found.append(
            f"ε {design.eps:.3f} is under {LEAST_COMPATIBLE}, and no controller has more than "
            f"{design.problem.eps_opt:.3f} with this weight: relax the specifications"
        )
    elif design.eps < LEAST_COMPATIBLE:
        found.append(
            f"ε {design.eps:.3f} is under {LEAST_COMPATIBLE}: the structure does not suit the plant"
            + _without_integrator(design)
        )
    if design.problem.sampling is None and design.measures[0].eps_sampled < LEAST_COMPATIBLE:
        found.append(
            "in the rig's loop, with its hold and delay, ε is "
            f'{eps_text(design.measures[0].eps_sampled)}: set loop.design = "sampled"'
        )
    missed = [
        designed
        for selecting, designed in zip(design.weight.readings, design.designed_readings, strict=True)
        if selecting.reading == designed.reading and not designed.met
    ]
    if missed:
        found.append(
            "the designed loop misses what is specified:"
            + "".join(f"\n  {reading}" for reading in missed)
            + "\n  to have the search hold it, set controller.must_meet_specifications = true in the "
            "design file"
        )
    found += [
        f"plant {g.plant.name} is unstable under this controller"
        for g in design.guarantees
        if not g.eps_there
    ]
    return found


def _without_integrator(design: Design) -> str:
    """A hint where the weight asks for a gain at low frequency that the structure does not have."""
    feedback, W = design.designed.controller.feedback, design.problem.weight
    with np.errstate(divide="ignore"):
        own, wanted = (abs(np.ravel(H.num)[-1] / np.ravel(H.den)[-1]) for H in (feedback, W))
    if not own < 0.1 * wanted:
        return ""
    return (
        f"; at low frequency it has a gain of {own:.3g} where the weight asks for {wanted:.3g}: choose a "
        'structure with an integrator, or weight.structure = "p" or "lead-lag"'
    )
