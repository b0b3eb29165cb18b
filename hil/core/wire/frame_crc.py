"""The CRC at the end of protected frames, in both versions of the wire.

In version 2 the CRC covers a data identity before the data: the frame's identifier as two bytes, low byte
first. The identity is not transmitted. A receiver computes the CRC with the identifier under which the frame
arrived, so that the data of one frame, sent under the identifier of another, have a wrong CRC. This is the
data ID of AUTOSAR E2E profile 1 (PRS_E2EProtocol, ``E2E_P01_DATAID_BOTH``).

In version 1 the CRC covers the data alone.
"""

from __future__ import annotations

from hil.core.wire.crc8 import START, crc8_j1850, crc8_register

VERSIONS = (1, 2)
"""Versions of the wire."""


class FrameCrc:
    """The CRC of the frames with one identifier, in one version of the wire."""

    def __init__(self, identifier: int, wire_version: int) -> None:
        """``identifier`` has 11 bits."""
        self._identifier = identifier
        self._version = wire_version
        self._start = _start(identifier, wire_version)

    def append(self, data: bytes) -> bytes:
        """Return ``data`` with its CRC as the last byte."""
        return data + bytes((crc8_j1850(data, self._start),))

    def is_right(self, frame_data: bytes) -> bool:
        """Return whether the last byte of a frame is the CRC of the bytes before it."""
        return crc8_j1850(frame_data[:-1], self._start) == frame_data[-1]

    def problem(self, frame_data: bytes) -> str | None:
        """Return what is wrong with the CRC of a frame, or None. ``frame_data`` is not empty.

        The text says so if the CRC is right in the other version of the wire.
        """
        received, computed = frame_data[-1], crc8_j1850(frame_data[:-1], self._start)
        if received == computed:
            return None
        other = self.other_version(frame_data)
        hint = "" if other is None else f"; {version_hint(other, self._version)}"
        return f"CRC 0x{received:02X}, computed 0x{computed:02X}{hint}"

    def other_version(self, frame_data: bytes) -> int | None:
        """Return the other version of the wire in which the CRC of a frame is right, or None."""
        for version in VERSIONS:
            if version != self._version and FrameCrc(self._identifier, version).is_right(frame_data):
                return version
        return None


def frame_crc(identifier: int, wire_version: int, *, protected: bool) -> FrameCrc | None:
    """Return the CRC of the frames with ``identifier``; None for a module without counter and CRC."""
    return FrameCrc(identifier, wire_version) if protected else None


def version_hint(sender: int, expected: int) -> str:
    """Return what to do about a sender whose CRC is right in another version of the wire."""
    return (
        f"the sender speaks wire version {sender}, the rig file says {expected}: update the board, or write "
        f"wire_version = {sender} (rig: bus.wire_version)"
    )


def _start(identifier: int, wire_version: int) -> int:
    if wire_version == 1:
        return START
    return crc8_register(identifier.to_bytes(2, "little"))
