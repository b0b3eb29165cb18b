"""``hil replay``: replay recordings, and compare the core's answers with the recorded ones."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hil.core.errors import HilError, ReplayMismatchError
from hil.host.command_parser import CommandParser

DIFFERENT, REFUSED = 1, 2


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil replay``."""
    command = CommandParser(
        prog="hil replay",
        description="Give the recorded frames and deadlines of a run to the gateway core again, and compare "
        "all that it answers with the recording: frames byte by byte, log entries, and the signals of every "
        "period. Exit status: 0 if all is identical, 1 if a recording differs, 2 if one cannot be replayed.",
    )
    command.add_argument("recording", type=Path, nargs="+", metavar="FILE", help="recording of `hil run`")
    command.add_argument("--verify", action="store_true", help=argparse.SUPPRESS)  # was required before 0.2
    return command


def main(argv: list[str]) -> int:
    """Run ``hil replay`` with ``argv``; return its exit status."""
    options = parser().parse_args(argv)
    return max(_verify(path) for path in options.recording)


def _verify(path: Path) -> int:
    from hil.recording.reader import Recording
    from hil.shells.replay import verify

    try:
        report = verify(Recording(path))
    except ReplayMismatchError as error:
        sys.stderr.write(f"different  {error}\n")
        return DIFFERENT
    except HilError as error:
        sys.stderr.write(f"refused    {error}\n")
        return REFUSED
    cut_off = "" if report.complete else "; the recording was cut off, and was verified up to its end"
    sys.stdout.write(
        f"identical  {path}: {report.frames_compared} frames, {report.log_entries_compared} log entries and "
        f"{report.periods_compared} periods of signals from {report.calls} calls, "
        f"{report.duration_s:.3f} s{cut_off}\n"
    )
    return 0
