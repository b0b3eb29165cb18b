"""The SDO server of a simulated board (CiA 301): uploads of any length, and expedited downloads.

A client asks in 8 bytes, and the server answers each request in 8 bytes. A value of up to four bytes is in
the first answer (expedited). A longer value follows in segments of seven bytes. Segmented downloads and block
transfers are aborted.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct
from typing import Final

from firmware_sim.boards.object_dictionary import AbortCode, Dictionary, read, write

_MULTIPLEXER: Final = Struct("<HB")
_ABORT: Final = Struct("<BHBI")

_DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT, _ABORTED = 1, 2, 3, 4
"""Command specifiers of a client: bits 5 to 7 of the first byte."""
_EXPEDITED, _SIZE_INDICATED, _TOGGLE, _LAST = 0x02, 0x01, 0x10, 0x01
_SEGMENT_BYTES: Final = 7


class SdoServer:
    """Server of one dictionary. ``dictionary`` is called when a transfer begins."""

    __slots__ = ("_dictionary", "_multiplexer", "_rest", "_toggle")

    def __init__(self, dictionary: Callable[[], Dictionary]) -> None:
        self._dictionary = dictionary
        self._multiplexer = (0, 0)
        """Index and subindex of the present transfer."""
        self._rest: bytes | None = None
        """Bytes of a segmented upload that are still to be sent; None without a segmented upload."""
        self._toggle = 0

    def reset(self) -> None:
        """Forget a transfer that has begun."""
        self._rest = None

    def answer(self, data: bytes) -> bytes | None:
        """Return the answer to a request, or None if there is none."""
        if len(data) != 8:
            return None
        command = data[0]
        specifier = command >> 5
        if specifier == _ABORTED:
            self._rest = None
            return None
        if specifier == _UPLOAD_SEGMENT:
            return self._upload_segment(command)
        self._rest = None
        self._multiplexer = _MULTIPLEXER.unpack_from(data, 1)
        if specifier == _UPLOAD:
            return self._upload()
        if specifier == _DOWNLOAD:
            return self._download(command, data[4:])
        return self._abort(AbortCode.COMMAND)

    def _upload(self) -> bytes:
        value = read(self._dictionary(), *self._multiplexer)
        if isinstance(value, AbortCode):
            return self._abort(value)
        head = _UPLOAD << 5 | _SIZE_INDICATED
        if len(value) <= 4:
            return self._head(head | _EXPEDITED | (4 - len(value)) << 2) + value.ljust(4, b"\0")
        self._rest, self._toggle = value, 0
        return self._head(head) + len(value).to_bytes(4, "little")

    def _upload_segment(self, command: int) -> bytes:
        if self._rest is None:
            return self._abort(AbortCode.COMMAND)
        if command & _TOGGLE != self._toggle:
            self._rest = None
            return self._abort(AbortCode.TOGGLE)
        segment, rest = self._rest[:_SEGMENT_BYTES], self._rest[_SEGMENT_BYTES:]
        head = self._toggle | (_SEGMENT_BYTES - len(segment)) << 1 | (0 if rest else _LAST)
        self._rest, self._toggle = rest or None, self._toggle ^ _TOGGLE
        return bytes((head,)) + segment.ljust(_SEGMENT_BYTES, b"\0")

    def _download(self, command: int, data: bytes) -> bytes:
        if not command & _EXPEDITED:
            return self._abort(write(self._dictionary(), *self._multiplexer, b"") or AbortCode.COMMAND)
        length = 4 - (command >> 2 & 3) if command & _SIZE_INDICATED else 4
        refused = write(self._dictionary(), *self._multiplexer, data[:length])
        return self._head(3 << 5) + bytes(4) if refused is None else self._abort(refused)

    def _head(self, command: int) -> bytes:
        return bytes((command,)) + _MULTIPLEXER.pack(*self._multiplexer)

    def _abort(self, code: AbortCode) -> bytes:
        return _ABORT.pack(_ABORTED << 5, *self._multiplexer, code)
