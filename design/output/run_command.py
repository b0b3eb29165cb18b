"""Say how to run a designed controller on the plant that it was designed for."""

from __future__ import annotations

import shlex
from pathlib import Path

from design.closed_loop.comparison import delay_text
from design.paper.printed import is_paper_plant
from design.synthesis.design_file import DesignFile
from design.synthesis.procedure import Design

AXES_BY_UNIT = {"m": ("vertical", "horizontal"), "rad": ("rotation",)}
"""Axes of the shipped rig by unit; the first is used for a plant that does not bear the name of an axis."""


def run_command(design: Design, controller: Path, plant_file: Path | None) -> str:
    """Return the ``hil run`` command that runs a controller file on the plant that was designed for.

    ``plant_file`` is the file of a user's own plant; None means a shipped plant: the paper's, which
    ``--linear`` simulates, or a model of the simulated arm, which is what ``hil run`` simulates by default.
    """
    axis = _axis(design)
    words = ["hil", "run"]
    if _needs_rig_file(design):
        words += ["--rig", "RIG.toml"]
    if plant_file is not None:
        words += ["--plant", f"{axis}={plant_file}"]
    elif is_paper_plant(design.plant):
        words.append("--linear")
    words += ["--controller", f"{axis}={controller}"]
    return shlex.join(words)


def run_notes(design: Design, plant_file: Path | None) -> list[str]:
    """Return what a reader of the command must know besides."""
    notes = []
    if _needs_rig_file(design):
        rig = design.problem.rig_sampling
        notes.append(
            f"RIG.toml stands for your rig file, with a period of {rig.period_s:g} s and {delay_text(rig)}."
        )
    if plant_file is None and is_paper_plant(design.plant):
        notes.append(
            "--linear simulates eq. (15) itself. The vertical axis of the simulated arm is a different "
            "plant; `hil design vertical` designs for it."
        )
    return notes


def _needs_rig_file(design: Design) -> bool:
    """Return whether the loop that was designed for is another than that of the shipped rig file."""
    return design.problem.rig_sampling != DesignFile().rig_sampling


def _axis(design: Design) -> str:
    axes = AXES_BY_UNIT[design.plant.output_unit]
    return design.plant.name if design.plant.name in axes else axes[0]
