"""Starts the processes that show a run or a recording: the server of the page, and that for Foxglove."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil.live.address import Address, open_stream_address


def start_page_server(
    address: Address,
    *,
    feed: Path | None = None,
    is_followed: bool = False,
    recording: Sequence[Path] | None = None,
    range_s: tuple[float | None, float | None] = (None, None),
    operator_socket: Path | None = None,
) -> subprocess.Popen[bytes]:
    """Start the process that serves the page at ``address``.

    It reads the feed of a run from the file ``feed``; with ``is_followed``, ``feed`` is a daemon's link, and
    after the end of a run the next one is shown. Or it plays the files of ``recording`` between the two
    times of ``range_s``. With ``operator_socket``, the page may operate the daemon that has that socket.
    """
    options = {
        "feed": None if feed is None else str(feed),
        "is_followed": is_followed,
        "recording": None if recording is None else [str(path) for path in recording],
        "range_s": range_s,
        "operate": None if operator_socket is None else str(operator_socket),
    }
    return _start("hil.live.server", address, options)


def start_foxglove_server(
    feed: Path, host: str, port: int, *, is_followed: bool = False
) -> tuple[subprocess.Popen[bytes], str]:
    """Start the process that serves the feed of a run to Foxglove. Return it and the address for Foxglove.

    With ``is_followed``, ``feed`` is a daemon's link, and after the end of a run the next one is served.
    Warns if other machines can read the stream. Raises EnvironmentLackError if a package is not installed or
    the port is in use.
    """
    with open_stream_address(host, port) as address:
        options = {"feed": str(feed), "is_followed": is_followed}
        return _start("hil.live.foxglove_server", address, options), address.url


def _start(module: str, address: Address, options: dict[str, Any]) -> subprocess.Popen[bytes]:
    """Start a process that serves at ``address``. It reads its options and the token from a pipe."""
    listener = address.listener.fileno()
    options = {**options, "listen": listener, "hosts": address.hosts, "token": address.token}
    read_end, write_end = os.pipe()
    process = subprocess.Popen(
        # -P: modules in the working directory are not imported.
        [sys.executable, "-P", "-m", module, str(read_end)],
        pass_fds=[read_end, listener],
        stdin=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C in the terminal must not end the page before the run.
    )
    os.close(read_end)
    with contextlib.suppress(BrokenPipeError), os.fdopen(write_end, "w") as pipe:  # no token in an argument
        json.dump(options, pipe)
    return process
