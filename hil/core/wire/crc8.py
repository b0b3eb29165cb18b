"""CRC-8 of SAE J1850: polynomial 0x1D, initial value 0xFF, final exclusive or with 0xFF."""

from __future__ import annotations


def _table() -> bytes:
    entries = []
    for byte in range(256):
        register = byte
        for _ in range(8):
            register = (register << 1) ^ (0x1D if register & 0x80 else 0)
        entries.append(register & 0xFF)
    return bytes(entries)


_TABLE = _table()


def crc8_j1850(data: bytes) -> int:
    """Return the CRC of ``data``. The check value, for ``b"123456789"``, is 0x4B."""
    register = 0xFF
    for byte in data:
        register = _TABLE[register ^ byte]
    return register ^ 0xFF
