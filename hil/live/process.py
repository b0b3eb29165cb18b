"""Starts the processes that show a run or a recording: the server of the page, and that for Foxglove."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from hil.core.errors import EnvironmentLackError
from hil.live.address import Address, warn_of_network


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
        "listen": address.listener.fileno(),
        "hosts": address.hosts,
        "token": address.token,
        "feed": None if feed is None else str(feed),
        "is_followed": is_followed,
        "recording": None if recording is None else [str(path) for path in recording],
        "range_s": range_s,
        "operate": None if operator_socket is None else str(operator_socket),
    }
    read_end, write_end = os.pipe()
    process = subprocess.Popen(
        # -P: modules in the working directory are not imported.
        [sys.executable, "-P", "-m", "hil.live.server", str(read_end)],
        pass_fds=[read_end, address.listener.fileno()],
        stdin=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C in the terminal must not end the page before the run.
    )
    os.close(read_end)
    with contextlib.suppress(BrokenPipeError), os.fdopen(write_end, "w") as pipe:  # no token in an argument
        json.dump(options, pipe)
    return process


def start_foxglove_server(feed: Path, host: str, port: int) -> tuple[subprocess.Popen[bytes], str]:
    """Start the process that serves the feed of a run to Foxglove. Return it and the address for Foxglove.

    Warns if other machines can read the stream. Raises EnvironmentLackError if the package is not installed
    or the port is in use.
    """
    if importlib.util.find_spec("foxglove") is None:
        raise EnvironmentLackError(
            "--foxglove needs foxglove-sdk: run `pip install 'pneumatic-hil[foxglove]'`"
        )
    warn_of_network("the stream for Foxglove", host)
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "hil.live.foxglove_server", str(feed), host, str(port)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdout is not None
    with process.stdout:
        url = process.stdout.readline().decode().strip()
    if not url:
        process.wait()
        raise EnvironmentLackError(
            f"the stream for Foxglove cannot be served on {host}:{port}: choose another port, such as "
            f"--foxglove {port + 1}, or another --host"
        )
    return process, url
