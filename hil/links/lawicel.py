"""python-can's slcan bus without its waits.

python-can sleeps 2 s after opening, asks the driver for every byte, and flushes after every frame, which
on a slow line takes longer than a period. Here opening ends as soon as the adapter has answered, reading
is one read of all that the descriptor has, and writing never waits.
Protocol: Lawicel, CAN232 manual, version 3 (commands C, S6, O; answers CR and BELL).
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import time
from collections import deque
from typing import Final

from can import CanInitializationError, CanOperationError, Message
from can.exceptions import error_check
from can.interfaces.slcan import slcanBus

_DONE: Final = b"\r"
_REFUSED: Final = b"\a"
_LONGEST_LINE: Final = 64
_ANSWER_S: Final = 0.25
_QUIET_S: Final = 0.03
_BOOT_S: Final = 3.0
"""An Arduino starts anew when its port is opened and answers after about 2 s."""


class LawicelBus(slcanBus):
    """An adapter on the serial ``device`` at ``baud``, its CAN side at 500 kbit/s."""

    def __init__(self, device: str, baud: int) -> None:
        """Raises CanInitializationError."""
        self._lines: deque[bytes] = deque()
        self._partial = b""
        self._unsent = b""
        self._read_at_s = 0.0
        self.refused = 0
        """Frames that the adapter answered with BELL."""
        try:
            super().__init__(device, tty_baudrate=baud, sleep_after_open=0)
        except BaseException:
            if hasattr(self, "serialPortOrig"):
                self.serialPortOrig.close()
            raise

    def open(self) -> None:
        """Take the port for this program, set the bit rate, and go on the bus."""
        self.serialPortOrig.exclusive = True
        with contextlib.suppress(ValueError, OSError):  # a USB or pseudo-terminal without a latency timer
            self.serialPortOrig.set_low_latency_mode(True)
        self.serialPortOrig.reset_input_buffer()
        end = time.monotonic() + _BOOT_S
        while self._command("C") is None or self._read_lines(_QUIET_S):  # until answered, and quiet
            if time.monotonic() > end:
                raise CanInitializationError(
                    "the device does not answer; has it slcan firmware, and is the baud rate right?"
                )
        for command, meaning in (("S6", "500 kbit/s"), ("O", "going on the bus")):
            if self._command(command) != _DONE:
                raise CanInitializationError(f"the adapter refused {meaning} (command {command})")

    def shutdown(self) -> None:
        """Take the adapter off the bus; safe to repeat, and when it is unplugged."""
        if not self._is_shutdown:
            with contextlib.suppress(CanOperationError):
                super().shutdown()
            self.serialPortOrig.close()

    def _command(self, command: str) -> bytes | None:
        """Send ``command`` and return the adapter's answer, None when there was none in time."""
        self._write(command)
        end = time.monotonic() + _ANSWER_S
        while (left := end - time.monotonic()) > 0:
            for line in self._read_lines(left):
                if line in (_DONE, _REFUSED):
                    return line
        return None

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        with error_check("not a Lawicel frame"):
            message, filtered = super()._recv_internal(timeout)
        if message is not None:
            message.timestamp = self._read_at_s
        return message, filtered

    def _read(self, timeout: float | None) -> str | None:
        """The next line that holds a frame."""
        if not self._lines:
            lines = self._read_lines(timeout)
            self.refused += lines.count(_REFUSED)
            self._lines.extend(line for line in lines if line[:1] in b"tTrR")
        return self._lines.popleft().decode() if self._lines else None

    def _read_lines(self, timeout: float | None) -> list[bytes]:
        self._finish()
        if not select.select([self.fileno()], [], [], timeout)[0]:
            return []
        arrived = os.read(self.fileno(), 65536)
        if not arrived:
            raise OSError(errno.EIO, "the line was closed")
        self._read_at_s = time.time()
        *lines, rest = (self._partial + arrived).replace(_REFUSED, b"\a\r").split(_DONE)
        self._partial = rest[-_LONGEST_LINE:]
        return [line if line == _REFUSED else line + _DONE for line in lines]

    def _write(self, string: str) -> None:
        with error_check("cannot write"):
            self._finish()
            data = string.encode() + self.LINE_TERMINATOR
            taken = 0 if self._unsent else self._take(data)
            if not taken:
                raise BlockingIOError(errno.EAGAIN, "the line's buffer is full")
            self._unsent = data[taken:]

    def _finish(self) -> None:
        """Go on with a frame of which the line has taken a part."""
        self._unsent = self._unsent[self._take(self._unsent) :]

    def _take(self, data: bytes) -> int:
        """How much of ``data`` the driver takes now."""
        try:
            return os.write(self.fileno(), data) if data else 0
        except BlockingIOError:
            return 0
