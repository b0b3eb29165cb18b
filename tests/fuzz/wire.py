"""The frames of the bus, built and decoded by hand. This module is the only place that knows their layout.

It shares no code with the gateway and none with the simulated boards.
"""

from __future__ import annotations

from collections.abc import Sequence

NMT, SYNC, ADC_EMERGENCY, DAC_EMERGENCY = 0x000, 0x080, 0x090, 0x0A0
SAMPLE, READ_BACK, COMMAND, INPUTS = 0x190, 0x1A0, 0x220, 0x290
GATEWAY_HEARTBEAT, ADC_HEARTBEAT, DAC_HEARTBEAT = 0x701, 0x710, 0x720
OPERATIONAL = 5

OF_THE_GATEWAY = frozenset({NMT, SYNC, COMMAND, GATEWAY_HEARTBEAT})
"""Identifiers that only the gateway may send."""
COMMANDS_TO_BOARDS = frozenset({0x320, 0x420, 0x520, 0x610, 0x620})
"""Further identifiers that move a valve or change a board: RPDO2 to 4 of node 0x20, SDO to both boards."""

CHANNELS = 3
COUNT_V = 10.0 / 32768
"""Voltage of one count, in volts."""
CENTRE_COUNTS = 16384
"""5 V, the voltage of a channel without an axis."""


def checksum(identifier: int, data: bytes, version: int) -> int:
    """Return the CRC-8 SAE J1850 of ``data``. In version 2 of the wire, the identifier stands before them."""
    remainder = 0xFF
    for byte in data if version == 1 else identifier.to_bytes(2, "little") + data:
        remainder = _REMAINDERS[remainder ^ byte]
    return remainder ^ 0xFF


def _remainder(byte: int) -> int:
    """Return ``byte`` times x^8 modulo x^8 + x^4 + x^3 + x^2 + 1, bit by bit."""
    for _ in range(8):
        byte = (byte << 1 & 0xFF) ^ (0x1D if byte & 0x80 else 0)
    return byte


_REMAINDERS = bytes(map(_remainder, range(256)))


def is_intact(identifier: int, data: bytes, version: int) -> bool:
    """Return whether the last byte of a protected frame is its checksum."""
    return len(data) > 0 and checksum(identifier, data[:-1], version) == data[-1]


def counter_of(data: bytes) -> int:
    """Return the counter of a protected frame."""
    return data[-2]


def protect(identifier: int, data: bytes, counter: int, version: int) -> bytes:
    """Return ``data`` with a counter and a checksum."""
    counted = data + bytes((counter & 0xFF,))
    return counted + bytes((checksum(identifier, counted, version),))


def analogue(counts: Sequence[int]) -> bytes:
    """Return the data of three analogue channels in counts, without protection."""
    return b"".join(count.to_bytes(2, "little", signed=True) for count in counts)


def counts_of(data: bytes) -> tuple[int, int, int]:
    """Return the three analogue channels of a frame in counts."""
    first, second, third = (int.from_bytes(data[at : at + 2], "little", signed=True) for at in (0, 2, 4))
    return first, second, third


def length(channels_length: int, is_protected: bool) -> int:
    """Return the length of a frame in bytes, with counter and checksum if it is protected."""
    return channels_length + (2 if is_protected else 0)


ANALOGUE_LENGTH = 6
INPUTS_LENGTH = 1
