"""The recommendation on a finished design: the action, its reasons, and hints for another search."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from support.designs import continuous_design, plain_design, sampled_design

from design.models.measured_record import ModelFit
from design.models.plant import paper_plant
from design.synthesis.design_file import read_design
from design.synthesis.procedure import Design, design_controller
from design.synthesis.recommendation import Action, recommend

SHORT = "[search]\nweight_evaluations = 300\ncontroller_evaluations = 300\n"


def design_of(text: str) -> Design:
    return design_controller(read_design(text, "d.toml"), paper_plant())


def with_eps(design: Design, eps: float) -> Design:
    """The design with another margin of its controller in the sampled loop."""
    return replace(design, measures=(replace(design.measures[0], eps_sampled=eps), *design.measures[1:]))


def test_a_good_design_is_to_be_run() -> None:
    recommendation = recommend(plain_design())
    assert recommendation.action is Action.RUN
    assert recommendation.objections == recommendation.hints == recommendation.warnings == ()
    assert recommendation.unstable == ()


def test_an_objection_advises_against_running() -> None:
    recommendation = recommend(sampled_design())
    assert recommendation.action is Action.DO_NOT_RUN
    (objection,) = recommendation.objections
    assert objection.startswith("plant reversed is unstable with this controller: set further_plants.worst")


def test_a_loop_that_is_unstable_on_the_rig_is_named() -> None:
    recommendation = recommend(with_eps(plain_design(), 0.0))
    assert recommendation.action is Action.UNSTABLE
    assert recommendation.unstable == ("PID (designed)",)


def test_an_unstable_comparison_does_not_advise_against_the_designed_controller() -> None:
    design = plain_design()
    measures = (*design.measures[:-1], replace(design.measures[-1], eps_sampled=0.0))
    recommendation = recommend(replace(design, measures=measures))
    assert recommendation.action is Action.RUN
    assert recommendation.unstable == ("TLC",)


def test_a_small_margin_is_an_objection() -> None:
    (objection,) = recommend(with_eps(plain_design(), 0.2)).objections
    assert "ε 0.200 is below 0.25: the controller structure does not suit the plant" in objection
    weak = replace(plain_design(), weight=replace(plain_design().weight, eps_opt=0.2))
    (objection,) = recommend(weak).objections
    assert "ε_opt 0.200 is below 0.25" in objection
    assert "relax them, or change weight.structure" in objection


def test_missed_specifications_are_listed_with_a_remedy() -> None:
    design = plain_design()
    missed = tuple(replace(reading, met=False) for reading in design.designed_readings)
    (objection,) = recommend(replace(design, designed_readings=missed)).objections
    assert objection.count("NOT met") == 3, "gain and crossover are specified for Gs, not for GK"
    assert "must_meet_specifications = true" in objection


def test_a_poor_fit_to_the_measured_record_is_an_objection() -> None:
    t = np.arange(50) * 0.1
    measured = ModelFit("r.csv", t, t, np.cos(t), np.sin(t), doubt="r.csv: the model does not follow it")
    recommendation = recommend(plain_design(), measured)
    assert recommendation.objections == ("r.csv: the model does not follow it",)
    assert recommendation.action is Action.DO_NOT_RUN


def test_warnings_of_all_plant_files_are_repeated_and_do_not_change_the_action() -> None:
    design = plain_design()
    plant = msgspec.structs.replace(design.plant, warnings=["input is not exciting", "drift"])
    recommendation = recommend(replace(design, plant=plant))
    assert recommendation.warnings == ("plant paper: input is not exciting", "plant paper: drift")
    assert recommendation.action is Action.RUN
    design = sampled_design()
    heavier = replace(
        design.guarantees[0], plant=msgspec.structs.replace(design.guarantees[0].plant, warnings=["short"])
    )
    assert recommend(replace(design, guarantees=(heavier,))).warnings == ("plant heavier: short",)


@pytest.mark.parametrize(
    ("loop", "text"),
    [
        ("delay_samples = 1", ""),
        ("delay_samples = 20", "ε is 0.2"),
        ("delay_samples = 20\nperiod_s = 0.0336", "ε is unstable"),
    ],
)
def test_a_continuous_design_that_the_rig_cannot_run_is_an_objection(loop: str, text: str) -> None:
    recommendation = recommend(design_of(f'[loop]\ndesign = "continuous"\n{loop}\n'))
    found = [objection for objection in recommendation.objections if "in the rig's loop" in objection]
    assert len(found) == (1 if text else 0)
    assert text in "".join(found)


@pytest.mark.parametrize(("structure", "is_named"), [("p", True), ("pi", False)])
def test_a_missing_integrator_is_named_if_the_weight_has_one(structure: str, is_named: bool) -> None:
    recommendation = recommend(design_of(f'[controller]\nstructure = "{structure}"\n' + SHORT))
    assert any("a structure with an integrator" in text for text in recommendation.objections) == is_named


def test_a_search_that_stops_too_early_gives_a_hint() -> None:
    (hint,) = recommend(design_of("[search]\ncontroller_evaluations = 2500\n")).hints
    assert hint.startswith("the search for the controller was still improving when it had used its 2500")
    assert "raise search.controller_evaluations" in hint
    assert recommend(continuous_design()).hints == ()


def test_a_parameter_at_a_search_bound_gives_a_hint() -> None:
    narrow = "[search]\nweight_evaluations = 300\n"
    narrow += "[controller.search_ranges]\nkp = { low = 1.0, high = 2.0 }\n"
    hint = recommend(design_of(narrow)).hints[0]
    assert hint.startswith("kp")
    assert "of the controller: at a search bound; widen controller.search_ranges" in hint
