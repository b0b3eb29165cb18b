"""``hil run``: run the controllers against the rig, record the run, sum it up and plot it.

Nothing slow is imported before the loop. What only the summary needs is imported after the run.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_sim.plant_options import add_plant_options, check_plant_options, given_plant_options
from firmware_sim.simulated_plant import plant_texts
from hil.cli.axis_values import by_axis
from hil.cli.confirmation import confirm_motion
from hil.cli.launch import run_lockstep, run_realtime
from hil.cli.quantities import duration_text
from hil.cli.record_path import create_folder_of, recording_path, remove_empty
from hil.cli.run_parts import SIMULATED
from hil.core.check_names import check_overrides
from hil.core.errors import DocumentError, HilError, LinkError, RecordingExistsError
from hil.core.setpoints import EXAMPLE, EXAMPLE_POSITION, FORMS
from hil.host.command_parser import CommandParser, add_controller_option, add_override_option, duration
from hil.host.controller_files import shipped_controllers
from hil.host.text_file import read_text
from hil.live.address import add_page_options, check_page_options
from hil.recording.recorder import RecorderReport
from hil.shells.real_bus import is_real
from hil.shells.run_plan import Ending, RunPlan
from hil.shells.run_setup import RunSetup, load_rig, load_setup

if TYPE_CHECKING:
    from firmware_sim.scenario import Scenario

DEFAULT_DURATION_S = 10.0
MAX_DURATION_S = 1000 * 86_400.0
LINEAR_CONTROLLERS = {"m": "ppid", "rad": "ppid_rad"}
"""Controllers that the paper designed for eq. (15), by the axis' unit."""
DESCRIPTION = """\
Run the controllers against the rig, record the run, and print its summary. Without options, the rig is the
simulated arm. Exit status: 0 if the run was completed or interrupted, 1 if it ended otherwise or its
recording is incomplete, 2 if the arguments or files are wrong."""
EPILOG = """\
Setpoints, with sizes in the axis' unit and times in seconds since control began:
  {forms}
  a number alone, such as {position}: this position from the beginning on

Control begins without a jump of the valve. A setpoint that is not at the axis' position at time 0 is
approached slowly, not as a step, and a warning says so. One that is further away than max_error (rig file,
axes.NAME.envelope) is refused.

Controllers: the name of a shipped one ({shipped}), or a JSON file such as `hil design` writes. With --linear
and without --rig, every axis has {linear}, which were designed for eq. (15).

Buses: sim (simulated boards in a process of their own), vcan0, can0, slcan:/dev/ttyACM0, udp:PORT. On can0
and slcan, a real arm may move: the command shows positions and setpoints, and asks. Without a terminal to ask
on, it needs --yes."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil run``."""
    epilog = EPILOG.format(
        forms="\n  ".join(FORMS.values()),
        position=EXAMPLE_POSITION,
        shipped=", ".join(shipped_controllers()),
        linear=" or ".join(LINEAR_CONTROLLERS.values()),
    )
    command = CommandParser(prog="hil run", description=DESCRIPTION, epilog=epilog)
    command.add_argument("--rig", type=Path, metavar="FILE", help="rig file (default: the shipped example)")
    add_controller_option(command)
    command.add_argument(
        "--setpoint",
        action="append",
        default=[],
        metavar="AXIS=SETPOINT",
        help="setpoint of an axis instead of the rig file's; may be repeated",
    )
    command.add_argument(
        "--duration",
        type=duration_argument,
        metavar="S",
        help=f"time of control, in s or such as 5min (default {DEFAULT_DURATION_S:g}, or the scenario's)",
    )
    where = command.add_mutually_exclusive_group()
    where.add_argument("--bus", metavar="BUS", help="bus of the boards instead of the rig file's")
    where.add_argument(
        "--lockstep",
        action="store_true",
        help="simulated boards in simulated time, as fast as possible; the same bytes in every run",
    )
    command.add_argument(
        "--record", type=Path, metavar="FILE", help="recording (default runs/<date>-<time>.mcap)"
    )
    command.add_argument(
        "--yes", action="store_true", help="do not ask before the axes of a bus that may be real move"
    )
    add_override_option(command)
    command.add_argument("--no-plot", action="store_true", help="draw no plot beside the recording")
    add_plant_options(command)
    add_page_options(command)
    return command


def main(argv: list[str]) -> int:
    """Run ``hil run`` with ``argv``; return its exit status. Raises HilError for wrong arguments or files."""
    options = parser().parse_args(argv)
    check_plant_options(options)
    check_page_options(options)
    scenario, scenario_text = given_scenario(options)
    setup = read_setup(options, scenario, scenario_text)
    check_overrides(options.override, setup.rig)
    bus = chosen_bus(options, setup)
    if bus == SIMULATED:
        setup = replace(setup, texts={**setup.texts, **plant_texts(setup.rig, options)})
    elif scenario is not None and (scenario.events or scenario.faults):
        sys.stderr.write(
            f"hil run: with --bus {bus}, the events and faults of the scenario do not happen; "
            "`firmware-sim --scenario` simulates them\n"
        )
    if is_real(bus) and not options.yes:
        confirm_motion(setup, bus)
    duration_s = options.duration or (scenario.duration_s if scenario else DEFAULT_DURATION_S)
    plan = RunPlan(duration_s, setup.rig.loop.period_s, overrides=options.override)
    report = _recorded_run(setup, plan, bus, duration_s, options)
    from hil.cli.run_report import print_run_report

    print_run_report(plan.ending, report, scenario, has_plots=not options.no_plot)
    return _exit_status(plan.ending, report)


def _recorded_run(
    setup: RunSetup, plan: RunPlan, bus: str, duration_s: float, options: argparse.Namespace
) -> RecorderReport:
    """Choose the file and run. Another name is chosen if another run has just created that file."""
    while True:
        path = recording_path(options.record, duration_s, has_figure=options.scenario is not None)
        created = create_folder_of(path)
        if created and options.record is not None:
            sys.stderr.write(f"hil run: created the folder {created[0]}\n")
        try:
            if options.lockstep:
                return run_lockstep(setup, plan, path, duration_s, options)
            return run_realtime(setup, plan, path, bus, options)
        except RecordingExistsError:
            if options.record is not None:
                raise
        except HilError:
            remove_empty(created)
            raise


def _exit_status(ending: Ending | None, report: RecorderReport) -> int:
    return 0 if ending in (Ending.COMPLETED, Ending.INTERRUPTED) and not report.failure else 1


def chosen_bus(options: argparse.Namespace, setup: RunSetup) -> str:
    """Return the bus to run on. Raises LinkError or DocumentError."""
    bus: str = SIMULATED if options.lockstep else options.bus or setup.rig.bus.channel
    if bus == "pty":
        raise LinkError(
            "pty is a bus of firmware-sim: start `firmware-sim --bus pty`, which prints the bus for `hil run`"
        )
    given = given_plant_options(options)
    if bus != SIMULATED and given:
        raise DocumentError(
            f"{given[0]} chooses what `hil run` simulates; --bus {bus} is no simulation. Omit {given[0]}, or "
            "omit --bus"
        )
    if bus.startswith("inproc:"):
        raise LinkError(
            f"{bus!r} is a bus inside one process, which the boards cannot join; use sim, vcan0, can0, "
            "slcan:DEVICE or udp:PORT"
        )
    return bus


def given_scenario(options: argparse.Namespace) -> tuple[Scenario | None, str]:
    """Return the scenario of ``--scenario`` and its text. Raises DocumentError."""
    if options.scenario is None:
        return None, ""
    from firmware_sim.scenario import find_scenario, read_scenario

    path = find_scenario(options.scenario)
    text = read_text(path)
    return read_scenario(text, str(path)), text


def read_setup(options: argparse.Namespace, scenario: Scenario | None, scenario_text: str) -> RunSetup:
    """Read the setup of the run. Options win over the scenario, and the scenario over the rig file."""
    controllers = by_axis("--controller", options.controller, "vertical=ppid")
    setpoints = by_axis("--setpoint", options.setpoint, f"vertical={EXAMPLE}")
    if scenario is None:
        return load_setup(options.rig, _linear_controllers(options) | controllers, setpoints)
    from firmware_sim.scenario import check_axes

    source = f"scenario {options.scenario}"
    check_axes(scenario, load_rig(options.rig).axes, source)
    origins = {
        f"{key}.{name}": f"{source}: {key}.{name}"
        for key, of_scenario, given in (
            ("controllers", scenario.controllers, controllers),
            ("setpoints", scenario.setpoints, setpoints),
        )
        for name in of_scenario.keys() - given.keys()
    }
    return load_setup(
        options.rig,
        scenario.controllers | controllers,
        scenario.setpoints | setpoints,
        {"scenario.toml": scenario_text},
        origins,
    )


def _linear_controllers(options: argparse.Namespace) -> dict[str, str]:
    """Return controllers for eq. (15) instead of those of the shipped rig file.

    The controllers of a rig file that the user names are kept.
    """
    if not options.linear or options.rig is not None:
        return {}
    return {name: LINEAR_CONTROLLERS[axis.unit] for name, axis in load_rig(None).axes.items()}


def duration_argument(text: str) -> float:
    """Return the duration of a run in seconds from the text of an argument, at most ``MAX_DURATION_S``."""
    value = duration(text)
    if value > MAX_DURATION_S:
        raise argparse.ArgumentTypeError(
            f"{text!r} is more than the limit {MAX_DURATION_S:.0f} s ({duration_text(MAX_DURATION_S)})"
        )
    return value
