"""The command line ``hil``.

Each command is a module with ``main(argv)``, which returns the exit status, and ``parser()``. Exit status 0
means done, 1 that the command ran and something is wrong (a fault, a difference), 2 wrong arguments or files.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import TextIO

from hil import __version__
from hil.core.errors import HilError
from hil.core.suggestions import did_you_mean

COMMANDS = {
    "run": ("hil.cli.run", "run the controllers against the rig, and record the run"),
    "collect": ("hil.cli.collect", "excite one axis and record it, as data for a plant model"),
    "replay": ("hil.cli.replay", "replay recordings, and compare the core's answers with them"),
    "export": ("hil.cli.export", "write the signals or frames of a recording for other tools"),
    "import": ("hil.cli.import_", "make a recording of a bus log: candump, ASC, BLF or MF4"),
    "rig": ("hil.cli.rig", "print, copy or check a rig file"),
    "vcan": ("hil.cli.vcan", "run a command where the CAN interface vcan0 exists"),
    "doctor": ("hil.cli.doctor", "check what this machine offers a control loop, and what to improve"),
    "completion": ("hil.cli.completion", "print a completion script for bash, zsh or fish"),
}
"""Module and summary of each command of this package."""
PLUGINS = "hil.commands"
"""Group of entry points by which other packages add commands, such as ``hil design``."""


def main(argv: list[str] | None = None) -> int:
    """Run ``hil`` with ``argv``; return the exit status."""
    arguments = sys.argv[1:] if argv is None else argv
    sys.stdout = sys.stdout or _discard()  # None if the caller closed it, as `>&-` does
    sys.stderr = sys.stderr or _discard()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # for a locale without … or µ
    try:
        status = _run(arguments)
        sys.stdout.flush()
        return status
    except HilError as error:
        sys.stderr.write(f"hil {arguments[0]}: {error}\n")
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        sys.stdout = _discard()  # so that the interpreter does not flush into the pipe again
        return 141
    except OSError as error:
        sys.stdout = _discard()
        sys.stderr.write(f"hil: {error.filename or 'output'}: {error.strerror}\n")
        return 1


def command_names() -> list[str]:
    """Return the names of all commands, those of other packages last."""
    return [*COMMANDS, *(entry.name for entry in entry_points(group=PLUGINS) if entry.name not in COMMANDS)]


def command_module(name: str) -> ModuleType | None:
    """Import and return the module of a command; None if there is no such command."""
    if name in COMMANDS:
        return import_module(COMMANDS[name][0])
    entry = next(iter(entry_points(group=PLUGINS, name=name)), None)
    return None if entry is None else import_module(entry.module)


def summary_of(name: str) -> str:
    """Return what a command does, in a few words."""
    if name in COMMANDS:
        return COMMANDS[name][1]
    text = getattr(command_module(name), "SUMMARY", None)
    return text if isinstance(text, str) else f"see `hil {name} --help`"


def _run(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        sys.stdout.write(_usage())
        return 0 if arguments else 2
    name, *rest = arguments
    if name == "--version":
        sys.stdout.write(f"hil {__version__}\n")
        return 0
    module = command_module(name)
    if module is None:
        what = "option" if name.startswith("-") else "command"
        hint = did_you_mean(name, [*command_names(), "--help", "--version"])
        sys.stderr.write(f"hil: unknown {what} {name!r}{hint}\n`hil --help` lists the commands.\n")
        return 2
    command: Callable[[list[str]], int] = module.main
    return command(rest)


def _discard() -> TextIO:
    return Path(os.devnull).open("w")


def _usage() -> str:
    names = command_names()
    width = max(map(len, names))
    lines = [
        "usage: hil COMMAND [ARGUMENT…]",
        "       hil --version",
        "",
        "Hardware-in-the-loop gateway for a pneumatic robot arm with three axes.",
        "",
        "commands:",
        *(f"  {name:{width}}  {summary_of(name)}" for name in names),
        "",
        "`hil COMMAND --help` describes a command.",
    ]
    return "\n".join(lines) + "\n"
