"""The paper's procedure, steps 1 to 9, from a design file and a plant to everything a report needs.

Weight selection, synthesis, the controllers to compare with, and what is guaranteed of further plants. Reads
no files and prints nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from design.closed_loop.comparison import Candidate, Measures, Problem
from design.closed_loop.specifications import Reading, readings
from design.errors import DesignError, NotStabilisedError
from design.models.controller import Controller
from design.models.plant import Plant
from design.robustness import margins
from design.robustness.loop_shaping import shaped
from design.robustness.nu_gap import nu_gap
from design.search.bounds import Parameter, with_bounds
from design.search.searcher import Progress
from design.synthesis import baselines
from design.synthesis.design_file import DesignFile
from design.synthesis.fixed_structure import Synthesis, synthesise
from design.synthesis.structures import STRUCTURES, Structure, tustin_law
from design.synthesis.weight_selection import WeightSelection, select_weight

WEIGHT_STAGE, CONTROLLER_STAGE = "weight W1", "controller"

PI_EVALUATIONS = 1500
"""Enough of a search for the two parameters of the PI to compare with."""

OnProgress = Callable[[str, Progress, int], None]
"""Called after every generation with the stage, where it stands, and how many candidates it may judge."""


@dataclass(frozen=True)
class Guarantee:
    """What the ν-gap says of a further plant, and what is true of it."""

    plant: Plant
    gap: float
    """ν-gap between the shaped plants."""
    eps: float
    """Margin of the designed controller on the nominal plant."""
    eps_there: float
    """Its margin on this plant; 0 where it does not stabilise it."""

    @property
    def guaranteed(self) -> bool:
        """Whether the margin alone proves this plant stable under the designed controller."""
        return self.eps > self.gap


@dataclass(frozen=True)
class Design:
    """A finished design."""

    design_file: DesignFile
    plant: Plant
    weight: WeightSelection
    synthesis: Synthesis
    problem: Problem
    candidates: tuple[Candidate, ...]
    """The designed controller first, then those to compare with."""
    measures: tuple[Measures, ...]
    """Of each candidate."""
    designed_readings: tuple[Reading, ...]
    """The specifications, read off the designed loop (step 9)."""
    guarantees: tuple[Guarantee, ...]
    notes: tuple[str, ...]
    """What could not be compared, and why."""

    @property
    def designed(self) -> Candidate:
        """The controller that was designed."""
        return self.candidates[0]

    @property
    def eps(self) -> float:
        """Its margin, in the loop designed for."""
        return self.problem.eps(self.measures[0])


def design_controller(
    design_file: DesignFile,
    plant: Plant,
    further: Sequence[Plant] = (),
    on_progress: OnProgress | None = None,
) -> Design:
    """Design a controller for ``plant``. Raises DesignError where it cannot be done as asked."""
    specifications, sampling = design_file.specifications.asked_for(), design_file.sampling
    against = [plant, *further] if design_file.further_plants.worst_case else [plant]
    weight_structure, structure = design_file.weight_structure(), design_file.controller_structure()
    weight = select_weight(
        against,
        structure=weight_structure,
        specifications=specifications,
        sampling=sampling,
        gamma_factor=design_file.weight.gamma_factor,
        searcher=design_file.weight_searcher,
        on_progress=stage_progress(on_progress, WEIGHT_STAGE, design_file.search.weight_evaluations),
    )
    try:
        synthesis = synthesise(
            against,
            weight.weight,
            structure,
            specifications=specifications if design_file.controller.must_meet_specifications else (),
            aims=[s for s in specifications if not s.kind.reads_open_loop_shape],
            sampling=sampling,
            searcher=design_file.controller_searcher,
            on_progress=stage_progress(
                on_progress, CONTROLLER_STAGE, design_file.search.controller_evaluations
            ),
        )
    except NotStabilisedError as error:
        raise NotStabilisedError(f"{error}{_if_reversed(plant)}") from None
    problem = Problem(plant, weight.weight, sampling, design_file.rig_sampling)
    label = design_file.controller.structure.rpartition(":")[2]
    designed = of_structure(
        f"{label.upper() if label in STRUCTURES else label} (designed)",
        f"structure {label}, largest ε of eq. (13), {synthesis.search.searcher}{_setpoint_text(synthesis)}",
        structure,
        synthesis.values,
        problem,
    )
    others, notes = _compared(design_file, problem, against)
    candidates = (designed, *others)
    return Design(
        design_file=design_file,
        plant=plant,
        weight=weight,
        synthesis=synthesis,
        problem=problem,
        candidates=candidates,
        measures=tuple(problem.measure(candidate) for candidate in candidates),
        designed_readings=readings(specifications, problem.loops(designed.controller)),
        guarantees=tuple(_guarantee(problem, designed, other) for other in further),
        notes=tuple(notes),
    )


def of_structure(
    name: str, method: str, structure: Structure, values: Sequence[float], problem: Problem
) -> Candidate:
    """A candidate of a structure and its parameter values."""
    names = [parameter.name for parameter in structure.parameters]
    return Candidate(
        name,
        method,
        structure.controller(np.array([values], dtype=float)),
        structure.law(values, problem.rig_sampling.period_s),
        dict(zip(names, map(float, values), strict=True)),
    )


def of_polynomials(name: str, method: str, controller: Controller, problem: Problem) -> Candidate:
    """A candidate given by its polynomials in s, sampled by Tustin's rule."""
    return Candidate(name, method, controller, tustin_law(controller, problem.rig_sampling.period_s), {})


def stage_progress(
    on_progress: OnProgress | None, stage: str, evaluations: int, done: int = 0
) -> Callable[[Progress], None] | None:
    """What a searcher's driver calls for one stage, ``done`` of whose evaluations were used before."""
    if on_progress is None:
        return None
    return lambda p: on_progress(stage, replace(p, evaluations=done + p.evaluations), evaluations)


def _compared(
    design_file: DesignFile, problem: Problem, against: Sequence[Plant]
) -> tuple[list[Candidate], list[str]]:
    """HLS, the best PI, ZN and TLC, as far as they exist for this plant."""
    found, notes = [], []
    factor = design_file.weight.gamma_factor
    found.append(
        of_polynomials(
            "HLS",
            f"conventional H∞ loop shaping, K = W1 K∞ with γ = {factor:g} γ_opt",
            baselines.loop_shaping_controller(problem.loop_plant, problem.weight, factor),
            problem,
        )
    )
    if design_file.controller.structure != "pi":
        boxes = {
            name: Parameter(name, box.low, box.high, box.coding)
            for name, box in design_file.controller.box.items()
            if name in ("kp", "ki")
        }
        structure = with_bounds(STRUCTURES["pi"], boxes)
        try:
            best = synthesise(
                against,
                problem.weight,
                structure,
                sampling=problem.sampling,
                seed=design_file.search.seed,
                evaluations=PI_EVALUATIONS,
            )
        except DesignError as error:
            notes.append(f"PI: {error}")
        else:
            found.append(of_structure("PI", "PI of largest ε", structure, best.values, problem))
    try:
        cycle = baselines.ultimate_cycle(problem.loop_plant, problem.sampling)
    except DesignError as error:
        notes.append(f"ZN, TLC: {error}")
        return found, notes
    reached = f"Ku {cycle.gain:.4g}, Pu {cycle.period_s:.4g} s of this loop, N = {baselines.FILTER_N:g}"
    for name, rule, tune in (
        ("ZN", "Ziegler-Nichols", baselines.ziegler_nichols),
        ("TLC", "Tyreus-Luyben", baselines.tyreus_luyben),
    ):
        gains = tune(cycle)
        found.append(of_structure(name, f"{rule}: {reached}", STRUCTURES["pid"], gains.values, problem))
    return found, notes


def _setpoint_text(synthesis: Synthesis) -> str:
    """How the parameters that no margin sees were chosen."""
    if not synthesis.setpoint_parameters:
        return ""
    return (
        f"; {', '.join(synthesis.setpoint_parameters)}, which no margin sees: the specifications met where "
        "they can be, then least ∫ t |e| dt of a setpoint step"
    )


def _guarantee(problem: Problem, designed: Candidate, other: Plant) -> Guarantee:
    G, G_other = problem.loop_plant, other.transfer_function(problem.sampling)
    K, W = designed.controller.feedback, problem.weight
    return Guarantee(
        plant=other,
        gap=nu_gap(shaped(G, W), shaped(G_other, W)),
        eps=float(margins.stability_margin(G, K, W)[0]),
        eps_there=float(margins.stability_margin(G_other, K, W)[0]),
    )


def _if_reversed(plant: Plant) -> str:
    """A hint where the plant moves against its input."""
    if plant.gain_sign > 0.0:
        return ""
    return (
        "\nNote: the plant's gain is negative: reverse the valve or the potentiometer in the rig file and in "
        'the model, or give boxes below 0 with coding = "linear"'
    )
