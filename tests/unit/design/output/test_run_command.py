"""The command that runs a designed controller on the plant that it was designed for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from support.designs import plain_design

from design.inputs import load_plant
from design.models.plant import Plant
from design.models.sampling import Sampling
from design.output.run_command import run_command, run_notes
from design.synthesis.procedure import Design

CONTROLLER = Path("out/controller.json")


def design_for(plant: Plant) -> Design:
    return replace(plain_design(), plant=plant)


def renamed(plant: Plant, name: str) -> Plant:
    return msgspec.structs.replace(plant, name=name)


def test_the_papers_plant_is_run_as_a_linear_plant() -> None:
    command = run_command(plain_design(), CONTROLLER, None)
    assert command == "hil run --linear --controller vertical=out/controller.json"
    (note,) = run_notes(plain_design(), None)
    assert "`hil design vertical` designs for it" in note


@pytest.mark.parametrize(
    ("plant", "axis"),
    [
        ("vertical", "vertical"),
        ("horizontal", "horizontal"),
        ("rotation", "rotation"),
        ("rotation-loaded", "rotation"),
    ],
)
def test_a_shipped_model_of_the_arm_is_run_on_the_simulated_arm(plant: str, axis: str) -> None:
    design = design_for(load_plant(plant))
    assert run_command(design, CONTROLLER, None) == f"hil run --controller {axis}=out/controller.json"
    assert run_notes(design, None) == []


def test_a_users_own_plant_is_run_on_its_own_model() -> None:
    """Even if it has the coefficients of the paper's plant, or the name of a shipped one."""
    for name, axis in (("mine", "vertical"), ("horizontal", "horizontal"), ("rotation", "vertical")):
        design = design_for(renamed(plain_design().plant, name))
        command = run_command(design, CONTROLLER, Path("plants/mine.json"))
        assert command == (f"hil run --plant {axis}=plants/mine.json --controller {axis}=out/controller.json")
        assert run_notes(design, Path("plants/mine.json")) == []


def test_file_names_with_blanks_are_quoted() -> None:
    command = run_command(plain_design(), Path("my out/controller.json"), Path("my plant.json"))
    assert "--plant 'vertical=my plant.json' --controller 'vertical=my out/controller.json'" in command


def test_a_loop_other_than_the_shipped_rigs_needs_a_rig_file() -> None:
    design = plain_design()
    problem = replace(design.problem, rig_sampling=Sampling(0.005, 2))
    other = replace(design, problem=problem)
    assert run_command(other, CONTROLLER, None).startswith("hil run --rig RIG.toml --linear ")
    assert run_notes(other, None)[0] == (
        "RIG.toml stands for your rig file, with a period of 0.005 s and 2 samples of delay."
    )
