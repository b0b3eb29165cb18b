"""``hil doctor``: check this machine and print what to improve."""

from __future__ import annotations

import json
import sys
import textwrap
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from hil.core.errors import DocumentError
from hil.host.command_parser import CommandParser
from hil.host.doctor import Check, CheckVerdict, doctor
from hil.shells.preflight import preflight

COMMANDS = ("sudo ", "echo ", "ls ")
"""Beginnings of commands in an advice."""
_STYLES = {
    CheckVerdict.GOOD: "green",
    CheckVerdict.FAIR: "yellow",
    CheckVerdict.MISSING: "bold red",
}


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil doctor``."""
    command = CommandParser(
        prog="hil doctor",
        description="Check what this machine offers a control loop, and say what to do about the rest. If "
        "`hil vcan` needs user-mode Linux here, it is started once, which takes about 3 s. The exit status "
        "is 1 if something is missing without which the simulated rig cannot run. With --rig: check whether "
        "this rig can be operated from here: its files, its protection, its bus and the rights that a real "
        "arm demands; nothing is opened or sent, and the status is 1 if something is missing that it needs.",
    )
    command.add_argument("--rig", type=Path, metavar="FILE", help="check this rig file before operation")
    command.add_argument("--bus", metavar="BUS", help="with --rig: bus instead of the rig file's")
    command.add_argument("--json", action="store_true", help="print a list of objects, for programs")
    return command


def main(argv: list[str]) -> int:
    """Print the findings. Returns 1 if something is missing that the rig needs, else 0."""
    options = parser().parse_args(argv)
    if options.bus and not options.rig:
        raise DocumentError("--bus belongs to --rig: name the rig file that is to be operated on it")
    checks = preflight(options.rig, options.bus) if options.rig else doctor(_show)
    if options.json:
        sys.stdout.write(json.dumps([check._asdict() for check in checks], indent=2) + "\n")
    else:
        print_checks(checks)
    return int(any(check.verdict is CheckVerdict.MISSING for check in checks))


def _show(activity: str) -> AbstractContextManager[object]:
    """Show a moving indicator on a terminal, on the error stream so that output can be piped."""
    if not sys.stderr.isatty():
        return nullcontext()
    from rich.console import Console

    return Console(stderr=True).status(activity)


def print_checks(checks: Sequence[Check]) -> None:
    """Print a table of the findings and, below it, the advice."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, show_header=False, pad_edge=False)
    for check in checks:
        verdict = Text(check.verdict, style=_STYLES[check.verdict], no_wrap=True)
        table.add_row(Text(check.name, no_wrap=True), verdict, Text(check.found))
    console = Console(highlight=False)
    console.print(table)
    for check in checks:
        if check.advice:  # outside the table, so that a command to copy stays on one line
            console.print(Text(f"\n{check.name}:", style=_STYLES[check.verdict]))
            for line in advice_lines(check.advice, console.width):
                console.print(Text(line), soft_wrap=True)


def advice_lines(advice: str, width: int) -> list[str]:
    """Return the lines of an advice. Prose is filled to ``width``; a command to copy stays on its line."""
    lines = []
    for line in advice.splitlines():
        if any(f" {command}" in f" {line}" for command in COMMANDS):
            lines.append(f"  {line}")
        else:
            lines += textwrap.wrap(
                line, width, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False
            )
    return lines
