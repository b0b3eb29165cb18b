"""``hil calibrate``: measure an axis' potentiometer or valve, and write the values into a rig file."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from datetime import date
from pathlib import Path

from hil.cli.calibrate_by_hand import Ends, enter_pressed
from hil.cli.calibrate_jogged import JOG_V, JoggedEnds, armed, check_daemon, keys_of_terminal
from hil.cli.calibrate_valve import JoggedAxis
from hil.cli.confirmation import announce_bit_rate
from hil.cli.daemon_rig import check_channels, check_settings
from hil.cli.monitor import BIT_RATE, Monitor, bus_to_hear
from hil.cli.operate import add_socket_option
from hil.core.calibration import (
    CalibrationError,
    End,
    RestingVolts,
    check_middle,
    potentiometer_values,
    valve_values,
)
from hil.core.errors import DocumentError
from hil.core.rig import AxisSettings, Rig, read_rig
from hil.core.rig_edit import with_values
from hil.core.suggestions import did_you_mean
from hil.host.command_parser import CommandParser, number
from hil.host.text_file import read_text
from hil.links import open_link
from hil.operation.client import connect
from hil.shells.run_setup import load_rig

MAX_SPAN_RATIO = 10.0
"""Largest ratio of a stated end to the axis' range in the rig file; more is a mistaken unit."""
STEP_V = 0.02
"""Step of the valve's offset, in volts. The centre is interpolated between steps."""
_HOW_TO_WRITE = "give -o NEW.toml for a new rig file, or --force to change that of --rig"
DESCRIPTION = """\
Measure one axis, and write the values into a rig file, with a comment that says where they come from.

Potentiometer (--low and --high): the valves stay centred and nothing is moved by this program. Switch the
supply pressure off, move the axis by hand to each end and to a place between them, and press Enter. --low and
--high are the positions of the ends, measured with a ruler or a protractor.

If no hand can move the axis, jogs can (--jog): needs a running `hil daemon --calibrate AXIS`, whose limits
are wide for this axis and whose jogs have a low voltage. The axis moves while a key is held, and stops within
0.3 s after it is released.

Valve (--valve): needs a running `hil daemon` in state ready or armed. The axis is moved to and fro by jogs of
0.3 s with growing voltage, until it moves both ways. Found are the voltage at which it stands still, and the
dead band. Ctrl-C stops the axis within 0.3 s.

Exit status: 0, or 1 if a measurement makes no sense, 2 for wrong arguments or files."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil calibrate``."""
    command = CommandParser(prog="hil calibrate", description=DESCRIPTION)
    command.add_argument("--axis", required=True, metavar="NAME", help="axis of the rig file")
    command.add_argument("--rig", type=Path, metavar="FILE", help="rig file (default: the shipped example)")
    command.add_argument(
        "--low", type=float, metavar="Y", help="position of the lower end, in the axis' unit"
    )
    command.add_argument("--high", type=float, metavar="Y", help="position of the upper end")
    command.add_argument(
        "--jog",
        type=number,
        nargs="?",
        const=JOG_V,
        metavar="V",
        help=f"move the axis to its ends by keys, with V volts from the valve's centre (default {JOG_V:g})",
    )
    command.add_argument("--valve", action="store_true", help="find the valve's centre and dead band")
    command.add_argument("--yes", action="store_true", help="with --valve or --jog: do not ask first")
    command.add_argument("--bus", metavar="BUS", help="bus to listen to (default: the rig file's)")
    where = command.add_mutually_exclusive_group()
    where.add_argument("-o", "--output", type=Path, metavar="FILE", help="write a new rig file")
    where.add_argument("--force", action="store_true", help="change the rig file of --rig")
    add_socket_option(command)
    return command


def main(argv: list[str]) -> int:
    """Measure, print the values, and write them if a file is given. Raises HilError."""
    options = parser().parse_args(argv)
    rig = load_rig(options.rig)
    _check(options, rig)
    if not (options.output or options.force):
        sys.stderr.write(f"The values will be printed, but not written: {_HOW_TO_WRITE}.\n")
    try:
        if options.valve:
            part, values, origin = _valve(options, rig)
        elif options.jog is not None:
            part, values, origin = _jogged_potentiometer(options, rig)
        else:
            part, values, origin = _potentiometer(options, rig)
    except CalibrationError as error:
        sys.stderr.write(f"hil calibrate: {error}\n")
        return 1
    table = ("axes", options.axis, part)
    sys.stdout.write(f"[{'.'.join(table)}]\n")
    sys.stdout.writelines(f"{key} = {value:.6g}\n" for key, value in values.items())
    sys.stdout.write(f"# {origin}\n")
    _write(options, table, values, origin)
    return 0


def _check_ends(options: argparse.Namespace, axis: AxisSettings) -> None:
    """Refuse ends that are far outside the range of the axis. Raises DocumentError."""
    limit = MAX_SPAN_RATIO * max(abs(axis.min_y), abs(axis.max_y))
    if max(abs(options.low), abs(options.high)) > limit:
        raise DocumentError(
            f"--low {options.low:g}, --high {options.high:g}: far beyond {axis.min_y:g} to {axis.max_y:g} "
            f"{axis.unit} (rig: axes.{options.axis}.min_y, max_y); positions are in {axis.unit}"
        )


def _check(options: argparse.Namespace, rig: Rig) -> None:
    """Check the arguments against each other and the rig. Raises DocumentError."""
    if options.axis not in rig.axes:
        raise DocumentError(
            f"--axis {options.axis}: the axes of the rig are {', '.join(rig.axes)}"
            f"{did_you_mean(options.axis, rig.axes)}"
        )
    ends = (options.low, options.high)
    if options.valve and ends != (None, None):
        raise DocumentError(
            "--valve and --low, --high do not go together: --valve calibrates the valve, --low and --high "
            "the potentiometer; give two commands"
        )
    if not options.valve and None in ends:
        raise DocumentError(
            "give --low and --high, the positions of both ends, to calibrate the potentiometer; or --valve"
        )
    if options.low is not None and not (math.isfinite(options.low) and math.isfinite(options.high)):
        raise DocumentError(f"--low {options.low}, --high {options.high}: positions must be finite numbers")
    if options.jog is not None and (options.valve or not options.jog > 0.0):
        raise DocumentError(
            f"--jog {options.jog:g}: belongs to --low and --high, and must be over 0 V; the keys choose the "
            "direction"
        )
    if options.low is not None:
        _check_ends(options, rig.axes[options.axis])
    if (options.force or options.output) and options.rig is None:
        raise DocumentError("--rig is missing: name the rig file whose values are to be changed")
    if options.output and options.output.exists():
        raise DocumentError(f"{options.output}: exists already and is kept; name another file")


def _potentiometer(options: argparse.Namespace, rig: Rig) -> tuple[str, dict[str, float], str]:
    samples: list[tuple[float, ...]] = []
    bus = bus_to_hear(options, rig)
    announce_bit_rate(bus, rig.bus.bit_rate)
    with open_link(bus, rig.bus.bit_rate) as link:
        clock_ns = time.monotonic_ns
        monitor = Monitor(link, rig, BIT_RATE, sends_sync=True, clock_ns=clock_ns, on_sample=samples.append)
        ends = Ends(monitor, rig, options.axis, samples, enter_pressed, clock_ns)
        return _measured_ends(options, rig, ends.measure, ends.measure)


def _jogged_potentiometer(options: argparse.Namespace, rig: Rig) -> tuple[str, dict[str, float], str]:
    with connect(options.socket) as client:
        check_daemon(client.status(), options.axis)
        check_channels(client, options.rig, rig, options.axis)
        _confirm(options, f"to its ends, by keys that you hold, with {options.jog:g} V")
        with keys_of_terminal() as pressed, armed(client):
            ends = JoggedEnds(client, rig, options.axis, options.jog, pressed)
            part, values, origin = _measured_ends(options, rig, ends.end, ends.between)
    recording = f", recording {Path(ends.recording).name}" if ends.recording else ""
    return part, values, f"{origin}; moved by jogs{recording}"


def _measured_ends(
    options: argparse.Namespace,
    rig: Rig,
    measure: Callable[[str], RestingVolts],
    between: Callable[[str], RestingVolts],
) -> tuple[str, dict[str, float], str]:
    """Measure both ends and a place between them. Return the table, its values and their origin."""
    unit = rig.axes[options.axis].unit
    channel = rig.axes[options.axis].potentiometer.channel
    low = End(options.low, measure(f"its lower end, {options.low:g} {unit}"))
    high = End(options.high, measure(f"its upper end, {options.high:g} {unit}"))
    values = potentiometer_values(rig, options.axis, low, high)
    check_middle(options.axis, channel, low, high, between("a place between its ends"))
    low_v, high_v = (end.volts.mean_v[channel - 1] for end in (low, high))
    origin = (
        f"{date.today():%Y-%m-%d} by hil calibrate: {low_v:.3f} V at {low.y:g} {unit}, {high_v:.3f} V at "
        f"{high.y:g} {unit}"
    )
    return "potentiometer", values._asdict(), origin


def _valve(options: argparse.Namespace, rig: Rig) -> tuple[str, dict[str, float], str]:
    settings = rig.axes[options.axis]
    with connect(options.socket) as client:
        state = client.status().state
        if state not in ("ready", "armed"):
            raise CalibrationError(
                f"{options.axis}: the daemon is in state {state}; bring it to ready or armed (hil status)"
            )
        check_settings(client, options.rig, options.axis)
        _confirm(options, f"to and fro, with up to {settings.operator_limits.jog_max_v:g} V")
        axis = JoggedAxis(client, options.axis)
        with armed(client):
            found = valve_values(rig, options.axis, axis.speed, STEP_V)
    origin = f"{date.today():%Y-%m-%d} by hil calibrate: dead band {found.dead_band_v:.3f} V"
    if axis.recording:
        origin += f", recording {Path(axis.recording).name}"
    return "valve", {"centre_v": round(found.centre_v, 3)}, origin


def _confirm(options: argparse.Namespace, motion: str) -> None:
    """Ask before the axis moves. Raises CalibrationError without a yes."""
    if options.yes:
        return
    sys.stderr.write(
        f"{options.axis} will move {motion} from the valve's centre. Is its range free of people? Type yes: "
    )
    sys.stderr.flush()
    if sys.stdin.readline().strip().lower() != "yes":
        raise CalibrationError("not confirmed; nothing was moved")


def _write(
    options: argparse.Namespace, table: tuple[str, ...], values: dict[str, float], origin: str
) -> None:
    """Write the values to the file that the user has named. Raises DocumentError."""
    path: Path | None = options.rig if options.force else options.output
    if path is None:
        sys.stdout.write(f"not written: {_HOW_TO_WRITE}\n")
        return
    edited = with_values(read_text(options.rig), table, values, origin, str(options.rig))
    read_rig(edited, f"{options.rig} with these values")
    temporary = path.with_name(f"{path.name}.new")
    try:
        temporary.write_text(edited, encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        raise DocumentError(f"{path}: cannot be written: {error.strerror}") from None
    sys.stdout.write(f"{path} written\n")
