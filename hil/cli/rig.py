"""``hil rig``: print, copy or check a rig file, or copy the EDS files of the boards."""

from __future__ import annotations

import sys
from pathlib import Path

from hil.core.errors import DocumentError
from hil.core.own_bus_load import MAX_USUAL_LOAD, own_bus_load
from hil.core.rig import Rig
from hil.host.command_parser import CommandParser
from hil.host.text_file import read_text
from hil.shells.run_setup import RIG_NAME, SHIPPED, load_setup

EDS_NAMES = ("adc.eds", "dac.eds")
"""Electronic data sheets (CiA 306) of the potentiometer board and the valve board."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil rig``."""
    command = CommandParser(
        prog="hil rig",
        description="Print the commented rig file that is shipped. It has every setting of loop, boards and "
        "axes, and every limit.",
    )
    action = command.add_mutually_exclusive_group()
    action.add_argument(
        "--init",
        metavar="FILE",
        nargs="?",
        const=RIG_NAME,
        help=f"write it to FILE instead (default {RIG_NAME}); an existing file is kept",
    )
    action.add_argument(
        "--check", metavar="FILE", type=Path, help="read FILE and all files that it names, and report errors"
    )
    action.add_argument(
        "--eds",
        metavar="FOLDER",
        nargs="?",
        const=".",
        help=f"write {' and '.join(EDS_NAMES)}, which describe the boards to CANopen tools, to FOLDER, "
        "which is created if needed (default: the working directory); existing files are kept",
    )
    return command


def main(argv: list[str]) -> int:
    """Run ``hil rig`` with ``argv``; return its exit status. Raises DocumentError."""
    options = parser().parse_args(argv)
    if options.check:
        return _check(options.check)
    if options.eds is not None:
        folder = Path(options.eds)
        _create(folder)
        paths = [folder / name for name in EDS_NAMES]
        for path in paths:
            _write_new(path, read_text(SHIPPED / path.name), "name another folder")
        sys.stdout.write(f"{' and '.join(map(str, paths))} written; open them with a CANopen tool\n")
        return 0
    text = read_text(SHIPPED / RIG_NAME)
    if options.init:
        _write_new(Path(options.init), text)
        sys.stdout.write(f"{options.init} written; use it with: hil run --rig {options.init}\n")
    else:
        sys.stdout.write(text)
    return 0


def _check(path: Path) -> int:
    """Check a rig file, and the bus load of its own frames if it has a bit rate. Raises DocumentError."""
    rig = load_setup(path, {}, {}).rig
    load_text = "" if rig.bus.bit_rate is None else _bus_load_text(path, rig, rig.bus.bit_rate)
    sys.stdout.write(f"{path}: valid; axes {', '.join(rig.axes)}{load_text}\n")
    return 0


def _bus_load_text(path: Path, rig: Rig, bit_rate: int) -> str:
    """Return the bus load in words; a high load is warned of. Raises DocumentError if it is 100 % or more."""
    load = own_bus_load(rig, bit_rate)
    text = f"the rig's own frames use up to {100.0 * load:.0f} % of {bit_rate} bit/s"
    remedy = "raise bit_rate or loop.period_s"
    if load >= 1.0:
        raise DocumentError(
            f"{path}: bus.bit_rate: {text}, but the limit is below 100 %: samples would be missing; {remedy}"
        )
    if load > MAX_USUAL_LOAD:
        sys.stderr.write(
            f"hil rig: {path}: bus.bit_rate: {text}, more than {100.0 * MAX_USUAL_LOAD:.0f} %: there is "
            f"little room for repeated frames and other nodes; {remedy}\n"
        )
    return f"; {text}"


def _create(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise DocumentError(f"--eds {folder}: is a file, not a folder; name a folder") from None
    except OSError as error:
        raise DocumentError(f"--eds {folder}: cannot be created: {error.strerror}") from None


def _write_new(path: Path, text: str, remedy: str = "name another file") -> None:
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise DocumentError(f"{path}: exists already and is kept; {remedy}") from None
    except OSError as error:
        raise DocumentError(f"{path}: cannot be written: {error.strerror}") from None
