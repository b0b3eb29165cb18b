"""A serial adapter that speaks the Lawicel protocol: python-can's slcan bus without its waiting times.

python-can sleeps for 2 s after opening, reads byte by byte, and flushes after every frame, which takes longer
than a period on a slow line. This bus is open as soon as the adapter has answered. It reads all waiting bytes
in one call, and never waits when it writes.

Protocol: Lawicel, CAN232 manual, version 3 (commands C, S0 to S8 and O; answers CR and BELL).
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

BIT_RATES: Final = {
    rate: f"S{number}"
    for number, rate in enumerate(
        (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
    )
}
"""Command of the protocol for each bit rate of the bus, in bit/s."""
_DONE: Final = b"\r"
_REFUSED: Final = b"\a"
_MAX_LINE_BYTES: Final = 64
"""Length beyond which the beginning of an unfinished line is discarded. The longest frame has 30."""
_ANSWER_TIMEOUT_S: Final = 0.25
_QUIET_S: Final = 0.03
"""Time without input after which the adapter counts as ready."""
_BOOT_TIMEOUT_S: Final = 3.0
"""Time for the first answer. An Arduino restarts when its port is opened, and answers after about 2 s."""


class LawicelBus(slcanBus):
    """An adapter on a serial device."""

    def __init__(self, device: str, baud: int, bit_rate: int) -> None:
        """Open the adapter on ``device``, such as /dev/ttyACM0, with ``baud`` bit/s on the serial line.

        ``bit_rate`` is that of the bus, one of ``BIT_RATES``. Raises CanInitializationError.
        """
        self._joining = (
            (BIT_RATES[bit_rate], f"{bit_rate / 1000:g} kbit/s"),
            ("O", "joining the bus"),
        )
        self._lines: deque[bytes] = deque()
        self._partial = b""
        self._unsent = b""
        self._read_at_s = 0.0
        self.refused = 0
        """Number of frames that the adapter refused with BELL."""
        try:
            super().__init__(device, tty_baudrate=baud, sleep_after_open=0)
        except BaseException:
            if hasattr(self, "serialPortOrig"):
                self.serialPortOrig.close()
            raise

    def open(self) -> None:
        """Lock the port for this program, set the bit rate, and join the bus."""
        self.serialPortOrig.exclusive = True
        with contextlib.suppress(ValueError, OSError):  # this terminal has no latency timer
            self.serialPortOrig.set_low_latency_mode(True)
        self.serialPortOrig.reset_input_buffer()
        end = time.monotonic() + _BOOT_TIMEOUT_S
        while self._command("C") is None or self._read_lines(_QUIET_S):  # until it has answered and is quiet
            if time.monotonic() > end:
                raise CanInitializationError(
                    "the device does not answer; does it have slcan firmware, and is the baud rate right?"
                )
        for command, meaning in self._joining:
            if self._command(command) != _DONE:
                raise CanInitializationError(f"the adapter refused {meaning} (command {command})")

    def shutdown(self) -> None:
        """Take the adapter off the bus. Safe to repeat, and with an adapter that is unplugged."""
        if not self._is_shutdown:
            with contextlib.suppress(CanOperationError):
                super().shutdown()
            self.serialPortOrig.close()

    def _command(self, command: str) -> bytes | None:
        """Send ``command`` and return the adapter's answer; None if there is none in time."""
        self._write(command)
        end = time.monotonic() + _ANSWER_TIMEOUT_S
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
        """Return the next line that holds a frame."""
        if not self._lines:
            lines = self._read_lines(timeout)
            self.refused += lines.count(_REFUSED)
            self._lines.extend(line for line in lines if line[:1] in b"tTrR")
        return self._lines.popleft().decode() if self._lines else None

    def _read_lines(self, timeout: float | None) -> list[bytes]:
        self._write_unsent()
        if not select.select([self.fileno()], [], [], timeout)[0]:
            return []
        arrived = os.read(self.fileno(), 65536)
        if not arrived:
            raise OSError(errno.EIO, "the line was closed")
        self._read_at_s = time.time()
        *lines, rest = (self._partial + arrived).replace(_REFUSED, b"\a\r").split(_DONE)
        self._partial = rest[-_MAX_LINE_BYTES:]
        return [line if line == _REFUSED else line + _DONE for line in lines]

    def _write(self, string: str) -> None:
        with error_check("cannot write"):
            self._write_unsent()
            data = string.encode() + self.LINE_TERMINATOR
            taken = 0 if self._unsent else self._write_now(data)
            if not taken:
                raise BlockingIOError(errno.EAGAIN, "the line's buffer is full")
            self._unsent = data[taken:]

    def _write_unsent(self) -> None:
        """Write the rest of a frame that the line took in part."""
        self._unsent = self._unsent[self._write_now(self._unsent) :]

    def _write_now(self, data: bytes) -> int:
        """Write what the driver accepts of ``data`` now; return the number of bytes."""
        try:
            return os.write(self.fileno(), data) if data else 0
        except BlockingIOError:
            return 0
