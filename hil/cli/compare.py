"""``hil compare``: compare two recordings signal by signal."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

from hil.core.suggestions import did_you_mean
from hil.host.command_parser import CommandParser

EVENTS = {"running": "RUNNING", "setpoint": "SETPOINT", "begin": "BEGIN"}
SIGNALS = {"setpoint": "setpoint", "position": "position", "error": "error", "valve": "command_v"}
"""Signals by their names in ``--tolerance``."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil compare``."""
    command = CommandParser(
        prog="hil compare",
        description="Compare the signals of two recordings, aligned on an event: the first period under "
        "control, or the first recorded period if a run was never under control. Only periods in which both "
        "runs were under control are compared, or all if neither was. The table has the largest difference "
        "of each signal and where it is. Exit status: 0 if the runs were compared, 1 if a difference "
        "exceeds a --tolerance, 2 if they cannot be compared.",
    )
    command.add_argument("first", type=Path, metavar="A", help="recording of `hil run`")
    command.add_argument("second", type=Path, metavar="B", help="recording to compare it with")
    command.add_argument("--align", choices=list(EVENTS), help="event to align on (default: see above)")
    command.add_argument(
        "--tolerance",
        action="append",
        default=[],
        type=_tolerance,
        metavar="[SIGNAL=]VALUE",
        help="largest accepted difference, in the signal's unit, of all signals or of setpoint, position, "
        "error or valve; may be repeated",
    )
    return command


def _tolerance(text: str) -> tuple[str, float]:
    """Return the signal, empty for all, and its tolerance."""
    name, equals, value = text.rpartition("=")
    if equals and name not in SIGNALS:
        raise argparse.ArgumentTypeError(
            f"{name!r} is not one of {', '.join(SIGNALS)}{did_you_mean(name, SIGNALS)}"
        )
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not 0.0 <= number < math.inf:
        raise argparse.ArgumentTypeError(f"{value!r} is not a number of 0 or more")
    return SIGNALS.get(name, ""), number


def main(argv: list[str]) -> int:
    """Run ``hil compare`` with ``argv``; return its exit status. Raises HilError."""
    options = parser().parse_args(argv)
    from rich.console import Console

    from hil.recording import open_recording
    from hil.views.comparison import compare
    from hil.views.comparison_table import MAX_WIDTH, render, signal_name
    from hil.views.comparison_windows import Event

    event = None if options.align is None else Event[EVENTS[options.align]]
    found = compare(open_recording(options.first), open_recording(options.second), event)
    console = Console(highlight=False, markup=False)
    console.print(render(found), width=min(console.width, MAX_WIDTH))
    exceeding = found.exceeding(dict(options.tolerance))
    for row in exceeding:
        figure = f"{row.largest:.6g} {row.unit} at {row.at_s:.3f} s"
        missing = row.only_first + row.only_second
        if missing:
            figure = f"only one run has a value in {missing} of {found.samples} periods"
        sys.stdout.write(f"exceeded   {row.axis} {signal_name(row)}: {figure}\n")
    return 1 if exceeding else 0
