"""A serial CAN adapter with the Lawicel (slcan) protocol, as a state machine without serial line and bus.

The adapter is given bytes from the host and frames from the bus. It returns bytes for the host and frames for
the bus. It answers every command of the CAN232 manual, version 3:

=============  ==================================================  ==========================
commands       effect                                              allowed while the channel
=============  ==================================================  ==========================
S, s           bit rate of the bus                                 is closed
O, L; C        open, open as a listener; close                     is closed; is open
t, T, r, R     send a frame                                        is open, not as a listener
X              automatic polling on (X1) or off (X0)               is closed
P, A           read one frame, or all frames, that wait            is open, with X0
F              read and clear the status flags                     is open
W, M, m        filter mode, acceptance code, acceptance mask       is closed
Z              time stamps on (Z1) or off (Z0)                     is closed
U              baud rate of the serial line                        is closed
Q              open the channel at power-on: off, on, listening    is open
V, v, N        versions, serial number                             always
=============  ==================================================  ==========================

With automatic polling, which this adapter is delivered with, it sends every frame to the host without a
request. Filters are accepted, and every frame passes, which is what the values at power-on do. A baud rate is
accepted too: a pseudo-terminal has none. The adapter keeps its settings without power (:meth:`power_on`).
"""

from __future__ import annotations

import re
from collections import deque
from typing import Final, NamedTuple

from hil.core.frames import Frame

_OK: Final = b"\r"
_ERROR: Final = b"\a"
_VERSION: Final = b"V1013\r"
_DETAILED_VERSION: Final = b"v0001\r"
_SERIAL_NUMBER: Final = b"NSIM1\r"
_MAX_LINE_BYTES: Final = 26
"""Length of the longest line: T, 8 digits of identifier, the length, 16 digits of data."""
_TIMESTAMP_WRAP_MS: Final = 60_000
_QUEUE_OVERRUN: Final = 0x01
"""Status flag: the queue to the host was full."""
_QUEUED_FRAMES: Final = 32
"""Number of frames that wait for the host to poll them before others are lost."""
_SWITCHES: Final = re.compile(rb"[XZ][01]")
_BAUD_RATE: Final = re.compile(rb"U[0-6]")
_AUTO_START: Final = re.compile(rb"Q[0-2]")

_FRAME: Final = re.compile(
    rb"(?:(?P<kind>[tr])(?P<id>[0-7][0-9A-Fa-f]{2})|(?P<long_kind>[TR])(?P<long_id>[01][0-9A-Fa-f]{7}))"
    rb"(?P<length>[0-8])(?P<data>(?:[0-9A-Fa-f]{2}){0,8})"
)
_BIT_RATE: Final = re.compile(rb"S[0-8]|s[0-9A-Fa-f]{4}")
_FILTER: Final = re.compile(rb"[Mm][0-9A-Fa-f]{8}|W[01]")


class Answer(NamedTuple):
    """Result of bytes from the host: bytes to send back, and frames for the bus."""

    to_host: bytes
    to_bus: tuple[Frame, ...]


def frame_to_text(frame: Frame) -> bytes:
    """Return the line for a frame, such as ``t1232AABB``, without its end."""
    kind = ("R" if frame.is_extended else "r") if frame.is_remote else ("T" if frame.is_extended else "t")
    identifier = f"{frame.id:08X}" if frame.is_extended else f"{frame.id:03X}"
    data = "" if frame.is_remote else frame.data.hex().upper()
    return f"{kind}{identifier}{len(frame.data)}{data}".encode()


def frame_from_text(line: bytes) -> Frame | None:
    """Return the frame in a line (without its end), or None if the line is no frame."""
    match = _FRAME.fullmatch(line)
    if match is None:
        return None
    kind = match["kind"] or match["long_kind"]
    is_remote = kind in b"rR"
    data, length = bytes.fromhex(match["data"].decode()), int(match["length"])
    if len(data) != (0 if is_remote else length):
        return None
    if is_remote:
        data = bytes(length)
    return Frame(int(match["id"] or match["long_id"], 16), data, kind in b"TR", is_remote)


class LawicelAdapter:
    """State of the adapter: bit rate set or not; closed, open or listen-only; the incomplete line so far."""

    def __init__(self) -> None:
        self.is_open = False
        self._listens_only = False
        self._has_bit_rate = False
        self._stamps = False
        self._polls = True
        """True if frames go to the host without a request (automatic polling)."""
        self._auto_start = b"Q0"
        """What happens at power-on: Q0 nothing, Q1 opens the channel, Q2 opens it as a listener."""
        self._waiting: deque[bytes] = deque()
        """Lines of the frames that the host has not polled yet."""
        self._flags = 0
        self._line = bytearray()
        self._line_is_too_long = False

    def power_on(self) -> None:
        """Begin anew after a loss of power. The settings stay, and the channel is opened if Q says so."""
        self._line.clear()
        self._line_is_too_long = False
        self._waiting.clear()
        self._flags = 0
        self._has_bit_rate = self.is_open = self._auto_start != b"Q0"
        self._listens_only = self._auto_start == b"Q2"

    def from_host(self, data: bytes) -> Answer:
        """Handle bytes from the host. Lines may be split anywhere; each complete line gets an answer."""
        answers: list[bytes] = []
        frames: list[Frame] = []
        *ends, rest = data.split(b"\r")
        for piece in ends:
            self._extend(piece)
            answers.append(self._end_line(frames))
        self._extend(rest)
        return Answer(b"".join(answers), tuple(frames))

    def from_bus(self, frame: Frame, now_ns: int) -> bytes:
        """Return the bytes that the host gets for a frame on the bus now.

        There are none while the channel is closed, and none without automatic polling: the frame then waits.
        """
        if not self.is_open or frame.is_error:
            return b""
        stamp = b"%04X" % (now_ns // 1_000_000 % _TIMESTAMP_WRAP_MS) if self._stamps else b""
        line = frame_to_text(frame) + stamp + b"\r"
        if self._polls:
            return line
        if len(self._waiting) < _QUEUED_FRAMES:
            self._waiting.append(line)
        else:
            self.overrun()
        return b""

    def overrun(self) -> None:
        """Set the status flag for data that was lost because the host reads too slowly."""
        self._flags |= _QUEUE_OVERRUN

    def _extend(self, piece: bytes) -> None:
        if len(self._line) + len(piece) > _MAX_LINE_BYTES:
            self._line_is_too_long = True
        else:
            self._line += piece

    def _end_line(self, frames: list[Frame]) -> bytes:
        line, is_too_long = bytes(self._line), self._line_is_too_long
        self._line.clear()
        self._line_is_too_long = False
        if is_too_long:
            return _ERROR
        if line[:1] in (b"t", b"T", b"r", b"R"):
            return self._transmit(line, frames)
        return self._answer_open(line) if self.is_open else self._answer_closed(line)

    def _transmit(self, line: bytes, frames: list[Frame]) -> bytes:
        frame = frame_from_text(line)
        if frame is None or not self.is_open or self._listens_only:
            return _ERROR
        frames.append(frame)
        if not self._polls:
            return _OK
        return b"Z\r" if frame.is_extended else b"z\r"

    def _answer_closed(self, line: bytes) -> bytes:
        """Answer a command while the channel is closed."""
        if line in (b"O", b"L") and self._has_bit_rate:
            self.is_open = True
            self._listens_only = line == b"L"
            return _OK
        if _BIT_RATE.fullmatch(line):
            self._has_bit_rate = True
            return _OK
        if _SWITCHES.fullmatch(line):
            self._switch(line[:1], line[1:] == b"1")
            return _OK
        return _OK if _FILTER.fullmatch(line) or _BAUD_RATE.fullmatch(line) else _answer_always(line)

    def _switch(self, name: bytes, is_on: bool) -> None:
        if name == b"X":
            self._polls = is_on
        else:
            self._stamps = is_on

    def _answer_open(self, line: bytes) -> bytes:
        """Answer a command while the channel is open."""
        if line == b"C":
            self.is_open = False
            self._waiting.clear()
            return _OK
        if line in (b"A", b"P") and not self._polls:
            return self._poll(is_all=line == b"A")
        if _AUTO_START.fullmatch(line):
            self._auto_start = line
            return _OK
        if line == b"F":
            flags, self._flags = self._flags, 0
            return b"F%02X\r" % flags
        return _answer_always(line)

    def _poll(self, *, is_all: bool) -> bytes:
        """Return the next frame that waits, or an empty line without one; or all frames, and then A."""
        if is_all:
            lines = b"".join(self._waiting)
            self._waiting.clear()
            return lines + b"A\r"
        return self._waiting.popleft() if self._waiting else _OK


def _answer_always(line: bytes) -> bytes:
    """Answer a command that is valid in both states.

    Hosts send the empty line to discard an incomplete line in the adapter.
    """
    return {b"": _OK, b"V": _VERSION, b"v": _DETAILED_VERSION, b"N": _SERIAL_NUMBER}.get(line, _ERROR)
