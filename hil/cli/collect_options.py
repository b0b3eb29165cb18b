"""The options of ``hil collect``, and the experiment that they ask for."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import msgspec

from firmware_sim.plant_options import add_plant_options
from hil.cli.run import duration_argument
from hil.core.document_words import validation_problem
from hil.core.errors import DocumentError
from hil.core.excitation import KINDS, Signal, read_table
from hil.core.experiment import MAX_PAUSE_S, Experiment, Origins, check_experiment
from hil.core.rig import Rig
from hil.core.suggestions import did_you_mean
from hil.host.command_parser import (
    CommandParser,
    add_controller_option,
    add_override_option,
    number,
    seconds,
)
from hil.host.text_file import MAX_TABLE_BYTES, read_text
from hil.live.address import add_page_options

DESCRIPTION = """\
Excite one axis and record it, as data for `hil identify`. The axis is first brought to its centre by its
controller, and the valve voltage at which it stands still is measured. The other axes are held where they
are. Exit status: 0 if the whole excitation was given and recorded, 1 if not, 2 if the arguments or files are
wrong, 130 if it was interrupted: then the recording is incomplete."""
EPILOG = """\
excitations, with the options that belong to each:
  prbs       pseudo-random sequence of 2, 3, 5 or 7 levels
             --amplitude --duration --clock --levels --seed
  multisine  sines on all lines of a band
             --amplitude --duration --band --repetitions --phases --seed
  chirp      a sine that sweeps over a band once
             --amplitude --duration --band --sweep
  steps      +amplitude, 0, -amplitude, 0, and again
             --amplitude --duration --hold
  csv:FILE   columns time_s,value; each value is held until the next row

Amplitudes are in V about the valve's centre, or in the axis' unit with --excite setpoint.

A position beyond the travel fence (rig file: fence_min_y, fence_max_y) takes the axis back under its
controller. The excitation goes on when the axis is back in the centre.
"""
FIELDS = {
    "amplitude": "amplitude",
    "duration": "duration_s",
    "clock": "clock_periods",
    "levels": "levels",
    "repetitions": "repetitions",
    "phases": "phases",
    "sweep": "sweep",
    "hold": "hold_s",
}
"""Option of the command to field of the excitation's document."""
DEFAULTS = {"amplitude": 0.4, "duration_s": 60.0}
"""±0.4 V: less drowns in the friction of the simulated arm, more reaches its stops."""
MODES = {"valve": "open loop", "controller": "controller output", "setpoint": "setpoint"}


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil collect``."""
    command = CommandParser(prog="hil collect", description=DESCRIPTION, epilog=EPILOG)
    command.add_argument("--axis", required=True, metavar="AXIS", help="axis to excite")
    command.add_argument("--excitation", default="prbs", metavar="KIND", help="see below (default prbs)")
    command.add_argument("--amplitude", type=number, metavar="V", help="largest deviation (default 0.4)")
    command.add_argument(
        "--duration", type=duration_argument, metavar="S", help="seconds of excitation (default 60)"
    )
    command.add_argument(
        "--clock", type=int, metavar="N", help="periods between changes of a prbs (default 12)"
    )
    command.add_argument("--levels", type=int, metavar="N", help="levels of a prbs: 2, 3, 5 or 7 (default 2)")
    command.add_argument("--band", metavar="LOW:HIGH", help="band in rad/s (default 0.2:40)")
    command.add_argument(
        "--repetitions", type=int, metavar="N", help="repetitions of a multisine (default 2)"
    )
    command.add_argument("--phases", metavar="KIND", help="phases of a multisine: schroeder or random")
    command.add_argument("--sweep", metavar="KIND", help="sweep of a chirp: logarithmic or linear")
    command.add_argument("--hold", type=seconds, metavar="S", help="seconds that a step is held (default 2)")
    command.add_argument(
        "--excite",
        choices=tuple(MODES),
        default="valve",
        help="valve: open loop; controller: added to its output; setpoint: added to it (default valve)",
    )
    command.add_argument(
        "--centre", type=number, default=0.0, metavar="Y", help="position to excite about (default 0)"
    )
    command.add_argument(
        "--settle", type=seconds, default=4.0, metavar="S", help="seconds at rest before (default 4)"
    )
    command.add_argument("--rig", type=Path, metavar="FILE", help="rig file (default: the shipped example)")
    add_controller_option(command)
    where = command.add_mutually_exclusive_group()
    where.add_argument("--bus", metavar="BUS", help="bus of the boards instead of the rig file's")
    where.add_argument("--lockstep", action="store_true", help="simulated boards in simulated time")
    command.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="recording (default runs/<date>-<time>.mcap)"
    )
    command.add_argument("--dry-run", action="store_true", help="show spectrum and predicted travel, and end")
    command.add_argument("--yes", action="store_true", help="do not ask before a real axis moves")
    add_override_option(command)
    add_plant_options(command)
    add_page_options(command)
    return command


def experiment_of(options: argparse.Namespace, rig: Rig) -> Experiment:
    """Build the experiment that the options ask for. Raises DocumentError naming the option."""
    if options.axis not in rig.axes:
        raise DocumentError(
            f"--axis {options.axis}: the axes of the rig are {', '.join(rig.axes)}"
            f"{did_you_mean(options.axis, rig.axes)}"
        )
    if not 0.0 < options.settle <= MAX_PAUSE_S:
        raise DocumentError(f"--settle {options.settle:g}: must be over 0 s and at most {MAX_PAUSE_S:g} s")
    experiment = Experiment(
        format="hil-experiment",
        version=1,
        axis=options.axis,
        mode=MODES[options.excite],  # type: ignore[arg-type]  # argparse allows the keys of MODES only
        signal=_signal(options),
        centre=options.centre,
        settle_s=options.settle,
    )
    kind = options.excitation.partition(":")[0]
    signal = f"--excitation {options.excitation}" if kind == "csv" else "--amplitude"
    check_experiment(experiment, rig, Origins("--axis", "--centre", signal))
    return experiment


def _signal(options: argparse.Namespace) -> Signal:
    """Build the excitation. Raises DocumentError for an option that does not belong to its kind."""
    kind, _, file = options.excitation.partition(":")
    if kind not in KINDS:
        raise DocumentError(
            f"--excitation {options.excitation}: must be one of prbs, multisine, chirp, steps, csv:FILE"
            f"{did_you_mean(kind, KINDS)}"
        )
    given: dict[str, Any] = {
        field: getattr(options, option)
        for option, field in FIELDS.items()
        if getattr(options, option) is not None
    }
    if options.band is not None:
        given["low_rad_s"], given["high_rad_s"] = _band(options.band)
    if kind == "csv":
        if given:
            raise DocumentError(
                f"--excitation csv: --{_option(next(iter(given)))} does not belong to it: the file says all"
            )
        if not file:
            raise DocumentError("--excitation csv: the file is missing; write --excitation csv:FILE")
        return read_table(read_text(Path(file), MAX_TABLE_BYTES), file)
    document = KINDS[kind]
    fields = {field.name for field in msgspec.structs.fields(document)}
    for field in given:
        if field not in fields:
            raise DocumentError(
                f"--{_option(field)} does not belong to --excitation {kind}; see hil collect --help"
            )
    if "seed" in fields:
        given["seed"] = options.seed
    plain = {"kind": kind, **DEFAULTS, **given}
    try:
        return msgspec.convert(plain, document)  # type: ignore[return-value]
    except msgspec.ValidationError as error:
        field, _, problem = validation_problem(str(error), plain, document).partition(" ")
        raise DocumentError(f"--excitation {kind}: --{_option(field)} {problem}") from None


def _option(field: str) -> str:
    """Return the option that sets a field."""
    names = {field: option for option, field in FIELDS.items()}
    return names.get(field, "band")


def _band(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise DocumentError(f"--band {text}: must be two frequencies in rad/s, such as 0.2:40") from None
    if not 0.0 < low < high:
        raise DocumentError(
            f"--band {text}: LOW must be over 0 rad/s and under HIGH; write --band LOW:HIGH, such as 0.2:40"
        )
    return low, high
