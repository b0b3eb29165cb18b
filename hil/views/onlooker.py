"""A process that shows what this one tells it. Telling never blocks: what does not fit is dropped.

Terminals stall (a slow ssh, Ctrl-S); a loop must not. So what people see is printed elsewhere.
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
LONGEST_MESSAGE = 65536
SHOW_CURSOR = "\x1b[?25h"
"""A live picture hides it."""


class Onlooker:
    """Starts ``python -m module DESCRIPTOR``, which reads :func:`messages`. Close it before printing."""

    def __init__(self, module: str) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", module, str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C in the terminal is for the teller alone
            )
        self._socket.setblocking(False)

    def tell(self, message: dict[str, object]) -> None:
        """Pass on a message; dropped when the onlooker is behind, or gone."""
        with contextlib.suppress(OSError):
            self._socket.send(json.dumps(message).encode())

    def close(self) -> None:
        """Let the onlooker finish what it has; one that does not is killed."""
        self._socket.close()
        if await_end(self._process, CLOSE_TIMEOUT_S) is None and sys.stderr.isatty():
            sys.stderr.write(SHOW_CURSOR)


def messages(file_descriptor: int) -> Iterator[dict[str, Any]]:
    """In the onlooker's process: what is told, until the teller closes."""
    with socket.socket(fileno=file_descriptor) as connection:
        while data := connection.recv(LONGEST_MESSAGE):
            yield json.loads(data)
