"""The paper's design procedure, steps 1 to 9: from a design file and a plant to a finished design.

:func:`design_controller` selects the weight, synthesises the structured controller, designs the controllers
for comparison, and computes what is guaranteed for further plants. This module reads no files and prints
nothing; ``design.output.results`` writes the results.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from design.closed_loop.comparison import Candidate, Measures, Problem, delay_text
from design.closed_loop.specifications import Reading, readings
from design.errors import DesignError, NotStabilisedError
from design.models.controller import Controller
from design.models.plant import Plant
from design.robustness import margins
from design.robustness.loop_shaping import shaped
from design.robustness.nu_gap import nu_gap
from design.search.bounds import with_bounds
from design.search.searcher import Progress
from design.synthesis import baselines
from design.synthesis.design_file import DesignFile
from design.synthesis.fixed_structure import Synthesis, synthesise
from design.synthesis.search_ranges import search_parameters
from design.synthesis.structures import STRUCTURES, Structure, tustin_law
from design.synthesis.weight_selection import WeightSelection, select_weight

WEIGHT_STAGE, CONTROLLER_STAGE = "weight W1", "controller"

PI_EVALUATIONS = 1500
"""Evaluations for the PI that is compared; its two parameters need no more."""

OnProgress = Callable[[str, Progress, int], None]
"""Function of the stage, the progress of its search, and the largest number of candidates of the stage.

It is called after every generation.
"""


@dataclass(frozen=True)
class Guarantee:
    """Guarantee that the ν-gap gives for a further plant, and the margin that the controller has on it."""

    plant: Plant
    gap: float
    """ν-gap between the shaped plants."""
    eps: float
    """Margin of the designed controller on the nominal plant."""
    eps_there: float
    """Margin of the designed controller on this plant; 0 where it does not stabilise it."""

    @property
    def guaranteed(self) -> bool:
        """True if the margin on the nominal plant alone proves that this plant is stabilised."""
        return self.eps > self.gap


@dataclass(frozen=True)
class Design:
    """A finished design: everything that reports and controller files are made from."""

    design_file: DesignFile
    plant: Plant
    """Nominal plant."""
    weight: WeightSelection
    synthesis: Synthesis
    problem: Problem
    """Plant, weight and loop that all candidates share."""
    candidates: tuple[Candidate, ...]
    """The designed controller, followed by the controllers for comparison."""
    measures: tuple[Measures, ...]
    """Measures of each candidate, in the order of ``candidates``."""
    designed_readings: tuple[Reading, ...]
    """Specifications, read off the designed loop (step 9)."""
    guarantees: tuple[Guarantee, ...]
    """Guarantee for each further plant."""
    notes: tuple[str, ...]
    """Controllers that could not be designed for comparison, each with the reason."""

    @property
    def designed(self) -> Candidate:
        """The designed controller."""
        return self.candidates[0]

    @property
    def eps(self) -> float:
        """Margin of the designed controller in the loop that it was designed in."""
        return self.problem.eps(self.measures[0])

    @property
    def loop_description(self) -> str:
        """The loop that the controller was designed in, in words."""
        rig = self.problem.rig_sampling
        sampled = f"zero-order hold at {rig.period_s:g} s, {delay_text(rig, self.plant)}, K by Tustin's rule"
        if self.problem.sampling is None:
            return f"continuous (the rig's loop, for comparison: {sampled})"
        return f"sampled: {sampled}"


def design_controller(
    design_file: DesignFile,
    plant: Plant,
    further_plants: Sequence[Plant] = (),
    on_progress: OnProgress | None = None,
) -> Design:
    """Design a controller for a plant: the Python entry to everything that ``hil design`` computes.

    ``design_file`` holds the loop, the specifications, the structures, the search and its seed;
    ``DesignFile()`` is the paper's design in the loop of the shipped rig, and ``read_design(text, source)``
    reads one. ``further_plants`` are models of the same axis under other conditions, in the same unit. The
    design is against all plants if ``design_file.further_plants.worst_case`` is true; otherwise ``plant``
    alone is designed for, and ``Design.guarantees`` says what holds for the others.
    ``design_file.further_plants.files`` is not read here. ``on_progress`` is called after every generation of
    the two searches, with the stage (:data:`WEIGHT_STAGE`, :data:`CONTROLLER_STAGE`), its progress, and the
    largest number of candidates.

    The result is the same for the same arguments. ``design.synthesis.recommendation.recommend`` says whether
    its controller should be run, and ``design.output.results.write_design`` writes it to a folder.

    Raises InfeasibleError if no candidate meets the specifications, NotStabilisedError if none stabilises
    every plant, and DesignError or DocumentError if the design file asks for something impossible.
    """
    specifications, sampling = design_file.specifications.requested(), design_file.sampling
    plants = [plant, *further_plants] if design_file.further_plants.worst_case else [plant]
    structure = design_file.controller_structure()
    weight = select_weight(
        plants,
        structure=design_file.weight_structure(),
        specifications=specifications,
        sampling=sampling,
        gamma_factor=design_file.weight.gamma_factor,
        searcher=design_file.weight_searcher,
        on_progress=stage_progress(on_progress, WEIGHT_STAGE, design_file.search.weight_evaluations),
    )
    try:
        synthesis = synthesise(
            plants,
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
        raise NotStabilisedError(f"{error}{_negative_gain_note(plant)}") from None
    problem = Problem(plant, weight.weight, sampling, design_file.rig_sampling)
    designed = _designed_candidate(design_file, synthesis, problem)
    others, notes = _comparison_candidates(design_file, problem, plants)
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
        guarantees=tuple(_guarantee(problem, designed, other) for other in further_plants),
        notes=tuple(notes),
    )


def structured_candidate(
    name: str, method: str, structure: Structure, values: Sequence[float], problem: Problem
) -> Candidate:
    """Return the candidate with a structure and its parameter values."""
    names = [parameter.name for parameter in structure.parameters]
    return Candidate(
        name,
        method,
        structure.controller(np.array([values], dtype=float)),
        structure.law(values, problem.rig_sampling.period_s),
        dict(zip(names, map(float, values), strict=True)),
    )


def polynomial_candidate(name: str, method: str, controller: Controller, problem: Problem) -> Candidate:
    """Return the candidate with given polynomials in s, which runs by Tustin's rule."""
    return Candidate(name, method, controller, tustin_law(controller, problem.rig_sampling.period_s), {})


def stage_progress(
    on_progress: OnProgress | None, stage: str, evaluations: int, done: int = 0
) -> Callable[[Progress], None] | None:
    """Return what a search calls to report its progress as that of a stage.

    ``done`` is the number of the stage's evaluations that earlier searches used.
    """
    if on_progress is None:
        return None
    return lambda p: on_progress(stage, replace(p, evaluations=done + p.evaluations), evaluations)


def _designed_candidate(design_file: DesignFile, synthesis: Synthesis, problem: Problem) -> Candidate:
    label = design_file.controller.structure.rpartition(":")[2]
    method = f"structure {label}, largest ε of eq. (13), {synthesis.search.searcher}"
    if synthesis.setpoint_parameters:
        method += (
            f"; {', '.join(synthesis.setpoint_parameters)}, on which no margin depends: the specifications "
            "met if possible, then least ∫ t |e| dt after a setpoint step"
        )
    return structured_candidate(
        f"{label.upper() if label in STRUCTURES else label} (designed)",
        method,
        synthesis.structure,
        synthesis.values,
        problem,
    )


def _comparison_candidates(
    design_file: DesignFile, problem: Problem, plants: Sequence[Plant]
) -> tuple[list[Candidate], list[str]]:
    """Return HLS, the best PI, ZN and TLC, and a note for each of them that does not exist for this plant."""
    factor = design_file.weight.gamma_factor
    candidates = [
        polynomial_candidate(
            "HLS",
            f"conventional H∞ loop shaping, K = W1 K∞ with γ = {factor:g} γ_opt",
            baselines.loop_shaping_controller(problem.loop_plant, problem.weight, factor),
            problem,
        )
    ]
    notes = []
    if design_file.controller.structure != "pi":
        try:
            candidates.append(_best_pi(design_file, problem, plants))
        except DesignError as error:
            notes.append(f"PI: {error}")
    try:
        candidates += _tuning_rules(problem)
    except DesignError as error:
        notes.append(f"ZN, TLC: {error}")
    return candidates, notes


def _best_pi(design_file: DesignFile, problem: Problem, plants: Sequence[Plant]) -> Candidate:
    """Return the PI of largest margin, in the search ranges that the design file gives for kp and ki."""
    ranges = search_parameters(design_file.controller.search_ranges)
    shared = {name: parameter for name, parameter in ranges.items() if name in ("kp", "ki")}
    structure = with_bounds(STRUCTURES["pi"], shared)
    best = synthesise(
        plants,
        problem.weight,
        structure,
        sampling=problem.sampling,
        seed=design_file.search.seed,
        evaluations=PI_EVALUATIONS,
    )
    return structured_candidate("PI", "PI of largest ε", structure, best.values, problem)


def _tuning_rules(problem: Problem) -> list[Candidate]:
    cycle = baselines.ultimate_cycle(problem.loop_plant, problem.sampling)
    basis = f"Ku {cycle.gain:.4g}, Pu {cycle.period_s:.4g} s of this loop, N = {baselines.FILTER_N:g}"
    pid = STRUCTURES["pid"]
    zn, tlc = baselines.ziegler_nichols(cycle), baselines.tyreus_luyben(cycle)
    return [
        structured_candidate("ZN", f"Ziegler-Nichols: {basis}", pid, zn.values, problem),
        structured_candidate("TLC", f"Tyreus-Luyben: {basis}", pid, tlc.values, problem),
    ]


def _guarantee(problem: Problem, designed: Candidate, other: Plant) -> Guarantee:
    G, G_other = problem.loop_plant, other.transfer_function(problem.sampling)
    K, W = designed.controller.feedback, problem.weight
    return Guarantee(
        plant=other,
        gap=nu_gap(shaped(G, W), shaped(G_other, W)),
        eps=float(margins.stability_margin(G, K, W)[0]),
        eps_there=float(margins.stability_margin(G_other, K, W)[0]),
    )


def _negative_gain_note(plant: Plant) -> str:
    """Return a note for a plant that moves against its input; empty for any other."""
    if plant.gain_sign > 0.0:
        return ""
    return (
        "\nNote: the plant's gain is negative. Reverse the valve or the potentiometer in the rig file and "
        'in the model, or give search ranges below 0 with coding = "linear"'
    )
