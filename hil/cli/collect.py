"""``hil collect``: excite one axis and record it, as data for ``hil identify``.

The experiment goes through the same core as every run: guards, limits, life cycle, recorder. Before anything
moves, the spectrum of the excitation is shown, and a lockstep run on the simulated arm predicts the travel.
"""

from __future__ import annotations

import argparse
import shlex
from typing import TYPE_CHECKING

from firmware_sim.plant_options import check_plant_options
from hil.cli.axis_values import by_axis
from hil.cli.collect_options import experiment_of, parser
from hil.cli.collect_plan import confirm_experiment, print_excitation, print_prediction
from hil.cli.collect_run import (
    Collected,
    read_collected,
    reason_of_end,
    record_experiment,
    samples_text,
    travel_text,
)
from hil.cli.record_path import recording_path
from hil.cli.run import chosen_bus
from hil.cli.run_parts import SIMULATED
from hil.core.check_names import check_overrides
from hil.core.documents import to_json
from hil.core.errors import HilError
from hil.core.experiment import NAME as EXPERIMENT_NAME
from hil.core.experiment import Experiment
from hil.core.rig import Rig
from hil.core.setpoints import HOLD
from hil.live.address import check_page_options
from hil.shells.run_plan import Ending
from hil.shells.run_setup import RunSetup, load_rig, load_setup

if TYPE_CHECKING:
    from rich.console import Console

SECOND_RECORD = "SECOND.mcap"
SECOND_RECORD_NOTE = (
    "a second recording of hil collect, such as with another --seed; without --validate, the last third of "
    "this one is kept from the fit"
)


def main(argv: list[str]) -> int:
    """Run ``hil collect`` with ``argv``; return its exit status. Raises HilError for wrong input."""
    from rich.console import Console

    options = parser().parse_args(argv)
    check_plant_options(options)
    check_page_options(options)
    console = Console(highlight=False, soft_wrap=True, markup=False)
    rig = load_rig(options.rig)
    check_overrides(options.override, rig)
    experiment = experiment_of(options, rig)
    setup = _setup(options, rig, experiment)
    bus = chosen_bus(options, setup)
    if not options.dry_run:
        recording_path(options.output, experiment.duration_s(rig.loop.period_s), has_figure=False)
    print_excitation(console, setup, experiment)
    if not options.lockstep or options.dry_run:
        is_predicted = print_prediction(console, setup, experiment, options)
        if not is_predicted and bus != SIMULATED:
            raise HilError("without a prediction no real axis is moved; see hil run --help")
    if options.dry_run:
        return 0
    if bus != SIMULATED and not options.yes:
        confirm_experiment(experiment, bus)
    report, plan = record_experiment(setup, experiment, bus, options)
    collected = read_collected(report.path, experiment)
    _print_collected(console, collected, experiment, rig)
    console.print(f"recording   {report.path}")
    if report.failure:
        console.print(f"The recording is incomplete: {report.failure}", style="red")
    if plan.ending is Ending.INTERRUPTED:
        console.print("Interrupted: the excitation was not given completely.", style="red")
        return 130
    if plan.ending is not Ending.COMPLETED or not collected.is_complete:
        console.print(
            f"The excitation was not given completely: {reason_of_end(plan, collected)}.", style="red"
        )
        return 1
    console.print(
        f"next        hil identify {shlex.quote(str(report.path))} --axis {experiment.axis} "
        f"--validate {SECOND_RECORD}"
    )
    console.print(f"            {SECOND_RECORD}: {SECOND_RECORD_NOTE}")
    return 1 if report.failure else 0


def _setup(options: argparse.Namespace, rig: Rig, experiment: Experiment) -> RunSetup:
    """Read the setup of the run: the axes that are not excited keep their positions."""
    controllers = by_axis("--controller", options.controller, "vertical=ppid")
    texts = {EXPERIMENT_NAME: to_json(experiment)}
    return load_setup(options.rig, controllers, dict.fromkeys(rig.axes, HOLD), texts)


def _print_collected(console: Console, collected: Collected, experiment: Experiment, rig: Rig) -> None:
    text, stays = travel_text(collected, experiment, rig)
    console.print(f"travel      {text}", style=None if stays else "yellow")
    if experiment.mode == "open loop":
        centre_v = rig.axes[experiment.axis].valve.centre_v
        console.print(
            f"offset      {collected.offset_v:+.3f} V about {centre_v:g} V: with it the axis stands still"
        )
    console.print(samples_text(collected))
