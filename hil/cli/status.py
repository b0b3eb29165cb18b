"""``hil status``: what the running daemon does, once or again and again."""

from __future__ import annotations

import argparse
import shutil
import sys
import textwrap
from collections.abc import Iterable

import msgspec

from hil.cli.operate import add_socket_option
from hil.core.errors import OperationError
from hil.host.command_parser import CommandParser, duration
from hil.operation.client import Client, connect
from hil.operation.protocol import LogLine, Status
from hil.views.log_lines import log_line

DESCRIPTION = """\
Show the state of the running daemon: positions, setpoints, valve voltages, timing, and a fault. Exit status:
0, or 1 if the daemon is in state fault or no daemon runs."""
EPILOG = """\
A period is missed if the loop was so late that it skipped the period or sent no SYNC in it. A frame is
rejected by a check, such as of its CRC or its age. A sample is lost if the counter of the ADC board shows
that it was sent and it did not arrive. A value is unknown before the first sample."""
UP_AND_CLEAR = "\x1b[{lines}F\x1b[J"
"""Terminal sequence that goes up by some lines and erases what is below."""

INDENT = 10
"""Number of columns before the text of a line."""
OLD_S = 0.1
"""Age of the last good sample from which on the status says it."""
MIN_INTERVAL_S, MAX_INTERVAL_S = 0.05, 60.0
"""Limits of the time between two looks, those of the protocol."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil status``."""
    command = CommandParser(prog="hil status", description=DESCRIPTION, epilog=EPILOG)
    command.add_argument("--watch", action="store_true", help="show it again and again, with the log")
    command.add_argument(
        "--interval",
        type=_interval,
        default=0.2,
        metavar="TIME",
        help="time between two looks of --watch, 0.05s to 60s (default 0.2s)",
    )
    command.add_argument("--json", action="store_true", help="print a line of JSON for each look")
    add_socket_option(command)
    return command


def _interval(text: str) -> float:
    value = duration(text)
    if not MIN_INTERVAL_S <= value <= MAX_INTERVAL_S:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not between {MIN_INTERVAL_S:g}s and {MAX_INTERVAL_S:g}s"
        )
    return value


def main(argv: list[str]) -> int:
    """Run ``hil status`` with ``argv``; return its exit status."""
    options = parser().parse_args(argv)
    try:
        with connect(options.socket) as client:
            looks = client.watch(options.interval) if options.watch else _one(client)
            show = show_json if options.json else show_live if options.watch else show_text
            status = show(looks)
    except OperationError as error:
        sys.stderr.write(f"hil status: {error}\n")
        return 1
    return 1 if status is None or status.state == "fault" else 0


def _one(client: Client) -> Iterable[Status]:
    yield client.status()


def show_json(looks: Iterable[Status]) -> Status | None:
    """Print a line of JSON for each status. Return the last status."""
    status = None
    for status in looks:
        sys.stdout.write(msgspec.json.encode(status).decode() + "\n")
        sys.stdout.flush()
    return status


def show_text(looks: Iterable[Status]) -> Status | None:
    """Print each status. Return the last one."""
    status = None
    for status in looks:
        sys.stdout.write("\n".join(status_lines(status)) + "\n")
    return status


def show_live(looks: Iterable[Status]) -> Status | None:
    """Print log entries as they come, and below them the status, which is overwritten on a terminal."""
    status, shown = None, 0
    is_terminal = sys.stdout.isatty()
    for status in looks:
        if is_terminal and shown:
            sys.stdout.write(UP_AND_CLEAR.format(lines=shown))
        sys.stdout.write("".join(map(_log_text, status.log)))
        lines = status_lines(status)
        if is_terminal:  # the cursor goes up by rows of the terminal, of which a long line takes several
            lines = _wrapped(lines, shutil.get_terminal_size().columns)
        shown = len(lines)
        sys.stdout.write("\n".join(lines) + "\n")
        sys.stdout.flush()
    return status


def _wrapped(lines: list[str], columns: int) -> list[str]:
    """Return the lines in rows of at most ``columns`` characters, the further ones indented."""
    indent = " " * min(INDENT, columns // 2)
    return [
        row
        for line in lines
        for row in textwrap.wrap(line, columns, subsequent_indent=indent, break_on_hyphens=False)
    ]


def _log_text(line: LogLine) -> str:
    return log_line(line.time_ns * 1e-9, line.severity, line.source, line.text, is_journal=False)


def status_lines(status: Status) -> list[str]:
    """Return the status in lines that fit into 80 columns, except for long texts of the daemon."""
    bus = "simulated boards" if status.is_simulated else status.bus
    lines = [
        f"{status.state:8}  {bus}, period {status.period} of {status.period_s * 1e3:g} ms",
        f"{'timing':8}  late up to {status.max_lateness_ms:.2f} ms in the last 0.1 s, up to "
        f"{status.max_lateness_since_start_ms:.2f} ms since the start",
        f"{'counts':8}  since the start: {status.missed_periods} periods missed, {status.rejected_frames} "
        f"frames rejected, {status.lost_samples} samples lost",
    ]
    for axis in status.axes:
        command = "unknown" if axis.command_v is None else f"{axis.command_v:.2f} V"
        lines.append(
            f"  {axis.name:12} {_signed(axis.position)} {axis.unit:3}  setpoint {_signed(axis.setpoint)} "
            f"{axis.unit:3}  valve {command:>7}"
        )
    if status.sample_age_s is not None and status.sample_age_s > OLD_S:
        age = f"the last good one is {status.sample_age_s:.1f} s old"
        lines.append(f"{'samples':8}  {age}: positions are those of then")
    lines.append(f"{'record':8}  {status.recording or 'nothing is recorded'}")
    if status.calibrated_axis is not None:
        text = f"limits of {status.calibrated_axis} are wide; it can be jogged, and nothing starts"
        lines.append(f"{'mode':8}  calibration: {text}")
    if status.overridden_checks:
        lines.append(
            f"{'override':8}  armed although these checks fail: {', '.join(status.overridden_checks)}"
        )
    if status.state == "offline":
        lines.append(f"{'boards':8}  {status.readiness}")
    if status.fault:
        lines += [f"{'fault':8}  {status.fault}", f"{'':8}  remove the cause, then `hil reset`"]
    return lines


def _signed(value: float | None) -> str:
    """Return the number with its sign, or ``unknown`` before the first sample."""
    return f"{'unknown':>8}" if value is None else f"{value:+8.4f}"
