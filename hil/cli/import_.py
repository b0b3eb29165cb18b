"""``hil import``: make a recording of a bus log."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hil.host.command_parser import CommandParser

if TYPE_CHECKING:
    from hil.conversion.log_import import Document, Imported


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil import``."""
    command = CommandParser(
        prog="hil import",
        description="Make a recording of a bus log: candump -L, Vector ASC, Vector BLF or MF4 bus logging. "
        "The recording has the frames, and the signals of the axes as the DBC file and the rig file give "
        "them. Setpoints are unknown, and `hil replay FILE` cannot verify it, since a log has no call of the "
        "gateway. MF4 needs asammdf: pip install 'pneumatic-hil[mf4]'.",
    )
    command.add_argument("log", type=Path, metavar="LOG", help="bus log; its content tells the format")
    command.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="recording (default: beside the log, .mcap)"
    )
    command.add_argument("--rig", type=Path, metavar="FILE", help="rig file (default: the shipped one)")
    command.add_argument("--dbc", type=Path, metavar="FILE", help="DBC file (default: the shipped arm.dbc)")
    command.add_argument(
        "--channel", metavar="NAME", help="bus to import from a log of several buses, such as can0"
    )
    command.add_argument("--force", action="store_true", help="overwrite the recording if it exists")
    return command


def main(argv: list[str]) -> int:
    """Import one log; return the exit status. Raises HilError for what the user can correct."""
    command = parser()
    options = command.parse_args(argv)
    path = options.output or options.log.with_suffix(".mcap")
    if path.suffix != ".mcap":
        command.error(f"-o {path}: a recording's name ends in .mcap, such as {path}.mcap")
    from hil.cli.file_progress import FileProgress
    from hil.conversion.log_import import import_log
    from hil.conversion.output_file import check_output

    check_output(path, force=options.force, source=options.log if options.log.exists() else None)
    with FileProgress("import", 1.0) as progress:
        imported = import_log(
            options.log,
            path,
            *_documents(options),
            channel=options.channel,
            force=options.force,
            watch=progress,
        )
    sys.stdout.write(_report(imported))
    return 0


def _documents(options: argparse.Namespace) -> tuple[Document, Document]:
    """Return rig file and DBC file."""
    from hil.conversion.log_import import Document
    from hil.host.text_file import read_text
    from hil.shells.run_setup import DBC_NAME, PACKAGE, RIG_NAME, SHIPPED

    rig_path = options.rig or SHIPPED / RIG_NAME
    dbc_path = options.dbc or PACKAGE / "core" / "wire" / DBC_NAME
    return (
        Document(read_text(rig_path), str(options.rig or f"shipped {RIG_NAME}")),
        Document(read_text(dbc_path), str(options.dbc or f"shipped {DBC_NAME}")),
    )


def _report(imported: Imported) -> str:
    lines = [
        f"{imported.path}: {imported.received} frames received, {imported.sent} sent, "
        f"{imported.periods} periods"
    ]
    if imported.periods == 0:
        lines.append("no period: the log has neither SYNC nor a sample (TPDO1_ADC), so it has no signals")
    if imported.unreadable:
        lines.append(f"{imported.unreadable} frames were left out: not classic CAN, or corrupt")
    if imported.reordered:
        lines.append(
            f"{imported.reordered} frames were out of order; each got the time of the frame before it"
        )
    return "\n".join(lines) + "\n"
