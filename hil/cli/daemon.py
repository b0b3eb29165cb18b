"""``hil daemon``: run the gateway until it is stopped, controlled from outside through a socket."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from firmware_sim.plant_options import add_plant_options, check_plant_options
from firmware_sim.simulated_plant import plant_texts, refuse_host_faults
from hil.cli.axis_values import by_axis
from hil.cli.operate import add_socket_option
from hil.cli.run import chosen_bus, given_scenario, read_setup
from hil.cli.run_parts import SIMULATED
from hil.core.errors import DocumentError
from hil.core.setpoints import HOLD
from hil.host.command_parser import CommandParser, add_controller_option, duration, number
from hil.live.address import add_page_options
from hil.shells.run_setup import RIG_NAME, calibration_setup, load_rig, unusable_setpoints

DESCRIPTION = """\
Run the gateway until it is stopped. The daemon brings the boards up and waits in state ready; it never arms
by itself. `hil arm`, `hil start`, `hil setpoint` and others operate it, as does `hil.connect()` in Python.
SIGTERM, SIGINT and `hil shutdown` end it: the valves are centred, then the recording is closed. Exit status:
0 if it was ended like that, 1 if it ended otherwise or its recording is incomplete, 2 if the arguments or
files are wrong, or if another gateway uses the bus."""
EPILOG = """\
Every axis keeps the position that it has at `hil start`, until `hil setpoint` or --setpoint says otherwise.
The setpoints of the rig file are for `hil run`.

Under systemd (--install-unit), readiness and watchdog are reported, and the log goes to the journal."""

MIN_MEGABYTES = 1.0
"""Smallest size at which a recording goes on in another file: half a minute of three axes."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil daemon``."""
    command = CommandParser(prog="hil daemon", description=DESCRIPTION, epilog=EPILOG)
    command.add_argument("--rig", type=Path, metavar="FILE", help="rig file (default: the shipped example)")
    command.add_argument("--bus", metavar="BUS", help="bus of the boards instead of the rig file's")
    add_controller_option(command)
    command.add_argument(
        "--setpoint",
        action="append",
        default=[],
        metavar="AXIS=SETPOINT",
        help="setpoint with which an axis starts (default: hold); may be repeated",
    )
    command.add_argument(
        "--calibrate",
        metavar="AXIS",
        help="widen the limits of this axis for `hil calibrate --jog`: it can be jogged to its ends with a "
        "low voltage, and controllers do not start",
    )
    add_socket_option(command)
    command.add_argument(
        "--record", type=Path, metavar="FILE", help="first recording (default runs/<date>-<time>.mcap)"
    )
    command.add_argument("--no-record", action="store_true", help="record nothing")
    rotation = command.add_argument_group(
        "recordings for days", "Each file is complete in itself, and `hil replay` verifies it alone."
    )
    rotation.add_argument(
        "--rotate-after",
        dest="rotate_s",
        type=duration,
        metavar="TIME",
        help="begin another file after this time, such as 3600s",
    )
    rotation.add_argument(
        "--rotate-at",
        dest="rotate_bytes",
        type=megabytes,
        metavar="MB",
        help="begin another file when the present one has this many megabytes",
    )
    rotation.add_argument(
        "--keep",
        type=file_count,
        metavar="N",
        help="keep the last N files of this daemon and remove older ones (default: remove none)",
    )
    units = command.add_argument_group("systemd")
    units.add_argument(
        "--install-unit",
        action="store_true",
        help="install the unit file of the daemon and an example of the network file of can0, and end",
    )
    units.add_argument("--force", action="store_true", help="overwrite installed files")
    add_plant_options(command)
    page = add_page_options(command)
    page.add_argument("--operate", action="store_true", help="let the page operate the daemon")
    command.set_defaults(lockstep=False)
    return command


def megabytes(text: str) -> int:
    """Return the bytes of a number of megabytes."""
    value = number(text)
    if value < MIN_MEGABYTES:
        raise argparse.ArgumentTypeError(f"{text!r} must be {MIN_MEGABYTES:g} MB or more")
    return round(value * 1e6)


def file_count(text: str) -> int:
    """Return a number of files from the text of an argument."""
    value = number(text)
    if value < 1 or value != round(value):
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number of files, 1 or more")
    return round(value)


def main(argv: list[str]) -> int:
    """Run ``hil daemon`` with ``argv``; return its exit status. Raises HilError for wrong input."""
    options = parser().parse_args(argv)
    if options.install_unit:
        from hil.cli.unit_files import install

        return install(options.force)
    check_plant_options(options)
    if options.no_record and (options.record or options.rotate_s or options.rotate_bytes or options.keep):
        raise DocumentError(
            "--no-record records nothing: omit it, or omit --record, --rotate-after, --rotate-at and --keep"
        )
    if options.operate and not options.live:
        raise DocumentError("--operate lets the page operate the daemon, and there is no page: add --live")
    scenario, scenario_text = given_scenario(options)
    options.setpoint = _held(options, set(scenario.setpoints) if scenario else set())
    setup = read_setup(options, scenario, scenario_text)
    for problem in unusable_setpoints(options.rig, setup):
        sys.stderr.write(f"hil daemon: warning: {problem}; this daemon holds the position instead\n")
    if options.calibrate is not None:
        setup = calibration_setup(setup, options.calibrate, str(options.rig or RIG_NAME))
    bus = chosen_bus(options, setup)
    if bus == SIMULATED:
        refuse_host_faults(options)
        setup = replace(setup, texts={**setup.texts, **plant_texts(setup.rig, options)})
    from hil.cli.daemon_run import run_daemon

    return run_daemon(setup, bus, options)


def _held(options: argparse.Namespace, of_scenario: set[str]) -> list[str]:
    """Return the setpoints of the command line, and ``hold`` for each axis that has none."""
    given = by_axis("--setpoint", options.setpoint, "vertical=hold").keys() | of_scenario
    held = [f"{axis}={HOLD}" for axis in load_rig(options.rig).axes if axis not in given]
    return [*options.setpoint, *held]
