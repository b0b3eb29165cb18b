"""Protected frames of wire version 2, made bit by bit: no code is shared with the gateway or the boards."""

from __future__ import annotations

from struct import pack

from hil.core.frames import Frame


def crc8(data: bytes) -> int:
    """CRC-8 SAE J1850, bit by bit."""
    register = 0xFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register << 1 ^ (0x11D if register & 0x80 else 0)
    return register ^ 0xFF


def frame_crc(identifier: int, data: bytes) -> int:
    """The CRC of ``data`` in a frame with ``identifier``, which it covers first, low byte before high."""
    return crc8(bytes((identifier & 0xFF, identifier >> 8)) + data)


def protected(identifier: int, data: bytes) -> Frame:
    """The frame with ``data`` and its CRC."""
    return Frame(identifier, data + bytes((frame_crc(identifier, data),)))


def pdo(identifier: int, counts: tuple[int, int, int], counter: int) -> Frame:
    """An analogue PDO: three INTEGER16, the counter and the CRC."""
    return protected(identifier, pack("<hhhB", *counts, counter))
