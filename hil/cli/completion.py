"""``hil completion``: print a script that completes commands, options and files in a shell.

The script is made from the argument parsers, so that it always fits the installed version.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from hil.cli.completion_scripts import SCRIPTS, Argument, Command, Program, Takes
from hil.host.command_parser import CommandParser

FILE_METAVARS = ("FILE", "DIR", "CSV", "PLANT")
"""Endings of the names of values that are files."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil completion``."""
    command = CommandParser(
        prog="hil completion",
        description="Print a script that completes the commands, options and files of hil and firmware-sim.",
        epilog="bash: `source <(hil completion bash)` in ~/.bashrc. zsh: `hil completion zsh > _hil` in a "
        "folder of $fpath. fish: `hil completion fish > ~/.config/fish/completions/hil.fish`.",
    )
    command.add_argument("shell", choices=SCRIPTS, help="the shell that the script is for")
    return command


def main(argv: list[str]) -> int:
    """Run ``hil completion`` with ``argv``; return its exit status."""
    shell = parser().parse_args(argv).shell
    sys.stdout.write(SCRIPTS[shell](programs()))
    return 0


def programs() -> list[Program]:
    """Return the commands and arguments of ``hil`` and ``firmware-sim``."""
    from firmware_sim import cli as firmware_cli
    from hil.cli import command_module, command_names, summary_of

    commands = []
    for name in command_names():
        make_parser = getattr(command_module(name), "parser", None)
        arguments = arguments_of(make_parser()) if make_parser else []
        commands.append(Command(name, summary_of(name), tuple(arguments)))
    boards = Command("", "", tuple(arguments_of(firmware_cli.parser())))
    return [Program("hil", tuple(commands)), Program("firmware-sim", (boards,))]


def arguments_of(command: argparse.ArgumentParser) -> list[Argument]:
    """Return the options and positional arguments of a command."""
    return [
        Argument(
            flags=tuple(action.option_strings),
            summary=re.split(r";|: | \(", action.help or "")[0],
            takes=_takes(action),
            choices=tuple(map(str, action.choices or ())),
            is_repeated=isinstance(action, argparse._AppendAction) or action.nargs in ("*", "+"),
        )
        for action in command._actions
        if action.help != argparse.SUPPRESS
    ]


def _takes(action: argparse.Action) -> Takes:
    if action.nargs == 0:
        return Takes.NOTHING
    if action.choices:
        return Takes.CHOICE
    metavar = str(action.metavar or "")
    return Takes.FILE if action.type is Path or metavar.endswith(FILE_METAVARS) else Takes.TEXT
