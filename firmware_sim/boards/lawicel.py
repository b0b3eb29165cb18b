"""A serial CAN adapter with the Lawicel (slcan) protocol, as a state machine without serial line and bus.

The adapter is given bytes from the host and frames from the bus. It returns bytes for the host and frames for
the bus. It follows the CAN232 manual, version 3, with automatic polling: the adapter sends every frame to the
host without a request. It accepts an acceptance code and mask (M, m) but passes every frame, which is what
the values at power-on do.
"""

from __future__ import annotations

import re
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

_FRAME: Final = re.compile(
    rb"(?:(?P<kind>[tr])(?P<id>[0-7][0-9A-Fa-f]{2})|(?P<long_kind>[TR])(?P<long_id>[01][0-9A-Fa-f]{7}))"
    rb"(?P<length>[0-8])(?P<data>(?:[0-9A-Fa-f]{2}){0,8})"
)
_BIT_RATE: Final = re.compile(rb"S[0-8]|s[0-9A-Fa-f]{4}")
_FILTER: Final = re.compile(rb"[Mm][0-9A-Fa-f]{8}")


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
        self._flags = 0
        self._line = bytearray()
        self._line_is_too_long = False

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
        """Return the bytes that the host gets for a frame on the bus; none while the channel is closed."""
        if not self.is_open or frame.is_error:
            return b""
        stamp = b"%04X" % (now_ns // 1_000_000 % _TIMESTAMP_WRAP_MS) if self._stamps else b""
        return frame_to_text(frame) + stamp + b"\r"

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
        if line in (b"Z0", b"Z1"):
            self._stamps = line == b"Z1"
            return _OK
        return _OK if _FILTER.fullmatch(line) else _answer_always(line)

    def _answer_open(self, line: bytes) -> bytes:
        """Answer a command while the channel is open."""
        if line == b"C":
            self.is_open = False
            return _OK
        if line == b"F":
            flags, self._flags = self._flags, 0
            return b"F%02X\r" % flags
        return _answer_always(line)


def _answer_always(line: bytes) -> bytes:
    """Answer a command that is valid in both states.

    Hosts send the empty line to discard an incomplete line in the adapter.
    """
    return {b"": _OK, b"V": _VERSION, b"v": _DETAILED_VERSION, b"N": _SERIAL_NUMBER}.get(line, _ERROR)
