"""CRC-8 of SAE J1850: polynomial 0x1D, initial value 0xFF, final exclusive or with 0xFF."""

from __future__ import annotations

START = 0xFF
"""Register before the first byte."""


def _table() -> bytes:
    entries = []
    for byte in range(256):
        register = byte
        for _ in range(8):
            register = (register << 1) ^ (0x1D if register & 0x80 else 0)
        entries.append(register & 0xFF)
    return bytes(entries)


_TABLE = _table()


def crc8_register(data: bytes, start: int = START) -> int:
    """Return the register after ``data``. ``start`` is the register after the bytes before them."""
    register = start
    for byte in data:
        register = _TABLE[register ^ byte]
    return register


def crc8_j1850(data: bytes, start: int = START) -> int:
    """Return the CRC of ``data``. The check value, for ``b"123456789"``, is 0x4B.

    ``start`` is the register after bytes before ``data`` that the CRC covers too (:func:`crc8_register`).
    """
    register = start
    for byte in data:
        register = _TABLE[register ^ byte]
    return register ^ 0xFF
