"""``hil replay``: verify a recording against the core."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hil.core.errors import HilError, ReplayMismatchError
from hil.recording.reader import Recording
from hil.shells.replay import verify


def main(argv: list[str]) -> int:
    """Replay recordings. 0: all identical; 1: one differs; 2: one is damaged, or no recording."""
    parser = argparse.ArgumentParser(
        prog="hil replay",
        description="Give a recording's frames and deadlines to the core again.",
    )
    parser.add_argument("recording", type=Path, nargs="+", metavar="FILE", help="a recording of hil run")
    parser.add_argument(
        "--verify",
        action="store_true",
        required=True,
        help="compare every outgoing byte, event and signal with the recorded one",
    )
    options = parser.parse_args(argv)
    status = 0
    for path in options.recording:
        try:
            report = verify(Recording(path))
        except ReplayMismatchError as error:
            sys.stderr.write(f"different  {error}\n")
            status = max(status, 1)
            continue
        except HilError as error:
            sys.stderr.write(f"refused    {error}\n")
            status = 2
            continue
        rest = "" if report.complete else "; it was cut off: what it holds was verified"
        sys.stdout.write(
            f"identical  {path}: {report.frames_compared} frames, {report.log_entries_compared} events and "
            f"{report.periods_compared} periods of signals from {report.calls} calls, "
            f"{report.duration_s:.3f} s{rest}\n"
        )
    return status
