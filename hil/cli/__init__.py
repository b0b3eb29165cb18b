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
from typing import Any, TextIO

from hil import __version__
from hil.core.errors import HilError
from hil.core.suggestions import did_you_mean

COMMANDS = {
    "run": ("hil.cli.run", "run the controllers against the rig, and record the run"),
    "collect": ("hil.cli.collect", "excite one axis and record it, as data for a plant model"),
    "campaign": ("hil.cli.campaign", "run many cases with faults in simulated time, and judge each"),
    "replay": ("hil.cli.replay", "replay recordings, and compare the core's answers with them"),
    "export": ("hil.cli.export", "write the signals or frames of a recording for other tools"),
    "import": ("hil.cli.import_", "make a recording of a bus log: candump, ASC, BLF or MF4"),
    "compare": ("hil.cli.compare", "compare two recordings signal by signal, aligned on the same event"),
    "report": ("hil.cli.report", "write an HTML page about a recording: plots and figures"),
    "recover": ("hil.cli.recover", "save what is whole in a recording that was cut off or damaged"),
    "monitor": ("hil.cli.monitor", "watch the bus: boards, samples, positions, load; moves nothing"),
    "calibrate": ("hil.cli.calibrate", "measure an axis' potentiometer or valve for the rig file"),
    "live": ("hil.cli.live", "show a daemon, or play a recording, on a page in the browser"),
    "rig": ("hil.cli.rig", "print, copy or check a rig file"),
    "vcan": ("hil.cli.vcan", "run a command where the CAN interface vcan0 exists"),
    "doctor": ("hil.cli.doctor", "check what this machine offers a control loop, and what to improve"),
    "completion": ("hil.cli.completion", "print a completion script for bash, zsh or fish"),
    "daemon": ("hil.cli.daemon", "run until stopped, and take the requests below"),
    "status": ("hil.cli.status", "show what the daemon does, once or live"),
    "arm": ("hil.cli.operate:ARM", "allow motion: ready -> armed"),
    "disarm": ("hil.cli.operate:DISARM", "forbid motion: armed -> ready"),
    "start": ("hil.cli.operate:START", "begin to control: armed -> running"),
    "stop": ("hil.cli.operate:STOP", "stop the controllers, centre the valves: running -> armed"),
    "reset": ("hil.cli.operate:RESET", "leave state fault, after its cause is removed"),
    "setpoint": ("hil.cli.operate:SETPOINT", "change the setpoints of axes"),
    "controller": ("hil.cli.operate:CONTROLLER", "change the controllers of axes"),
    "jog": ("hil.cli.operate:JOG", "move one axis by hand for a short time"),
    "event": ("hil.cli.operate:EVENT", "let something happen to the simulated arm"),
    "record": ("hil.cli.operate:RECORD", "begin another recording, or go on without one"),
    "shutdown": ("hil.cli.operate:SHUTDOWN", "end the daemon with centred valves"),
}
"""Module, or module and name of an object in it, and summary of each command of this package.

A module or object has ``main`` and ``parser``.
"""
OPERATION = (
    *(
        "daemon",
        "status",
        "arm",
        "disarm",
        "start",
        "stop",
        "reset",
        "setpoint",
        "controller",
        "jog",
        "event",
    ),
    *("record", "shutdown"),
)
"""Commands that start or operate a daemon. The help lists them in a group of their own."""
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


def command_module(name: str) -> Any:
    """Import and return the module or object of a command; None if there is no such command."""
    if name in COMMANDS:
        module, _, attribute = COMMANDS[name][0].partition(":")
        imported = import_module(module)
        return getattr(imported, attribute) if attribute else imported
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
        *(f"  {name:{width}}  {summary_of(name)}" for name in names if name not in OPERATION),
        "",
        "a daemon, and the requests that it takes:",
        *(f"  {name:{width}}  {summary_of(name)}" for name in names if name in OPERATION),
        "",
        "`hil COMMAND --help` describes a command.",
    ]
    return "\n".join(lines) + "\n"
