"""``hil live``: play a recording on a page in the browser."""

from __future__ import annotations

import sys
from pathlib import Path

from hil.host.command_parser import CommandParser
from hil.live.address import LOOPBACK, open_address

DESCRIPTION = """\
Play a recording on a page in the browser, with a time slider and at any speed. The page is the one that
`hil run --live` shows of a run. Ctrl-C ends it."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil live``."""
    command = CommandParser(prog="hil live", description=DESCRIPTION)
    command.add_argument("recording", type=Path, metavar="FILE", help="recording to play")
    add_address_options(command)
    return command


def add_address_options(command: CommandParser) -> None:
    """Add ``--port`` and ``--host``."""
    command.add_argument("--port", type=int, default=0, metavar="N", help="port of the page (default: a free one)")
    command.add_argument(
        "--host",
        default=LOOPBACK,
        metavar="ADDRESS",
        help=f"address to listen on (default {LOOPBACK}: this machine alone)",
    )


def warn_of_host(host: str) -> None:
    """Warn if the page can be opened from other machines."""
    if host != LOOPBACK:
        sys.stderr.write(
            f"hil: the page is served on {host}, without encryption: whoever can read the network can read "
            "the token, and then sees what the page shows and does what it may\n"
        )


def main(argv: list[str]) -> int:
    """Run ``hil live`` with ``argv``; return its exit status. Raises HilError for wrong arguments or files."""
    from hil.live.feed import start_server
    from hil.recording import open_recording

    options = parser().parse_args(argv)
    open_recording(options.recording)
    address = open_address(options.host, options.port)
    warn_of_host(options.host)
    process = start_server(address, None, None, str(options.recording))
    address.listener.close()
    sys.stdout.write(f"{address.url}\nCtrl-C ends the page.\n")
    sys.stdout.flush()
    try:
        return process.wait()
    finally:
        process.terminate()
