"""Argument parser of all commands: short errors, the nearest option to a mistyped one, shared options."""

from __future__ import annotations

import argparse
import math
import re
import sys
import textwrap
from collections.abc import Sequence
from typing import Any, NoReturn

from hil.core.suggestions import nearest

_UNITS_S = {"ms": 0.001, "s": 1.0, "min": 60.0, "h": 3600.0}


def number(text: str) -> float:
    """Return a finite number from the text of an argument."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return value


def seconds(text: str) -> float:
    """Return a finite time in seconds from a text such as ``0.2``, ``0.2s``, ``200ms`` or ``5min``."""
    match = re.fullmatch(r"(.*?)\s*(ms|s|min|h)?", text.strip(), re.DOTALL)
    assert match is not None
    try:
        value = number(match[1]) * _UNITS_S[match[2] or "s"]
    except argparse.ArgumentTypeError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a time; write seconds, or a number with the unit ms, s, min or h, such as 0.2s"
        )
    return value


def duration(text: str) -> float:
    """Return a time over 0 in seconds from the text of an argument, as :func:`seconds` does."""
    value = seconds(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} must be more than 0 s")
    return value


def add_controller_option(command: argparse.ArgumentParser) -> None:
    """Add ``--controller AXIS=FILE``, which may be repeated."""
    command.add_argument(
        "--controller",
        action="append",
        default=[],
        metavar="AXIS=FILE",
        help="controller of an axis instead of the rig file's; may be repeated",
    )


def add_override_option(command: argparse.ArgumentParser) -> None:
    """Add ``--override``, with the names of checks before arming. :mod:`hil.core.check_names` checks them."""
    command.add_argument(
        "--override",
        nargs="+",
        action="extend",
        default=[],
        metavar="CHECK",
        help="arm although this check fails: position-AXIS, controller-AXIS, SCHED_FIFO or memory-lock; the "
        "refusal to arm names it",
    )


class CommandParser(argparse.ArgumentParser):
    """An ``argparse.ArgumentParser`` whose errors are one sentence and name the nearest valid option.

    The exit status of an error is 2. The usage is not printed, because it hides the sentence. Paragraphs of
    description and epilog are separated by empty lines; lines that begin with spaces stay as they are.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(formatter_class=_ParagraphFormatter, **settings)
        self._given: list[str] = []
        # By argparse's own pattern, -1s and -1e-3 are options, and "expected one argument" is all it says.
        self._negative_number_matcher = re.compile(r"-(\.?\d|inf|nan)")

    def parse_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> argparse.Namespace:
        """Parse ``args``. An unknown argument ends the program with exit status 2."""
        self._given = list(sys.argv[1:] if args is None else args)
        options, unknown = self.parse_known_args(self._given, namespace)
        if unknown:
            self.error(f"unexpected argument {unknown[0]!r}")
        return options

    def error(self, message: str) -> NoReturn:
        """Print ``message``, or that an option is unknown, and where to find help; exit with status 2."""
        message = re.sub(r"invalid int value: (.*)", r"\1 is not a whole number", message)
        message = self._unknown_option() or message
        sys.stderr.write(f"{self.prog}: {message}\n`{self.prog} --help` lists the arguments.\n")
        raise SystemExit(2)

    def _unknown_option(self) -> str | None:
        """Return what is said of the first unknown option; None if all are known."""
        known = self._option_string_actions
        for argument in self._given:
            option = argument.partition("=")[0]
            if argument == "--":
                return None
            if option.startswith("--") and not any(name.startswith(option) for name in known):
                # Without the dashes, which make short names similar that are not.
                similar = nearest(option.lstrip("-"), [name.lstrip("-") for name in known if len(name) > 2])
                suggestion = "" if similar is None else f"; did you mean --{similar}?"
                return f"unknown option {option}{suggestion}"
        return None


class _ParagraphFormatter(argparse.HelpFormatter):
    """Fills each paragraph to the width of the terminal, and keeps indented lines and hyphenated names."""

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        parts = re.split(r"\n(?=\n| )|(?<=\n)\n", text.strip())
        return "\n".join(
            part
            if not part.strip() or part.startswith(" ")
            else textwrap.fill(part, width, break_on_hyphens=False)
            for part in parts
        )
