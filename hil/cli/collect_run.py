"""Runs the experiment of ``hil collect``, reads what it gave, and says it in words."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from firmware_sim.simulated_plant import plant_texts
from hil.cli.launch import run_lockstep, run_realtime
from hil.cli.record_path import create_folder_of, recording_path
from hil.cli.run_parts import SIMULATED
from hil.core.experiment import Experiment
from hil.core.phase import Phase
from hil.core.rig import Rig
from hil.shells.run_plan import Ending, RunPlan
from hil.shells.run_setup import RunSetup

if TYPE_CHECKING:
    from hil.recording.recorder import RecorderReport
    from hil.recording.tables import BoolArray, IntArray

MAX_PAUSE_FACTOR = 5.0
"""The fence may lengthen an experiment to this many times its duration before the run is ended."""


@dataclass(frozen=True)
class Collected:
    """What a run of an experiment gave."""

    excited: int
    """Samples under excitation."""
    gaps: int
    """Periods under excitation without a good sample: none came, or the sample guard rejected it."""
    rejected: int
    """Frames that the gateway rejected in the whole run, as sample or otherwise."""
    lowest: float
    """Lowest position of the whole experiment in the axis' unit, with the paths to and from the centre."""
    highest: float
    fence_crossings: int
    offset_v: float
    is_complete: bool
    """True if all of the excitation was given."""


def record_experiment(
    setup: RunSetup, experiment: Experiment, bus: str, options: argparse.Namespace
) -> tuple[RecorderReport, RunPlan]:
    """Run an experiment and record it. Raises HilError."""
    if bus == SIMULATED:
        setup = replace(setup, texts={**setup.texts, **plant_texts(setup.rig, options)})
    nominal_s = experiment.duration_s(setup.rig.loop.period_s)
    limit_s = MAX_PAUSE_FACTOR * nominal_s
    plan = RunPlan(limit_s, setup.rig.loop.period_s, overrides=options.override)
    path = recording_path(options.output, nominal_s, has_figure=False)
    create_folder_of(path)
    if options.lockstep:
        return run_lockstep(setup, plan, path, nominal_s, options), plan
    return run_realtime(setup, plan, path, bus, options), plan


def read_collected(path: Path, experiment: Experiment) -> Collected:
    """Read what an experiment gave from its recording. Raises RecordingError."""
    from hil.recording.reader import Recording

    recording = Recording(path)
    axis = recording.axis(experiment.axis)
    excited = axis["phase"] == Phase.EXCITED
    moved = axis["phase"] != Phase.NONE
    position = axis["position"][moved & axis["fresh"]]
    ending = recording.metadata.get("ending", {})
    return Collected(
        excited=int((excited & axis["fresh"]).sum()),
        gaps=_gaps(recording.timing().number, excited, axis["fresh"]),
        rejected=int(ending.get("rejected frames", "0")),
        lowest=float(position.min()) if len(position) else float("nan"),
        highest=float(position.max()) if len(position) else float("nan"),
        fence_crossings=int(ending.get("fence crossings", "0")),
        offset_v=float(ending.get("valve offset, V", "0")),
        is_complete=ending.get("experiment", "") == "complete",
    )


def _gaps(number: IntArray, excited: BoolArray, fresh: BoolArray) -> int:
    """Count periods under excitation without a good sample, with those that the gateway missed altogether."""
    missed = (np.diff(number) - 1)[excited[:-1] & excited[1:]]
    return int(np.count_nonzero(excited & ~fresh) + missed.sum())


def reason_of_end(plan: RunPlan, collected: Collected) -> str:
    """Return why an experiment ended early."""
    if plan.ending is not Ending.COMPLETED:
        return f"the run ended: {plan.ending}"
    if collected.fence_crossings:
        return f"the fence acted {collected.fence_crossings} times; reduce --amplitude, or widen the fence"
    return "the axis did not come to rest near its centre; check its controller"


def samples_text(collected: Collected) -> str:
    """Return how many samples were excited, and what was lost of them."""
    text = f"samples     {collected.excited} excited, {collected.gaps} periods without a good sample"
    if not collected.rejected:
        return text
    return f"{text}; {collected.rejected} frames rejected in the whole run (see the log in the recording)"


def travel_text(collected: Collected, experiment: Experiment, rig: Rig) -> tuple[str, bool]:
    """Return the travel in words, and whether the axis stayed within its fence."""
    axis = rig.axes[experiment.axis]
    low, high = axis.fence_limits
    scale, unit = (1000.0, "mm") if axis.unit == "m" else (1.0, axis.unit)
    moved = f"{scale * collected.lowest:.3g} to {scale * collected.highest:.3g} {unit}"
    fence = f"the fence at {scale * low:.3g} and {scale * high:.3g} {unit}"
    if collected.excited == 0:
        return f"no sample of {experiment.axis} was excited", False
    if collected.fence_crossings == 0:
        return f"{experiment.axis} moves from {moved}, inside {fence}", True
    return f"{experiment.axis} moves from {moved}; {fence} acts {collected.fence_crossings} times", False
