"""``hil export``: write the signals or the frames of a recording to a file of another format."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hil.core.suggestions import did_you_mean
from hil.host.command_parser import CommandParser, seconds

if TYPE_CHECKING:
    from hil.conversion.export import Format

EPILOG = """\
columns of the signals:
  state              0 offline, 1 ready, 2 armed, 3 running, 4 fault
  running            1 while the controllers move the valves: state 3
  fresh              0: no good sample in this period, the signals are older
  AXIS.output_v      output of the controller before the limits, relative to
                     the valve's centre voltage
  AXIS.command_v     valve voltage after the limits, as it was commanded
  AXIS.phase         phase of `hil collect`: 0 none, 1 approach, 2 settle,
                     3 excited, 4 recover, 5 return, 6 done

The names of states and phases are also in the metadata: of the fields in
parquet (names), in the struct names in mat (names.state.running is 3), and in
the comments of the channels in mf4.
"""

SIGNAL_FORMATS = ("csv", "parquet", "mat", "mf4")
FRAME_FORMATS = ("candump", "asc", "blf", "mf4-bus")
MIN_RESAMPLE_S = 1e-6
"""Shortest interval of resampling, in seconds. A shorter one is a mistake, and would fill the disk."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil export``."""
    command = CommandParser(
        prog="hil export",
        usage="hil export FILE --to FORMAT [-o FILE] [--axis NAME …] [--from S] [--to S]\n"
        "                  [--resample S] [--force]",
        description="Write the signals of a recording (csv, parquet, mat, mf4) or its CAN frames (candump, "
        "asc, blf, and mf4-bus, an MF4 bus log) to a file. Signals have one row for each period, at the "
        "recorded instants, and their units in names or metadata. The file appears when it is whole, and no "
        "existing file is overwritten.\n\n"
        "parquet needs pyarrow: pip install 'pneumatic-hil[parquet]'. mf4 and mf4-bus need asammdf: "
        "pip install 'pneumatic-hil[mf4]'.",
        epilog=EPILOG,
    )
    command.add_argument("recording", type=Path, metavar="FILE", help="recording of `hil run`")
    command.add_argument(
        "--to",
        required=True,
        action="append",
        type=_format_or_time,
        metavar="FORMAT or S",
        help=f"format ({', '.join(SIGNAL_FORMATS)}; {', '.join(FRAME_FORMATS)}). A number is the end of the "
        "exported time, in seconds from the first period",
    )
    command.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="file to write (default: beside the recording)"
    )
    command.add_argument(
        "--axis", action="append", default=[], metavar="NAME", help="export this axis; may be repeated"
    )
    command.add_argument(
        "--from", dest="from_s", type=seconds, metavar="S", help="begin of the exported time, likewise"
    )
    command.add_argument(
        "--resample",
        type=seconds,
        metavar="S",
        help="write a row every S seconds with the values of the last period, without a filter",
    )
    command.add_argument("--force", action="store_true", help="overwrite the file if it exists")
    return command


def main(argv: list[str]) -> int:
    """Export one recording; return the exit status. Raises HilError for what the user can correct."""
    command = parser()
    options = command.parse_args(argv)
    name, to_s = _split_to(command, options.to)
    _check(command, options, name, to_s)
    from hil.cli.cut_off import warn_if_cut_off
    from hil.cli.file_progress import FileProgress
    from hil.conversion.export import Format, export
    from hil.conversion.output_file import check_output
    from hil.conversion.signals import Selection
    from hil.recording import open_recording

    file_format = Format(name)
    selection = Selection(tuple(options.axis), options.from_s, to_s, options.resample)
    path = options.output or default_output(options.recording, file_format)
    if path == options.recording:
        open_recording(path)  # an input that is no recording is reported before its name as an output
    check_output(path, force=options.force, source=options.recording)
    recording = open_recording(options.recording)
    warn_if_cut_off(recording)
    with FileProgress("export", recording.duration_s) as progress:
        written = export(recording, path, file_format, selection, force=options.force, watch=progress)
    sys.stdout.write(f"{path}: {written.length} {written.unit}\n")
    return 0


def default_output(recording: Path, file_format: Format) -> Path:
    """Return the file beside the recording that an export writes by default."""
    if file_format == "mf4-bus":
        return recording.with_name(f"{recording.stem}-bus{file_format.suffix}")
    return recording.with_suffix(file_format.suffix)


def _format_or_time(text: str) -> str | float:
    names = (*SIGNAL_FORMATS, *FRAME_FORMATS)
    if text in names:
        return text
    try:
        return seconds(text)
    except argparse.ArgumentTypeError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is neither a format ({', '.join(names)}) nor a time in seconds"
            f"{did_you_mean(text, names)}"
        ) from None


def _split_to(command: CommandParser, values: list[str | float]) -> tuple[str, float | None]:
    """Return the format and the end among the values of ``--to``."""
    names = [value for value in values if isinstance(value, str)]
    times_s = [value for value in values if isinstance(value, float)]
    if len(names) != 1:
        command.error(
            "--to names no format; for example: --to csv"
            if not names
            else f"--to names {len(names)} formats ({', '.join(names)}); export one at a time"
        )
    if len(times_s) > 1:
        command.error(f"--to gives {len(times_s)} times; give one end")
    return names[0], times_s[0] if times_s else None


def _check(command: CommandParser, options: argparse.Namespace, name: str, to_s: float | None) -> None:
    """End the program with an error for options that exclude each other."""
    if name in FRAME_FORMATS:
        for option, given in (("--axis", options.axis), ("--resample", options.resample)):
            if given:
                command.error(f"{option} is for signals, but {name} takes frames; leave it out")
    if options.resample is not None and options.resample < MIN_RESAMPLE_S:
        command.error(f"--resample {options.resample:g} s is under the limit {MIN_RESAMPLE_S:g} s")
    if options.from_s is not None and to_s is not None and options.from_s >= to_s:
        command.error(f"--from {options.from_s:g} s is not before --to {to_s:g} s")
