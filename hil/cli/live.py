"""``hil live``: play a recording on a page in the browser."""

from __future__ import annotations

import sys
from pathlib import Path

from hil.host.command_parser import CommandParser
from hil.live.address import add_address_options, open_address

DESCRIPTION = """\
Play a recording on a page in the browser, with a time slider and at any speed. The page is the one that
`hil run --live` shows of a run. Ctrl-C ends it."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil live``."""
    command = CommandParser(prog="hil live", description=DESCRIPTION)
    command.add_argument("recording", type=Path, metavar="FILE", help="recording to play")
    add_address_options(command)
    return command


def main(argv: list[str]) -> int:
    """Run ``hil live`` with ``argv``; return its exit status. Raises HilError."""
    from hil.live.feed import start_server
    from hil.recording import open_recording

    options = parser().parse_args(argv)
    open_recording(options.recording)
    with open_address(options.host, options.port) as address:
        process = start_server(address, None, None, str(options.recording))
    sys.stdout.write(f"{address.url}\nCtrl-C ends the page.\n")
    sys.stdout.flush()
    try:
        return process.wait()
    finally:
        process.terminate()
