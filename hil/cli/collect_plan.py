"""What ``hil collect`` shows before an axis moves: the spectrum, the predicted travel, and a question."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from hil.cli.collect_run import read_collected, reason_of_end, record_experiment, travel_text
from hil.cli.run_parts import SIMULATED
from hil.core.errors import HilError
from hil.core.excitation import samples
from hil.core.experiment import Experiment
from hil.shells.real_bus import check_interface
from hil.shells.run_plan import Ending
from hil.shells.run_setup import RunSetup

if TYPE_CHECKING:
    from rich.console import Console


def print_excitation(console: Console, setup: RunSetup, experiment: Experiment) -> None:
    """Print the spectrum of the excitation beside the bandwidth of the axis' controller."""
    from hil.views.excitation_summary import excitation_summary, loop_crossover

    period_s = setup.rig.loop.period_s
    unit = setup.rig.axes[experiment.axis].unit if experiment.mode == "setpoint" else "V"
    crossover = loop_crossover(setup.controllers[experiment.axis])
    values = samples(experiment.signal, period_s)
    console.print(excitation_summary(experiment.signal, values, period_s, unit, crossover))


def print_prediction(
    console: Console, setup: RunSetup, experiment: Experiment, options: argparse.Namespace
) -> bool:
    """Run the experiment in lockstep on the simulated arm, and print the travel. Return whether it is known.

    Raises KeyboardInterrupt if the user interrupted it.
    """
    with tempfile.TemporaryDirectory() as folder:
        dry = argparse.Namespace(
            **{**vars(options), "lockstep": True, "output": Path(folder) / "dry-run.mcap"}
        )
        try:
            report, plan = record_experiment(setup, experiment, SIMULATED, dry)
            if plan.ending is Ending.INTERRUPTED:
                raise KeyboardInterrupt
            predicted = read_collected(report.path, experiment)
        except HilError as error:
            console.print(f"prediction  not possible: {error}", style="yellow")
            return False
    text, stays = travel_text(predicted, experiment, setup.rig)
    console.print(f"prediction  simulated arm: {text}", style=None if stays else "yellow")
    if not predicted.is_complete:
        reason = reason_of_end(plan, predicted)
        console.print(f"prediction  the excitation would not be given completely: {reason}", style="yellow")
    return True


def confirm_experiment(experiment: Experiment, bus: str) -> None:
    """Ask before a real axis moves. Raises HilError without a yes."""
    check_interface(bus)
    if not sys.stdin.isatty():
        raise HilError(
            f"{bus} is a real bus and there is no terminal to ask on; give --yes to move {experiment.axis}"
        )
    sys.stdout.write(
        f"{experiment.axis} on {bus} will move as predicted. Is its range free of people? Type yes: "
    )
    sys.stdout.flush()
    if sys.stdin.readline().strip().lower() != "yes":
        raise HilError("not confirmed; nothing was moved")
