"""``hil live``: show a daemon or a recording on a page in the browser, or serve a daemon to Foxglove."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from hil.cli.operate import add_socket_option
from hil.core.errors import DocumentError, RecordingError
from hil.host.command_parser import CommandParser, seconds
from hil.live.address import add_address_options, open_address

DESCRIPTION = """\
Show the running daemon, or play a recording, on a page in the browser. The page has every period of the last
ten minutes, also of the time before it was opened. A recording has a time slider and is played at any speed.
With --foxglove, serve the daemon to Foxglove instead of the page. After a restart of the daemon, the same
address shows its next run. Ctrl-C ends the page, not the daemon."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil live``."""
    command = CommandParser(prog="hil live", description=DESCRIPTION)
    command.add_argument(
        "recording",
        type=Path,
        nargs="*",
        metavar="FILE",
        help="recording to play, instead of a daemon: a file, all files of a run, or their folder",
    )
    command.add_argument(
        "--from",
        dest="from_s",
        type=seconds,
        metavar="S",
        help="play from this time on (default: begin)",
    )
    command.add_argument(
        "--to", dest="to_s", type=seconds, metavar="S", help="play up to this time (default: end)"
    )
    command.add_argument("--operate", action="store_true", help="let the page operate the daemon")
    add_socket_option(command)
    add_address_options(command)
    return command


def main(argv: list[str]) -> int:
    """Run ``hil live`` with ``argv``; return its exit status. Raises HilError."""
    from hil.live.process import start_foxglove_server, start_page_server

    options = parser().parse_args(argv)
    _check(options)
    if options.foxglove is not None:
        process, url = start_foxglove_server(
            _feed_of_daemon(options), options.host, options.foxglove, is_followed=True
        )
    else:
        feed = None if options.recording else _feed_of_daemon(options)
        operator_socket = _socket(options) if options.operate else None
        with open_address(options.host, options.port) as address:
            process = start_page_server(
                address,
                feed=feed,
                is_followed=True,
                recording=options.recording or None,
                range_s=(options.from_s, options.to_s),
                operator_socket=operator_socket,
            )
        url = address.url
    sys.stdout.write(f"{url}\nCtrl-C ends the {'stream' if options.foxglove is not None else 'page'}.\n")
    sys.stdout.flush()
    for ending in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, lambda received, _frame: sys.exit(128 + received))  # the server ends too
    try:
        status = process.wait()
    finally:
        process.terminate()
    if status >= 0:
        return status
    sys.stderr.write(
        f"hil live: the serving process was ended by {signal.Signals(-status).name}. Nothing else is "
        "affected; start `hil live` again\n"
    )
    return 1


def _check(options: argparse.Namespace) -> None:
    """Raise HilError for arguments that do not fit together, and for a recording that cannot be read."""
    from hil.recording import open_recording

    if options.operate and options.foxglove is not None:
        raise DocumentError("--operate needs the page; Foxglove only shows. Omit --operate or --foxglove")
    if not options.recording:
        if options.from_s is not None or options.to_s is not None:
            raise DocumentError("--from and --to are times of a recording: give its FILE, or omit them")
        return
    if options.operate:
        raise DocumentError("--operate needs a daemon; a recording can only be played")
    if options.foxglove is not None:
        raise DocumentError(
            f"--foxglove serves a run; Foxglove itself opens the recording: open {options.recording[0]} there"
        )
    paths = options.recording
    recording = open_recording(paths[0] if len(paths) == 1 else paths)
    if len(recording.between(options.from_s, options.to_s).timing()) == 0:
        times_s = recording.timing().time_s
        span = f"{times_s[0]:.3f} to {times_s[-1]:.3f} s" if len(times_s) else "none"
        raise RecordingError(f"{paths[0]}: no period between --from and --to; its periods: {span}")


def _feed_of_daemon(options: argparse.Namespace) -> Path:
    """Return the file with the feed of the daemon. Raises OperationError if no daemon runs."""
    from hil.live.feed_file import FeedReader, link_beside
    from hil.operation.client import connect

    connect(_socket(options)).close()
    link = link_beside(_socket(options))
    FeedReader(link).close()
    return link


def _socket(options: argparse.Namespace) -> Path:
    from hil.operation.socket_path import default_path

    path: Path = options.socket or default_path()
    return path
