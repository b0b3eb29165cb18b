"""``hil live``: show a daemon, or play a recording, on a page in the browser."""

from __future__ import annotations

import sys
from pathlib import Path

from hil.cli.operate import add_socket_option
from hil.core.errors import DocumentError
from hil.host.command_parser import CommandParser
from hil.live.address import add_address_options, open_address

DESCRIPTION = """\
Show the running daemon, or play a recording, on a page in the browser. A daemon that was started without
--live is shown with 20 samples a second; `hil daemon --live` shows every period. A recording has a time
slider and is played at any speed. Ctrl-C ends the page, not the daemon."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil live``."""
    command = CommandParser(prog="hil live", description=DESCRIPTION)
    command.add_argument(
        "recording", type=Path, nargs="?", metavar="FILE", help="recording to play, instead of a daemon"
    )
    command.add_argument("--operate", action="store_true", help="let the page operate the daemon")
    add_socket_option(command)
    add_address_options(command)
    return command


def main(argv: list[str]) -> int:
    """Run ``hil live`` with ``argv``; return its exit status. Raises HilError."""
    from hil.live.feed import start_server
    from hil.operation.client import connect
    from hil.operation.socket_path import default_path
    from hil.recording import open_recording

    options = parser().parse_args(argv)
    daemon = None if options.recording is not None else str(options.socket or default_path())
    if daemon is None:
        open_recording(options.recording)
        if options.operate:
            raise DocumentError("--operate needs a daemon; a recording can only be played")
    else:
        connect(daemon).close()
    with open_address(options.host, options.port) as address:
        process = start_server(
            address,
            watched_socket=daemon,
            recording=None if daemon else str(options.recording),
            operator_socket=daemon if options.operate else None,
        )
    sys.stdout.write(f"{address.url}\nCtrl-C ends the page.\n")
    sys.stdout.flush()
    try:
        return process.wait()
    finally:
        process.terminate()
