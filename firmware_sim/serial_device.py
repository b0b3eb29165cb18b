"""A pseudo-terminal with a Lawicel adapter behind it: the serial link is tested with real bytes.

It has the methods of ``hil.links.Link`` that the boards need, seen from the adapter's CAN side.
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

_QUEUE_BYTES: Final = 4096
"""Bytes kept for a host that does not read; what comes after is lost and flagged."""


class SerialDevice:
    """A serial device at ``path``; open for hosts from construction to ``close``."""

    def __init__(self) -> None:
        # The host's side stays open here too, so that hosts may come and go.
        self._line, self._host_side = os.openpty()
        tty.setraw(self._host_side)
        os.set_blocking(self._line, False)
        self.path = os.ttyname(self._host_side)
        self._adapter = LawicelAdapter()
        self._arrived: deque[Frame] = deque()
        self._unsent = b""

    def send(self, frame: Frame) -> None:
        """A board's frame goes to the host; never waits for it."""
        self._write(self._adapter.from_bus(frame, time.monotonic_ns()))

    def receive(self, timeout_s: float) -> Received | None:
        """The host's next frame, or None when none came within ``timeout_s`` seconds."""
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
        """Take the device away; a host that has it open sees its line hang up."""
        os.close(self._line)
        os.close(self._host_side)

    def _write(self, data: bytes) -> None:
        if len(self._unsent) + len(data) > _QUEUE_BYTES:
            self._adapter.overrun()
            data = b""
        self._unsent += data
        if self._unsent:
            try:
                self._unsent = self._unsent[os.write(self._line, self._unsent) :]
            except BlockingIOError:
                return
