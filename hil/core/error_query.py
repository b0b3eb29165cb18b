"""A question to a board that ignores NMT start: its error register (1001h) and its last error (1003h:1).

The gateway reads both objects over SDO (CiA 301, expedited upload) and puts the answers into words. It asks
once for each time that a board does not start. An answer is taken only while it is awaited.
"""

from __future__ import annotations

from enum import Enum
from struct import Struct
from typing import NamedTuple

from hil.core.board_watch import describe_error_code
from hil.core.frames import Frame

SDO_REQUEST = 0x600
"""Identifier of an SDO request to node 0. Add the node id."""
SDO_ANSWER = 0x580
"""Identifier of an SDO answer of node 0. Add the node id."""
ANSWER_TIMEOUT_NS = 500_000_000
"""Time after which a board that has not answered counts as one that does not answer."""

_REQUEST = Struct("<BHBI")
_UPLOAD = 0x40
_ABORT = 0x80

REGISTER_BITS = (
    "generic error",
    "current",
    "voltage",
    "temperature",
    "communication error",
    "device profile",
    "reserved",
    "manufacturer specific",
)
"""Meaning of the bits of the error register 1001h (CiA 301), bit 0 first."""

ABORT_CODES = {
    0x0504_0000: "SDO protocol timed out",
    0x0601_0000: "unsupported access",
    0x0602_0000: "no such object",
    0x0609_0011: "no such subindex",
    0x0800_0000: "general error",
    0x0800_0020: "the data cannot be transferred",
    0x0800_0022: "the data cannot be transferred in this state",
    0x0800_0024: "no data",
}
"""Meaning of the abort codes (CiA 301) that an upload may have."""


class Asked(Enum):
    """Object that the board was asked for, as index and subindex."""

    ERROR_REGISTER = (0x1001, 0)
    LAST_ERROR = (0x1003, 1)


class Step(NamedTuple):
    """What follows from an answer, or from its absence."""

    request: Frame | None = None
    """Next question."""
    finding: str | None = None
    """All answers in words, when there is no further question."""


class ErrorQuery:
    """The question to one board. Times are monotonic nanoseconds."""

    def __init__(self, node_id: int) -> None:
        self._request_id = SDO_REQUEST + node_id
        self._awaited: Asked | None = None
        self._asked_ns = 0
        self._register = ""
        self.is_begun = False
        """True if the board was asked since the last reset."""
        self.finding: str | None = None
        """What the board answered, in words; None before it has answered everything."""

    def reset(self) -> None:
        """Forget the answers, and allow a new question."""
        self._awaited = self.finding = None
        self.is_begun = False

    def begin(self, now_ns: int) -> Frame:
        """Return the first question."""
        self.is_begun = True
        return self._ask(Asked.ERROR_REGISTER, now_ns)

    def is_answer(self, data: bytes) -> bool:
        """Return whether a frame from the board is the answer that is awaited."""
        if self._awaited is None or len(data) != 8:
            return False
        command, index, subindex, _ = _REQUEST.unpack(data)
        return (index, subindex) == self._awaited.value and (command == _ABORT or command >> 5 == 2)

    def answer(self, data: bytes, now_ns: int) -> Step:
        """Take the awaited answer."""
        command, _, _, value = _REQUEST.unpack(data)
        if self._awaited is Asked.ERROR_REGISTER:
            self._register = f"error register {_register_text(command, value)}"
            return Step(self._ask(Asked.LAST_ERROR, now_ns))
        return self._finish(f"{self._register}; last error {_last_error_text(command, value)}")

    def check_timeout(self, now_ns: int) -> Step | None:
        """Return what follows from an answer that does not come in time, or None."""
        if self._awaited is None or now_ns - self._asked_ns <= ANSWER_TIMEOUT_NS:
            return None
        index, subindex = self._awaited.value
        silence = f"no answer to SDO ({index:X}h:{subindex}) within {ANSWER_TIMEOUT_NS / 1e6:g} ms"
        return self._finish(
            silence if self._awaited is Asked.ERROR_REGISTER else f"{self._register}; {silence}"
        )

    def _ask(self, asked: Asked, now_ns: int) -> Frame:
        self._awaited, self._asked_ns = asked, now_ns
        return Frame(self._request_id, _REQUEST.pack(_UPLOAD, *asked.value, 0))

    def _finish(self, finding: str) -> Step:
        self._awaited, self.finding = None, finding
        return Step(finding=finding)


def describe_error_register(register: int) -> str:
    """Return the error register (CiA 301, 1001h) in words."""
    causes = [text for bit, text in enumerate(REGISTER_BITS) if register >> bit & 1]
    return f"0x{register:02X} ({', '.join(causes) or 'no error'}, 1001h)"


def _register_text(command: int, value: int) -> str:
    unread = _unread(command, value)
    return f"not readable: {unread} (1001h)" if unread else describe_error_register(value & 0xFF)


def _last_error_text(command: int, value: int) -> str:
    unread = _unread(command, value)
    return f"not readable: {unread} (1003h)" if unread else f"{describe_error_code(value & 0xFFFF)} (1003h)"


def _unread(command: int, value: int) -> str | None:
    """Return why an answer has no value, or None."""
    if command == _ABORT:
        return f"abort 0x{value:08X}, {ABORT_CODES.get(value, 'unknown abort code')}"
    return None if command & 0x02 else "the answer has more than four bytes"
