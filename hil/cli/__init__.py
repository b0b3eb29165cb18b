"""The command line ``hil``. Each command is a module with ``main(argv) -> exit status``.

0: done. 1: it ran and something is wrong (a fault, a mismatch). 2: wrong use or input.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import TextIO

from hil import __version__
from hil.core.errors import HilError

COMMANDS = {
    "run": ("hil.cli.run", "run the controllers against the rig, and record"),
    "replay": ("hil.cli.replay", "give a recording's calls to the core again, and compare what it sends"),
    "rig": ("hil.cli.rig", "show or copy the example rig file"),
    "vcan": ("hil.cli.vcan", "run a command where a virtual CAN interface exists"),
    "doctor": ("hil.cli.doctor", "check what this machine offers a control loop, and what to improve"),
}
PLUGINS = "hil.commands"
"""Entry points of other packages: ``hil design`` is one."""


def main(argv: list[str] | None = None) -> int:
    """Run ``hil`` with ``argv``; returns the exit status."""
    arguments = sys.argv[1:] if argv is None else argv
    sys.stdout = sys.stdout or _nowhere()  # closed by whoever called: `>&-`
    sys.stderr = sys.stderr or _nowhere()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a locale without … or µ
    try:
        status = _main(arguments)
        sys.stdout.flush()
        return status
    except HilError as error:
        sys.stderr.write(f"hil {arguments[0]}: {error}\n")
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        sys.stdout = _nowhere()  # the interpreter shall not try again at its end
        return 141
    except OSError as error:
        sys.stdout = _nowhere()
        sys.stderr.write(f"hil: {error.filename or 'output'}: {error.strerror}\n")
        return 1


def _main(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        sys.stdout.write(_usage())
        return 0 if arguments else 2
    if arguments[0] == "--version":
        sys.stdout.write(f"hil {__version__}\n")
        return 0
    command = _find(arguments[0])
    if command is None:
        sys.stderr.write(f"hil: no command {arguments[0]!r}\n\n{_usage()}")
        return 2
    return command(arguments[1:])


def _nowhere() -> TextIO:
    return Path(os.devnull).open("w")


def _find(name: str) -> Callable[[list[str]], int] | None:
    if name in COMMANDS:
        return import_module(COMMANDS[name][0]).main  # type: ignore[no-any-return]
    for entry in entry_points(group=PLUGINS, name=name):
        return entry.load()  # type: ignore[no-any-return]
    return None


def _usage() -> str:
    lines = ["usage: hil COMMAND [OPTION…]; `hil COMMAND --help` says more", ""]
    lines += [f"  {name:8} {text}" for name, (_, text) in COMMANDS.items()]
    lines += [
        f"  {entry.name:8} `hil {entry.name} --help` (package {entry.module.partition('.')[0]})"
        for entry in entry_points(group=PLUGINS)
    ]
    return "\n".join(lines) + "\n"
