"""A serial device (pseudo-terminal) with a simulated Lawicel CAN adapter behind it.

A host opens the device like a real adapter, so the serial link is tested with real bytes. For the boards the
device is a bus: it has the methods of ``hil.links.Link`` that they use.
"""

from __future__ import annotations

import os
import select
import time
import tty
from collections import deque
from typing import Final

from firmware_sim.boards.lawicel import LawicelAdapter
from hil.core.frames import Frame
from hil.links import Received

_MAX_UNSENT_BYTES: Final = 4096
"""Limit of the queue to a host that does not read. Data beyond it is lost, and the status flag says so."""


class SerialDevice:
    """A serial device at ``path``. Hosts can open it from construction to ``close``."""

    def __init__(self) -> None:
        # This process keeps the host's side open too; else the line would hang up when the first host leaves.
        self._line, self._host_side = os.openpty()
        tty.setraw(self._host_side)
        os.set_blocking(self._line, False)
        self.path = os.ttyname(self._host_side)
        self._adapter = LawicelAdapter()
        self._arrived: deque[Frame] = deque()
        self._unsent = b""

    def send(self, frame: Frame) -> None:
        """Send a board's frame to the host. Never blocks."""
        self._write(self._adapter.from_bus(frame, time.monotonic_ns()))

    def receive(self, timeout_s: float) -> Received | None:
        """Return the next frame from the host, or None if none arrives within ``timeout_s`` seconds."""
        end = time.monotonic() + timeout_s
        while not self._arrived:
            left = end - time.monotonic()
            writers = [self._line] if self._unsent else []
            readable, writable, _ = select.select([self._line], writers, [], max(left, 0.0))
            if writable:
                self._write(b"")
            if readable:
                answer, frames = self._adapter.from_host(os.read(self._line, 65536))
                self._write(answer)
                self._arrived.extend(frames)
            elif left <= 0:
                return None
        return Received(self._arrived.popleft(), time.time_ns(), "user")

    def close(self) -> None:
        """Remove the device. A host that has it open sees its line hang up."""
        os.close(self._line)
        os.close(self._host_side)

    def _write(self, data: bytes) -> None:
        if len(self._unsent) + len(data) > _MAX_UNSENT_BYTES:
            self._adapter.overrun()
            data = b""
        self._unsent += data
        if self._unsent:
            try:
                self._unsent = self._unsent[os.write(self._line, self._unsent) :]
            except BlockingIOError:
                return
