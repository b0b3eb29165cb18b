"""The whole procedure: what is compared, with which plants, and the errors of a design that fails."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.designs import HEAVIER, REVERSED, continuous_design, sampled_design

from design.errors import DesignError, InfeasibleError
from design.models.plant import Plant, paper_plant
from design.models.sampling import Sampling, zero_order_hold
from design.robustness import margins
from design.search.searcher import Progress
from design.synthesis.design_file import read_design
from design.synthesis.procedure import CONTROLLER_STAGE, WEIGHT_STAGE, design_controller

SHORT = "[search]\nweight_evaluations = 300\ncontroller_evaluations = 300\n"


def test_a_design_in_the_sampled_loop_has_the_margin_of_the_sampled_loop() -> None:
    design = sampled_design()
    G = paper_plant().transfer_function(Sampling(0.0112, 1))
    margin = margins.stability_margin(G, design.designed.controller.feedback, design.weight.weight)[0]
    assert design.eps == pytest.approx(margin, abs=1e-12)
    assert design.eps == pytest.approx(design.synthesis.eps, abs=1e-9)
    assert design.eps < design.problem.eps_opt == pytest.approx(design.weight.eps_opt, abs=1e-9)


def test_a_design_in_the_continuous_loop_has_both_margins() -> None:
    design = continuous_design()
    measures = design.measures[0]
    assert design.eps == measures.eps_continuous == pytest.approx(design.synthesis.eps, abs=1e-9)
    assert measures.eps_sampled < measures.eps_continuous - 0.02, "hold and delay cost margin"


def test_no_structure_exceeds_eps_opt_and_pid_exceeds_pi() -> None:
    for design in (sampled_design(), continuous_design()):
        eps = {c.name: design.problem.eps(m) for c, m in zip(design.candidates, design.measures, strict=True)}
        assert max(eps.values()) <= design.problem.eps_opt
        assert eps["PID (designed)"] > eps["PI"]
        assert eps["HLS"] >= design.problem.eps_opt / 1.1 - 1e-9
        assert eps["ZN"] < eps["TLC"] < 0.1


def test_a_worst_case_design_raises_the_smallest_margin() -> None:
    text = (
        "[further_plants]\nworst_case = {}\n"
        "[specifications]\nbandwidth_rad_s = 4.0\ngain_db = {{ limit = 20.0, up_to_rad_s = 0.4 }}\n"
    )
    smallest = {}
    for worst_case in ("false", "true"):
        design = design_controller(read_design(text.format(worst_case), "d.toml"), paper_plant(), [HEAVIER])
        (guarantee,) = design.guarantees
        smallest[worst_case] = min(guarantee.eps, guarantee.eps_there)
        if worst_case == "true":
            assert design.synthesis.eps == pytest.approx(smallest["true"], abs=1e-9)
    assert smallest["true"] > smallest["false"]


def test_the_guarantee_follows_from_the_gap() -> None:
    """Vinnicombe: arcsin of the margin falls at most by arcsin of the gap."""
    heavier, reversed_plant = sampled_design().guarantees
    assert np.arcsin(heavier.eps_there) >= np.arcsin(heavier.eps) - np.arcsin(heavier.gap) - 1e-9
    assert heavier.guaranteed
    assert not reversed_plant.guaranteed


def test_must_meet_specifications_applies_to_the_designed_loop() -> None:
    """A crossover of GK of 3.5 rad/s is more than the largest margin has."""
    text = (
        "[specifications]\nbandwidth_rad_s = 3.5\novershoot = 0.2\n"
        "[controller]\nmust_meet_specifications = {}\n"
    )
    free, bound = (
        design_controller(read_design(text.format(value), "d.toml"), paper_plant())
        for value in ("false", "true")
    )
    assert not all(r.met for r in free.designed_readings)
    assert all(r.met for r in bound.designed_readings)
    assert bound.eps < free.eps


def test_specifications_that_the_structure_cannot_meet_are_infeasible() -> None:
    text = SHORT + '[controller]\nstructure = "p"\nmust_meet_specifications = true\n'
    with pytest.raises(InfeasibleError, match=r"(?s)no controller within the .* error .* NOT met"):
        design_controller(read_design(text, "d.toml"), paper_plant())


def test_a_tuning_rule_that_does_not_exist_for_a_plant_is_noted() -> None:
    """A first-order plant in a continuous loop does not oscillate at any gain."""
    plant = Plant(
        format="hil-plant", version=1, name="p", input_unit="V", output_unit="m", num=[1.0], den=[1.0, 1.0]
    )
    design = design_controller(read_design('[loop]\ndesign = "continuous"\n' + SHORT, "d.toml"), plant)
    assert [c.name for c in design.candidates] == ["PID (designed)", "HLS", "PI"]
    (note,) = design.notes
    assert note.startswith("ZN, TLC: the loop has no ultimate cycle")


def test_the_best_pi_is_not_added_to_a_designed_pi() -> None:
    design = design_controller(
        read_design(SHORT + '[controller]\nstructure = "pi"\n', "d.toml"), paper_plant()
    )
    assert [c.name for c in design.candidates] == ["PI (designed)", "HLS", "ZN", "TLC"]


def test_a_dead_time_costs_margin_in_the_sampled_loop() -> None:
    late = msgspec.structs.replace(paper_plant(), name="late", dead_time_s=0.0168)
    design = design_controller(read_design(SHORT, "d.toml"), late)
    assert 0.3 < design.problem.eps_opt < sampled_design().problem.eps_opt - 0.01
    G = zero_order_hold(late.rational_part, 0.0112, 2.5 * 0.0112)
    margin = margins.stability_margin(G, design.designed.controller.feedback, design.weight.weight)[0]
    assert design.eps == pytest.approx(margin, abs=1e-12)
    assert np.isnan(design.measures[0].eps_continuous)
    assert "1 sample of delay, 0.0168 s of dead time" in design.loop_description


def test_a_dead_time_is_refused_in_the_continuous_loop() -> None:
    late = msgspec.structs.replace(paper_plant(), dead_time_s=0.0168)
    with pytest.raises(DesignError, match=r"dead time of 0\.0168 s, which a continuous loop cannot"):
        design_controller(read_design('[loop]\ndesign = "continuous"\n' + SHORT, "d.toml"), late)


def test_the_rigs_delay_in_a_model_is_not_counted_twice() -> None:
    through_the_rig = msgspec.structs.replace(paper_plant(), dead_time_s=0.0112, contains_delay_samples=1)
    one, other = (
        design_controller(read_design(SHORT, "d.toml"), plant) for plant in (paper_plant(), through_the_rig)
    )
    assert one.synthesis.parameters == other.synthesis.parameters
    assert one.measures == other.measures


def test_plants_with_gains_of_opposite_sign_are_named() -> None:
    text = SHORT + "[specifications]\novershoot = 0.5\n[further_plants]\nworst_case = true\n"
    with pytest.raises(DesignError, match="of these plants reversed moves against its input"):
        design_controller(read_design(text, "d.toml"), paper_plant(), [REVERSED])


def test_progress_is_reported_for_both_stages() -> None:
    seen: dict[str, list[tuple[Progress, int]]] = {}
    design_controller(
        read_design(SHORT, "d.toml"),
        paper_plant(),
        on_progress=lambda stage, progress, total: seen.setdefault(stage, []).append((progress, total)),
    )
    assert list(seen) == [WEIGHT_STAGE, CONTROLLER_STAGE]
    for steps in seen.values():
        assert [progress.generation for progress, _ in steps] == list(range(1, len(steps) + 1))
        best = [progress.best_fitness for progress, _ in steps]
        assert best == sorted(best)
        assert all(progress.evaluations <= total == 300 for progress, total in steps)
