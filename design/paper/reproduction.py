"""Repeat the paper's own design: its weight and controllers, its searches, and the true optima.

The paper does not say to which loop the specifications of eq. (9) refer. Here gain and crossover are those of
the shaped plant, and times those of the closed loop with K = W1 K∞, which fits the printed figures best.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import resources

from design.closed_loop.comparison import Candidate, Problem
from design.closed_loop.loops import ClosedLoops
from design.closed_loop.specifications import readings
from design.models.controller import one_degree_of_freedom
from design.models.plant import Plant, paper_plant
from design.models.sampling import Sampling
from design.paper import printed
from design.paper.checked_claim import CheckedClaim
from design.paper.claims import check_claims
from design.paper.evidence import Evidence
from design.paper.searches import run_searches
from design.robustness.loop_shaping import shaped
from design.search.searcher import Progress
from design.synthesis import baselines
from design.synthesis.design_file import DesignFile, read_design
from design.synthesis.fixed_structure import Synthesis, synthesise
from design.synthesis.procedure import (
    PI_EVALUATIONS,
    Design,
    OnProgress,
    polynomial_candidate,
    stage_progress,
    structured_candidate,
)
from design.synthesis.structures import STRUCTURES
from design.synthesis.weight_selection import WeightSelection, select_weight

PAPER_DESIGN = "paper.toml"


@dataclass(frozen=True)
class Reproduction:
    """The repeated design, the evidence that was computed, and the checked claims."""

    design: Design
    """The paper's design with the printed weight and controllers, for the report."""
    evidence: Evidence
    claims: tuple[CheckedClaim, ...]

    @property
    def agreeing(self) -> int:
        """Number of claims that are reproduced."""
        return sum(claim.agrees for claim in self.claims)

    @property
    def failed(self) -> int:
        """Number of claims that must agree and do not."""
        return sum(claim.has_failed for claim in self.claims)

    @property
    def explained(self) -> int:
        """Number of claims that differ for a reason that is given."""
        return len(self.claims) - self.agreeing - self.failed


def paper_design_file() -> DesignFile:
    """Return Sec. IV as a design file: continuous loop, linear search ranges, the genetic algorithm."""
    return read_design(
        resources.files("design.paper").joinpath(PAPER_DESIGN).read_text("utf-8"), PAPER_DESIGN
    )


def reproduce(on_progress: OnProgress | None = None) -> Reproduction:
    """Repeat the paper's design and check every figure that it prints."""

    def stage(name: str, evaluations: int) -> Callable[[Progress], None] | None:
        return stage_progress(on_progress, name, evaluations)

    plant, design_file = paper_plant(), paper_design_file()
    pid, pi = STRUCTURES["pid"], STRUCTURES["pi"]
    searches = run_searches(design_file, plant, printed.W1, on_progress)
    best_weight = select_weight(plant, on_progress=stage("optimum, W1", 2000))
    optimum = synthesise(plant, printed.W1, pid, on_progress=stage("optimum, PID", 6000))
    best_pi = synthesise(plant, printed.W1, pi, evaluations=PI_EVALUATIONS)

    problem = Problem(plant, printed.W1, None, design_file.rig_sampling)
    candidates = _candidates(problem, optimum, best_pi)
    measures = tuple(problem.measure(candidate) for candidate in candidates)
    # The report shows the printed weight and controllers; of the searches it shows the median runs.
    weight = _printed_weight(problem, design_file, searches.typical_weight or best_weight)
    specifications = design_file.specifications.requested()
    design = Design(
        design_file=design_file,
        plant=plant,
        weight=weight,
        synthesis=replace(searches.typical_controller, at_bounds=()),
        problem=problem,
        candidates=candidates,
        measures=measures,
        designed_readings=readings(specifications, problem.loops(candidates[0].controller)),
        guarantees=(),
        notes=(),
    )
    evidence = Evidence(
        plant=plant,
        problem=problem,
        weight_readings=weight.readings,
        searches=searches,
        best_weight=best_weight,
        optimum=optimum,
        candidates={candidate.name: candidate for candidate in candidates},
        measures={c.name: m for c, m in zip(candidates, measures, strict=True)},
    )
    return Reproduction(design, evidence, check_claims(evidence))


def _candidates(problem: Problem, optimum: Synthesis, best_pi: Synthesis) -> tuple[Candidate, ...]:
    """Return the printed controllers, the optima, and the tuning rules."""
    pid = STRUCTURES["pid"]
    cycle = _ultimate_cycle(problem.plant)
    zn, tlc = baselines.ziegler_nichols(cycle), baselines.tyreus_luyben(cycle)
    tuned = (
        f"Ku {cycle.gain:.4g}, Pu {cycle.period_s:.4g} s of the loop sampled at {printed.PERIOD_S} s, N = 10"
    )
    hls = one_degree_of_freedom(printed.HLS.num[None, :], printed.HLS.den[None, :])
    return (
        structured_candidate("PPID (20)", "eq. (20), as printed", pid, printed.PPID, problem),
        polynomial_candidate("HLS (18)", "eq. (18), as printed", hls, problem),
        structured_candidate(
            "PID optimum",
            "the paper's search range, differential evolution",
            pid,
            optimum.values,
            problem,
        ),
        structured_candidate("PI", "PI of largest ε", STRUCTURES["pi"], best_pi.values, problem),
        structured_candidate("ZN", f"Ziegler-Nichols: {tuned}", pid, zn.values, problem),
        structured_candidate("TLC", f"Tyreus-Luyben: {tuned}", pid, tlc.values, problem),
    )


def _ultimate_cycle(plant: Plant) -> baselines.UltimateCycle:
    """Return the ultimate cycle of the loop sampled without delay, which fits the printed overshoots best."""
    without_delay = Sampling(printed.PERIOD_S, delay_samples=0)
    return baselines.ultimate_cycle(plant.transfer_function(without_delay), without_delay)


def _printed_weight(problem: Problem, design_file: DesignFile, run: WeightSelection) -> WeightSelection:
    """Return the weight of eq. (16) with the search of another selection."""
    G, W1 = problem.loop_plant, printed.W1
    selecting = ClosedLoops(G, baselines.loop_shaping_controller(G, W1), W=W1, desired=shaped(G, W1))
    return replace(
        run,
        parameters={"kw": float(W1.num[0]), "a": float(W1.num[1] / W1.num[0])},
        weight=W1,
        eps_opt=problem.eps_opt,
        readings=readings(design_file.specifications.requested(), selecting),
        at_bounds=(),
    )
