"""``hil report``: write one self-contained HTML page about a recording."""

from __future__ import annotations

import sys
from pathlib import Path

from hil.cli.quantities import size_text
from hil.host.command_parser import CommandParser


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil report``."""
    command = CommandParser(
        prog="hil report",
        description="Write a page about a recording: plots of all signals that zoom together, timing of the "
        "loop, frame rates, figures of steps or of tracking, a verdict against what the controller files "
        "promise, log, configuration and versions. It is one file that refers to nothing outside itself, and "
        "its size is bounded whatever the length of the run.",
    )
    command.add_argument(
        "recording",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="recording of `hil run`; all files of a run in several files, or their folder",
    )
    command.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="page to write (default <name>.html beside FILE)"
    )
    command.add_argument("--force", action="store_true", help="overwrite the page if it exists")
    return command


def main(argv: list[str]) -> int:
    """Run ``hil report`` with ``argv``; return its exit status. Raises HilError."""
    options = parser().parse_args(argv)
    from hil.recording import open_recording
    from hil.views.recording_report import write_report

    given: list[Path] = options.recording
    recording = open_recording(given[0] if len(given) == 1 else given)
    output: Path = options.output or recording.path.with_suffix(".html")
    size = write_report(recording, output, options.force)
    sys.stdout.write(f"report     {output}  ({size_text(size)}; open it in a browser)\n")
    return 0
