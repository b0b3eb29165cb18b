"""A viewer of the live page as a process of its own, and a process that has one: ``live_viewer.py ADDRESS``.

The viewer receives as a page does, and draws nothing. It prints a line for each message that has rows. When
its standard input ends, it prints the times of all rows.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tornado.websocket import websocket_connect

TIMEOUT_S = 60.0
SERVER_TIMEOUT_S = 10.0
MISSED = "periods that this page missed"


class Seen(NamedTuple):
    """What a viewer has received so far."""

    rows: int
    last_s: float
    """Time of the last row."""
    missed: int
    """Number of periods that the server says this viewer has missed."""


class LiveViewer:
    """A viewer in a process."""

    def __init__(self, address: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, __file__, address], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.pid = self._process.pid
        self._seen = Seen(0, -1.0, 0)
        self._times_s: list[float] | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    @property
    def seen(self) -> Seen:
        with self._changed:
            return self._seen

    def wait_until(self, is_true: Callable[[Seen], bool], what: str) -> Seen:
        """Wait for an update after which ``is_true``."""
        with self._changed:
            assert self._changed.wait_for(lambda: is_true(self._seen), TIMEOUT_S), f"{what}: {self._seen}"
            return self._seen

    def wait_for_rows(self, count: int) -> Seen:
        """Wait for ``count`` more rows."""
        aim = self.seen.rows + count
        return self.wait_until(lambda seen: seen.rows >= aim, f"{aim} rows")

    def times_s(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """End the viewer, and return the times of its rows."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._thread.join(TIMEOUT_S)
        assert self._process.wait(TIMEOUT_S) == 0 and self._times_s is not None
        return np.array(self._times_s)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            found = json.loads(line)
            with self._changed:
                if "times_s" in found:
                    self._times_s = found["times_s"]
                else:
                    self._seen = Seen(**found)
                self._changed.notify_all()


def view(address: str) -> None:
    """Receive until standard input ends."""
    times_s: list[float] = []

    async def receive() -> None:
        connection = await websocket_connect(address.replace("http://", "ws://").replace("/?", "/stream?"))
        width, missed = 0, 0
        while (message := await connection.read_message()) is not None:
            if isinstance(message, bytes):
                times_s.extend(np.frombuffer(message).reshape(-1, width)[:, 0].tolist())
                print(json.dumps(Seen(len(times_s), times_s[-1], missed)._asdict()), flush=True)
                continue
            for part in json.loads(message):
                if "run" in part:
                    width = 5 + 3 * len(part["run"]["axes"])
                elif "status" in part:
                    missed = part["status"]["counts"].get(MISSED, 0)

    async def receive_until_end() -> None:
        task = asyncio.create_task(receive())
        await asyncio.to_thread(sys.stdin.read)
        task.cancel()

    asyncio.run(receive_until_end())
    print(json.dumps({"times_s": times_s}), flush=True)


def server_of(process_id: int, module: str = "hil.live.server") -> int:
    """Return the id of the process that serves the page, a child of ``process_id``.

    The kernel's list of children may lack one while another begins or ends (proc(5)), so it is read again.
    """
    end_s = time.monotonic() + SERVER_TIMEOUT_S
    while time.monotonic() < end_s:
        for child in Path(f"/proc/{process_id}/task/{process_id}/children").read_text().split():
            with contextlib.suppress(OSError):
                if module.encode() in Path(f"/proc/{child}/cmdline").read_bytes():
                    return int(child)
        os.sched_yield()
    raise AssertionError(f"{process_id} has no child {module}")


def private_mb(process_id: int) -> float:
    """Return the private resident memory of a process."""
    for line in Path(f"/proc/{process_id}/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1]) * 1024 / 1e6
    raise AssertionError(f"process {process_id} has no RssAnon")


if __name__ == "__main__":
    view(sys.argv[1])
