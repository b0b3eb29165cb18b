"""A process that displays what this process sends it. Sending never blocks.

A terminal may stall (a slow ssh connection, Ctrl-S), and the loop must not. So another process prints, and a
message that does not fit into the connection is dropped.
"""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from hil.host.child_process import await_end

CLOSE_TIMEOUT_S = 2.0
MAX_MESSAGE_BYTES = 65536
"""Size of the receive buffer. A message is a status or a log entry, and far smaller."""
SHOW_CURSOR = "\x1b[?25h"
"""Terminal sequence that shows the cursor, which a live picture hides."""


class DisplayProcess:
    """Starts ``python -m module DESCRIPTOR``, which reads :func:`received_messages`.

    Close it before this process prints anything itself.
    """

    def __init__(self, module: str) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                # -P: modules in the working directory are not imported.
                [sys.executable, "-P", "-m", module, str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C in the terminal must not end the display.
            )
        self._socket.setblocking(False)

    def send(self, message: dict[str, object]) -> None:
        """Send a message. It is dropped when the process is too slow, or has ended."""
        with contextlib.suppress(OSError):
            self._socket.send(json.dumps(message).encode())

    def close(self) -> None:
        """Wait until the process has displayed all messages and has ended; kill it after a timeout."""
        self._socket.close()
        if await_end(self._process, CLOSE_TIMEOUT_S) is None and sys.stderr.isatty():
            sys.stderr.write(SHOW_CURSOR)


def received_messages(file_descriptor: int) -> Iterator[dict[str, Any]]:
    """In the display's process: yield the messages until the other process closes the connection."""
    with socket.socket(fileno=file_descriptor) as connection:
        while data := connection.recv(MAX_MESSAGE_BYTES):
            yield json.loads(data)
