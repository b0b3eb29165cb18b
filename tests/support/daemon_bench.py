"""A daemon in a process of its own, on simulated boards, with this process in place of systemd."""

from __future__ import annotations

import contextlib
import os
import queue
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from hil.operation.client import Client, connect
from hil.operation.protocol import Status

TIMEOUT_S = 60.0
HIL = [sys.executable, "-m", "hil.cli"]


class Daemon:
    """A running daemon. Its log is in ``log_path`` when it has ended."""

    def __init__(self, folder: Path, arguments: list[str]) -> None:
        self.socket_path = folder / "d.sock"
        self.record_path = folder / "daemon.mcap"
        self.second_path = folder / "daemon-2.mcap"
        """Recording after `record new`."""
        self.log_path = folder / "log"
        self._notified = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._notified.bind(str(folder / "notify"))
        self._queue: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()
        with self.log_path.open("w") as log:
            self.process = subprocess.Popen(
                [
                    *HIL,
                    "daemon",
                    "--socket",
                    str(self.socket_path),
                    "--record",
                    str(self.record_path),
                    *arguments,
                ],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stderr=log,
                env=os.environ | {"NOTIFY_SOCKET": str(folder / "notify"), "WATCHDOG_USEC": "400000"},
            )

    def await_notification(self, wanted: str) -> None:
        """Wait for a notification that has the line ``wanted``."""
        while wanted not in self._queue.get(timeout=TIMEOUT_S).splitlines():
            pass

    def is_silent_for(self, duration_s: float) -> bool:
        """True if no notification comes for a time, after at most one that was sent before."""
        for _ in range(2):
            try:
                self._queue.get(timeout=duration_s)
            except queue.Empty:
                return True
        return False

    def forget_notifications(self) -> None:
        """Forget the notifications that have come so far."""
        while not self._queue.empty():
            self._queue.get_nowait()

    def _read(self) -> None:
        """Read notifications as they come, as systemd does: the kernel keeps only a few."""
        with contextlib.suppress(OSError):
            while data := self._notified.recv(4096):
                self._queue.put(data.decode())

    def client(self) -> Client:
        return connect(self.socket_path)

    def hil(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run a command for this daemon."""
        command = [*HIL, *arguments, "--socket", str(self.socket_path)]
        return subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)

    def end(self) -> int:
        """Wait until the daemon has ended; return its exit status."""
        return self.process.wait(TIMEOUT_S)

    def log(self) -> str:
        return self.log_path.read_text()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._notified.shutdown(socket.SHUT_RDWR)
        self._notified.close()


def until(client: Client, wanted: Callable[[Status], bool]) -> Status:
    """Watch until a status is ``wanted``, and return it."""
    for look in client.watch(0.05):
        if wanted(look):
            return look
    raise AssertionError("the daemon ended before")


@contextlib.contextmanager
def daemon(folder: Path, *arguments: str) -> Iterator[Daemon]:
    """Start a daemon, wait until it is ready, and kill it at the end if it still runs."""
    started = Daemon(folder, list(arguments))
    try:
        started.await_notification("READY=1")
        yield started
    finally:
        started.close()
