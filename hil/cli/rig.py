"""``hil rig``: the example rig file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hil.core.errors import DocumentError
from hil.host.text_file import read_text
from hil.shells.run_setup import RIG_NAME, SHIPPED, load_setup


def main(argv: list[str]) -> int:
    """Show, copy or check a rig file."""
    parser = argparse.ArgumentParser(prog="hil rig", description="Show, copy or check a rig file.")
    action = parser.add_mutually_exclusive_group()
    action.add_argument(
        "--init",
        metavar="FILE",
        nargs="?",
        const=RIG_NAME,
        help="write the commented example to FILE (rig.toml)",
    )
    action.add_argument("--check", metavar="FILE", type=Path, help="read FILE and all that it names")
    options = parser.parse_args(argv)
    if options.check:
        setup = load_setup(options.check, {}, {})
        sys.stdout.write(f"{options.check}: good; axes {', '.join(setup.rig.axes)}\n")
        return 0
    text = read_text(SHIPPED / RIG_NAME)
    if not options.init:
        sys.stdout.write(text)
        return 0
    try:
        with Path(options.init).open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise DocumentError(f"{options.init}: exists already; move it away first") from None
    except OSError as error:
        raise DocumentError(f"{options.init}: cannot be written: {error.strerror}") from None
    sys.stdout.write(f"{options.init} written; try: hil run --rig {options.init}\n")
    return 0
