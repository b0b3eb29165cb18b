"""``hil run``: one run of the controllers against the rig, recorded, summed up and plotted.

Imports nothing slow before the loop: what only the summary needs is imported after it.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_sim.plant_options import add_plant_options, check_plant_options, given_plant_options
from firmware_sim.simulated_plant import plant_texts
from hil.cli.launch import SIMULATED, run_lockstep, run_realtime
from hil.cli.record_path import figure_of, picture_of, recording_path
from hil.core.errors import DocumentError, HilError, LinkError, RecordingExistsError
from hil.core.setpoints import FORMS
from hil.host.text_file import read_text
from hil.recording.recorder import RecorderReport
from hil.shells.run_plan import Ending, RunPlan
from hil.shells.run_setup import RunSetup, load_setup, shipped_controllers

if TYPE_CHECKING:
    from firmware_sim.scenario import Scenario

DEFAULT_DURATION_S = 10.0
SILENCE_HINT = (
    "Is the bus right (--bus), are the boards powered, the bit rate the same, the node ids 0x10 and 0x20?"
)
TRACEBACK_VARIABLE = "HIL_TRACEBACK"
LINEAR_CONTROLLERS = {"m": "ppid", "rad": "ppid_rad"}
"""What the paper designed for eq. (15), by unit."""


def main(argv: list[str]) -> int:
    """Run, then tell how it went. 0: completed or interrupted; 1: it ended otherwise, or is not recorded."""
    options = _parser().parse_args(argv)
    check_plant_options(options)
    scenario, scenario_text = _scenario(options)
    setup = _setup(options, scenario, scenario_text)
    bus = SIMULATED if options.lockstep else options.bus or setup.rig.bus.channel
    if bus == "pty":
        raise LinkError(
            "pty is a bus of firmware-sim: start `firmware-sim --bus pty`, which says what to join it with"
        )
    if bus == SIMULATED:
        setup = replace(setup, texts={**setup.texts, **plant_texts(setup.rig, options)})
    elif given := given_plant_options(options):
        raise DocumentError(
            f"{given[0]} chooses what `hil run` simulates; --bus {bus} is no simulation. Omit {given[0]}, or "
            "omit --bus"
        )
    if bus != SIMULATED and scenario is not None and scenario.events:
        sys.stderr.write("The scenario's events are the simulated arm's: firmware-sim --scenario has them.\n")
    duration_s = options.duration or (scenario.duration_s if scenario else DEFAULT_DURATION_S)
    plan = RunPlan(duration_s, setup.rig.loop.period_s)
    while True:
        path = recording_path(options.record, duration_s, is_drawn_twice=scenario is not None)
        try:
            if options.lockstep:
                report = run_lockstep(setup, plan, path, duration_s, options)
            else:
                report = run_realtime(setup, plan, path, bus, options)
        except RecordingExistsError:
            if options.record is not None:
                raise
            continue  # another run, begun at the same time, took the name
        return _tell(plan, report, scenario)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="hil run",
        description="Run the controllers against the rig and record it. Without options: the simulated arm.",
        epilog=f"Controllers shipped: {', '.join(shipped_controllers())}. Setpoints: {FORMS}.",
    )
    parser.add_argument("--rig", type=Path, metavar="FILE", help="rig file (the shipped example)")
    parser.add_argument(
        "--controller", action="append", default=[], metavar="AXIS=FILE", help="controller of an axis"
    )
    parser.add_argument(
        "--setpoint", action="append", default=[], metavar="AXIS=SETPOINT", help="setpoint of an axis"
    )
    parser.add_argument(
        "--duration", type=_seconds, metavar="S", help="seconds of control (10, or the scenario's)"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--bus", metavar="BUS", help="sim, vcan0, can0, slcan:/dev/ttyACM0, udp:PORT")
    where.add_argument(
        "--lockstep", action="store_true", help="simulated boards and simulated time, as fast as it goes"
    )
    parser.add_argument("--record", type=Path, metavar="FILE", help="recording (runs/<date>-<time>.mcap)")
    add_plant_options(parser)
    return parser


def _scenario(options: argparse.Namespace) -> tuple[Scenario | None, str]:
    if options.scenario is None:
        return None, ""
    from firmware_sim.scenario import find_scenario, read_scenario

    path = find_scenario(options.scenario)
    text = read_text(path)
    return read_scenario(text, str(path)), text


def _setup(options: argparse.Namespace, scenario: Scenario | None, scenario_text: str) -> RunSetup:
    """Rig file, then scenario or what the linear plant wants, then options: the later wins."""
    controllers = _by_axis("--controller", options.controller)
    setpoints = _by_axis("--setpoint", options.setpoint)
    texts, origins = {}, {}
    if scenario is not None:
        from firmware_sim.scenario import check_axes

        check_axes(scenario, load_setup(options.rig, {}, {}).rig.axes, f"scenario {options.scenario}")
        for key, named, given in (
            ("controllers", scenario.controllers, controllers),
            ("setpoints", scenario.setpoints, setpoints),
        ):
            for name in named.keys() - given.keys():
                origins[f"{key}.{name}"] = f"scenario {options.scenario}: {key}.{name}"
        controllers, setpoints = scenario.controllers | controllers, scenario.setpoints | setpoints
        texts["scenario.toml"] = scenario_text
    if options.linear:
        units = {name: axis.unit for name, axis in load_setup(options.rig, {}, {}).rig.axes.items()}
        controllers = {name: LINEAR_CONTROLLERS[unit] for name, unit in units.items()} | controllers
    return load_setup(options.rig, controllers, setpoints, texts, origins)


def _tell(plan: RunPlan, report: RecorderReport, scenario: Scenario | None) -> int:
    """Summary and plots, from the recording."""
    from rich.console import Console

    from hil.recording.reader import Recording
    from hil.views.plots import plot_run
    from hil.views.summary import summarise

    class Printer(Console):
        def on_broken_pipe(self) -> None:
            self.quiet = True  # `| head`: the plot is made all the same

    console = Printer(highlight=False, soft_wrap=True)
    ending: dict[str, str] = {}
    trace = ""
    in_file = 0
    try:
        recording = Recording(report.path)
        in_file = sum(recording.counts.values())
        ending = recording.metadata.get("ending", {})
        trace = recording.metadata.get("error", {}).get("traceback", "")
        console.print(summarise(recording).table())
        console.print(f"recording  {report.path}  (opens in Foxglove and PlotJuggler)")
        picture = picture_of(report.path)
        plot_run(recording, picture)
        console.print(f"plot       {picture}")
        if scenario is not None:
            figure = figure_of(report.path)
            plot_run(recording, figure, axes=scenario.figure_axes, title=scenario.title)
            console.print(f"figure     {figure}")
        console.print(f"next       hil replay --verify {report.path}")
    except HilError as error:
        console.print(f"incomplete: {error}", style="yellow")
    if report.failure:
        text = f"recording: {report.failure}; {report.missing(in_file)} messages are missing in the file"
        console.print(text, style="red")
    if plan.ending in (Ending.COMPLETED, Ending.INTERRUPTED):
        return 1 if report.failure else 0
    if plan.ending is Ending.NO_BOARDS:
        readiness = ending.get("readiness", "")
        hint = f". {SILENCE_HINT}" if "silent" in readiness else ""
        if readiness.endswith("dac operational"):
            hint = "; no sample came"
        console.print(f"The boards did not come up: {readiness or 'nothing is recorded'}{hint}", style="red")
    else:
        console.print(f"ended by {plan.ending}: {ending.get('fault', '')}", style="red")
    if trace:
        console.print(
            "That is a mistake of hil or of a library that it uses. Please report it to its maintainers with "
            f"the recording, whose metadata holds the traceback ({TRACEBACK_VARIABLE}=1 prints it here).",
            style="red",
        )
        if os.environ.get(TRACEBACK_VARIABLE):
            sys.stderr.write(trace)
    return 1


def _by_axis(option: str, given: list[str]) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or not name or not value:
            raise DocumentError(f"{text!r} is not AXIS=VALUE, such as vertical=ppid")
        if name in pairs:
            raise DocumentError(f"{option} {name}: given twice, {pairs[name]!r} and {value!r}")
        pairs[name] = value
    return pairs


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds over 0")
    return value
