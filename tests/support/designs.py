"""Finished designs that several tests look at; each is carried out once."""

from __future__ import annotations

from functools import cache

from design.models.plant import Plant, paper_plant
from design.paper.reproduction import Reproduction, reproduce
from design.synthesis.design_file import read_design
from design.synthesis.procedure import Design, design_controller
from support.constants import PERIOD_S as PERIOD_S

HEAVIER = Plant(
    format="hil-plant",
    version=1,
    name="heavier",
    input_unit="V",
    output_unit="m",
    num=[0.40, 36.0],
    den=[1.0, 14.0, 130.0, 50.0],
)
REVERSED = Plant(
    format="hil-plant",
    version=1,
    name="reversed",
    input_unit="V",
    output_unit="m",
    num=[-40.0],
    den=[1.0, 14.0, 100.0],
)


@cache
def sampled_design() -> Design:
    """The default: the paper's plant in the rig's loop, and two further plants."""
    return design_controller(read_design("", "design.toml"), paper_plant(), [HEAVIER, REVERSED])


@cache
def continuous_design() -> Design:
    """The same for the continuous loop."""
    return design_controller(read_design('[loop]\ndesign = "continuous"\n', "design.toml"), paper_plant())


@cache
def reproduction() -> Reproduction:
    """The paper's design."""
    return reproduce()
