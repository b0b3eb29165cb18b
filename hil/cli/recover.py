"""``hil recover``: save what is whole in a recording that was cut off or damaged, as a new file."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hil.cli.quantities import size_text
from hil.core.errors import HilError
from hil.host.command_parser import CommandParser

if TYPE_CHECKING:
    from hil.recording.recover import LostPart, Recovery

WHOLE, LOST, UNUSABLE = 0, 1, 2
MAX_LISTED = 20
"""Number of lost parts that are listed one by one."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil recover``."""
    command = CommandParser(
        prog="hil recover",
        description="Save what is whole in a recording that was cut off, by a crash for example, or damaged: "
        "write it to a new file with an index, and report what is lost. The file itself is not changed. Exit "
        "status: 0 if all of its data were whole, 1 if something is lost, 2 if nothing is usable.",
    )
    command.add_argument("recording", type=Path, metavar="FILE", help="recording that was cut off or damaged")
    command.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="new file (default <name>-recovered.mcap)"
    )
    return command


def main(argv: list[str]) -> int:
    """Run ``hil recover`` with ``argv``; return its exit status."""
    options: argparse.Namespace = parser().parse_args(argv)
    source: Path = options.recording
    output: Path = options.output or source.with_name(f"{source.stem}-recovered.mcap")
    from hil.recording.recover import recover

    try:
        result = recover(source, output)
    except HilError as error:
        sys.stderr.write(f"hil recover: {error}\n")
        return UNUSABLE
    sys.stdout.write(_report(result, source))
    return LOST if result.lost else WHOLE


def _report(result: Recovery, source: Path) -> str:
    start_ns, end_ns = result.span_ns
    lines = [
        f"saved      {result.path}: {result.messages} messages, {(end_ns - start_ns) * 1e-9:.3f} s",
        *(_lost_text(part, result) for part in result.lost[:MAX_LISTED]),
    ]
    if len(result.lost) > MAX_LISTED:
        lines.append(f"lost       {len(result.lost) - MAX_LISTED} more parts")
    if len(result.lost) > 1:
        size = sum(part.size for part in result.lost)
        known = sum(part.messages or 0 for part in result.lost)
        more = " or more" if any(part.messages is None for part in result.lost) else ""
        lines.append(f"in all     {size_text(size)} and {known}{more} messages lost")
    if not result.lost and result.repaired:
        lines.append("lost       nothing: every message, attachment and metadata record is whole")
    elif not result.lost:
        lines.append("lost       nothing: all data in the file are whole")
    lines += [f"repaired   {what}" for what in result.repaired]
    if not result.was_complete:
        lines.append(
            "note       the recording was not ended: its end is missing. After a crash that is at most 0.8 "
            "s, which the recorder had not written yet; of a file that was cut off it may be more"
        )
    if result.rebuilt_channels:
        lines.append("note       the descriptions of the channels were lost; they are those of the rig file")
    if result.restored_metadata:
        lines.append(
            "note       the metadata of the recording were lost; clock and bus are those of its messages"
        )
    lines.append(f"next       hil replay {shlex.quote(str(result.path))}")
    return "\n".join(lines) + "\n"


def _lost_text(part: LostPart, result: Recovery) -> str:
    if part.size == 0:
        return f"lost       {part.reason}"
    if part.messages is None:
        messages = "an unknown number of messages"
    else:
        messages = f"{part.messages} message{'s' * (part.messages != 1)}"
    return (
        f"lost       {part.size} bytes from byte {part.start}, {messages}{_when(part, result)}: {part.reason}"
    )


def _when(part: LostPart, result: Recovery) -> str:
    if part.messages == 0:
        return ""
    start_ns = result.span_ns[0]
    at_s = [
        "the begin" if part.from_ns is None else f"{(part.from_ns - start_ns) * 1e-9:.3f} s",
        "the end" if part.to_ns is None else f"{(part.to_ns - start_ns) * 1e-9:.3f} s",
    ]
    duration = "" if part.duration_ms is None else f", {part.duration_ms:.0f} ms"
    return f", between {at_s[0]} and {at_s[1]}{duration}"
