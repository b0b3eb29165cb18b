"""A server of the operator's socket in this process, with a made-up loop behind it."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from hil.operation.pipe import Asked, Facts, Logged, Replied, StatusNow, pipe
from hil.operation.protocol import AxisStatus, LogLine, Status
from hil.operation.server import Server
from hil.operation.socket_path import listening
from hil.shells.run_setup import RIG_NAME, SHIPPED

TIMEOUT_S = 20.0
FACTS = Facts("0.0", "can7", (SHIPPED / RIG_NAME).read_text())


def status(**changes: Any) -> Status:
    """Return a status of a loop in state ready."""
    given: dict[str, Any] = {
        "state": "ready",
        "fault": None,
        "readiness": "adc operational; dac operational",
        "bus": "can7",
        "is_simulated": False,
        "period": 100,
        "period_s": 0.0112,
        "time_ns": 1_700_000_000_000_000_000,
        "max_lateness_ms": 0.125,
        "max_lateness_since_start_ms": 6.5,
        "missed_periods": 2,
        "rejected_frames": 0,
        "lost_samples": 0,
        "recording": "runs/one.mcap",
        "axes": (
            AxisStatus("vertical", "m", 0.05, 0.0123, 0.0377, 1.2, 6.2),
            AxisStatus("rotation", "rad", None, None, None, 0.0, 5.0),
        ),
    }
    return Status(**(given | changes))


class MadeUpLoop:
    """The loop's end of a pipe. It replies with ``reply`` in a thread, and keeps what it was asked."""

    def __init__(self, end: socket.socket) -> None:
        self.end = end
        self.end.settimeout(TIMEOUT_S)
        self.asked: list[Asked] = []
        self.logged: list[str] = []
        """Log entries of the server about requests that it refused."""
        self.reply: Callable[[Asked], Replied | None] = lambda a: Replied(a.number, True, "done")
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def send(self, message: msgspec.Struct) -> None:
        self.end.send(msgspec.msgpack.encode(message))

    def send_status(self, **changes: Any) -> None:
        self.send(StatusNow(status(**changes)))

    def send_log(self, text: str) -> None:
        self.send(Logged(LogLine(1_700_000_000_000_000_000, 30, "loop", text)))

    def _run(self) -> None:
        while True:
            try:
                data = self.end.recv(1 << 20)
            except OSError:
                return
            if not data:
                return
            asked = msgspec.msgpack.decode(data, type=Asked | Logged)  # type: ignore[type-var]
            if isinstance(asked, Logged):
                self.logged.append(asked.line.text)
                continue
            self.asked.append(asked)
            reply = self.reply(asked)
            if reply is not None:
                self.send(reply)


@contextmanager
def served(folder: Path, facts: Facts = FACTS) -> Iterator[tuple[MadeUpLoop, Path]]:
    """Serve at a socket in ``folder``, in a thread. Yield the loop and the socket's path."""
    path = folder / "s"
    ours, theirs = pipe()
    with listening(path) as listener, ours, theirs:
        listener.setblocking(False)
        server = threading.Thread(
            target=lambda: asyncio.run(Server(listener, theirs, facts).run()), daemon=True
        )
        server.start()
        try:
            yield MadeUpLoop(ours), path
        finally:
            ours.shutdown(socket.SHUT_RDWR)
            server.join(TIMEOUT_S)
        assert not server.is_alive()


class RawClient:
    """A client that sends any bytes and reads lines."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(TIMEOUT_S)
        self.socket.connect(str(path))
        self._file = self.socket.makefile("rb")

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def read(self) -> dict[str, Any]:
        """Return the next line, or an empty dictionary at the end of the connection."""
        try:
            line = self._file.readline()
        except ConnectionResetError:
            return {}
        return json.loads(line) if line else {}

    def close(self) -> None:
        self._file.close()
        self.socket.close()

    def __enter__(self) -> RawClient:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
