"""Notifications to systemd: readiness, watchdog, end (sd_notify(3)). Without systemd, they do nothing."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping
from typing import Self


class Notifier:
    """Sends notifications to the socket that systemd names. It never blocks.

    ``environment`` has ``NOTIFY_SOCKET`` and ``WATCHDOG_USEC`` (os.environ by default).
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._socket: socket.socket | None = None
        self.watchdog_s: float | None = None
        """Time within which systemd wants the next notification of the watchdog; None without one."""
        path = environment.get("NOTIFY_SOCKET", "")
        if not path:
            return
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        # An abstract socket is written with @ (sd_notify(3)).
        self._path = "\0" + path[1:] if path.startswith("@") else path
        if environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid()):
            with contextlib.suppress(ValueError):
                self.watchdog_s = int(environment.get("WATCHDOG_USEC", "")) * 1e-6

    def send(self, *assignments: str) -> None:
        """Send assignments such as ``READY=1``. A notification that cannot be sent is dropped."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto("\n".join(assignments).encode(), self._path)

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
