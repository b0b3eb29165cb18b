"""The paper's own design, carried out again: its weight and controllers, its search, and the true optima.

What it prints is judged in ``paper_claims``. How the weight's specifications (9) are read: gain and crossover
are those of the shaped plant, times those of the closed loop with K = W1 K∞ (the paper does not say).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import resources

from design.closed_loop.comparison import Problem
from design.closed_loop.loops import ClosedLoops
from design.closed_loop.specifications import readings
from design.models.controller import one_degree_of_freedom
from design.models.plant import paper_plant
from design.models.sampling import Sampling
from design.paper.claims import HLS, PERIOD_S, PPID, W1, Evidence, judge
from design.paper.searches import run_searches
from design.paper.verdicts import Verdict
from design.robustness.loop_shaping import shaped
from design.search.searcher import Progress
from design.synthesis import baselines
from design.synthesis.design_file import DesignFile, read_design
from design.synthesis.fixed_structure import synthesise
from design.synthesis.procedure import (
    PI_EVALUATIONS,
    Design,
    OnProgress,
    of_polynomials,
    of_structure,
    stage_progress,
)
from design.synthesis.structures import STRUCTURES
from design.synthesis.weight_selection import select_weight

PAPER_DESIGN = "paper.toml"


@dataclass(frozen=True)
class Reproduction:
    """The paper's design as a report shows it, what the verdicts rest on, and the verdicts."""

    design: Design
    evidence: Evidence
    verdicts: tuple[Verdict, ...]


def paper_design_file() -> DesignFile:
    """Sec. IV as a design file: continuous loop, boxes coded linearly, the genetic algorithm."""
    return read_design(
        resources.files("design.paper").joinpath(PAPER_DESIGN).read_text("utf-8"), PAPER_DESIGN
    )


def reproduce(on_progress: OnProgress | None = None) -> Reproduction:
    """Carry the paper's design out, and judge every figure that it prints."""

    def stage(name: str, evaluations: int, done: int = 0) -> Callable[[Progress], None] | None:
        return stage_progress(on_progress, name, evaluations, done)

    plant, asked = paper_plant(), paper_design_file()
    specifications, pid = asked.specifications.asked_for(), STRUCTURES["pid"]
    searches = run_searches(asked, plant, W1, on_progress)
    best_weight = select_weight(plant, on_progress=stage("optimum, W1", 2000))
    optimum = synthesise(plant, W1, pid, on_progress=stage("optimum, PID", 6000))
    best_pi = synthesise(plant, W1, STRUCTURES["pi"], evaluations=PI_EVALUATIONS)

    problem = Problem(plant, W1, None, asked.rig_sampling)
    without_delay = Sampling(PERIOD_S, delay_samples=0)
    cycle = baselines.ultimate_cycle(plant.transfer_function(without_delay), without_delay)
    zn, tlc = baselines.ziegler_nichols(cycle), baselines.tyreus_luyben(cycle)
    tuned = f"Ku {cycle.gain:.4g}, Pu {cycle.period_s:.4g} s of the loop sampled at {PERIOD_S} s, N = 10"
    hls = one_degree_of_freedom(HLS.num[None, :], HLS.den[None, :])
    candidates = (
        of_structure("PPID (20)", "eq. (20), as printed", pid, PPID, problem),
        of_polynomials("HLS (18)", "eq. (18), as printed", hls, problem),
        of_structure("PID optimum", "the paper's box, differential evolution", pid, optimum.values, problem),
        of_structure("PI", "PI of largest ε", STRUCTURES["pi"], best_pi.values, problem),
        of_structure("ZN", f"Ziegler-Nichols: {tuned}", pid, zn.values, problem),
        of_structure("TLC", f"Tyreus-Luyben: {tuned}", pid, tlc.values, problem),
    )
    measures = tuple(problem.measure(candidate) for candidate in candidates)
    G, Gs = problem.loop_plant, shaped(problem.loop_plant, W1)
    selecting = ClosedLoops(G, baselines.loop_shaping_controller(G, W1), W=W1, desired=Gs)
    # The report shows the weight (16) and the printed controllers, and of the searches the median runs.
    weight = replace(
        searches.typical_weight or best_weight,
        parameters={"kw": float(W1.num[0]), "a": float(W1.num[1] / W1.num[0])},
        weight=W1,
        eps_opt=problem.eps_opt,
        readings=readings(specifications, selecting),
        at_bounds=(),
    )
    design = Design(
        design_file=asked,
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
        selecting=weight.readings,
        searches=searches,
        best_weight=best_weight,
        optimum=optimum,
        candidates={candidate.name: candidate for candidate in candidates},
        measures={c.name: m for c, m in zip(candidates, measures, strict=True)},
    )
    return Reproduction(design, evidence, judge(evidence))
