"""Finished designs that several tests look at. Each is made once in a test run."""

from __future__ import annotations

from functools import cache

from design.models.plant import Plant, paper_plant
from design.paper.reproduction import Reproduction, reproduce
from design.synthesis.design_file import DesignFile, read_design
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
"""Plant that the controller for the paper's plant stabilises, for certain by the ν-gap."""
REVERSED = Plant(
    format="hil-plant",
    version=1,
    name="reversed",
    input_unit="V",
    output_unit="m",
    num=[-40.0],
    den=[1.0, 14.0, 100.0],
)
"""Plant of negative gain, which the controller for the paper's plant does not stabilise."""


@cache
def plain_design() -> Design:
    """The default design: the paper's plant in the loop of the rig."""
    return design_controller(DesignFile(), paper_plant())


@cache
def sampled_design() -> Design:
    """The default design with two further plants."""
    return design_controller(DesignFile(), paper_plant(), [HEAVIER, REVERSED])


@cache
def continuous_design() -> Design:
    """The default design in the continuous loop."""
    return design_controller(read_design('[loop]\ndesign = "continuous"\n', "design.toml"), paper_plant())


@cache
def reproduction() -> Reproduction:
    """The paper's own design."""
    return reproduce()
