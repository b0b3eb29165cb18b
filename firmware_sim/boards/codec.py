"""Identifiers, frame layouts and checksum as the boards implement them (arm.dbc, CiA 301, CiA 401).

This module is written by hand and shares no code with ``hil.core.wire``. So the boards detect a mistake in
the gateway's codec, and the gateway detects a mistake here. Analogue values are left-adjusted INTEGER16: 10 V
= 2^15.
"""

from __future__ import annotations

from struct import Struct
from typing import Final, NamedTuple

NMT_ID: Final = 0x000
SYNC_ID: Final = 0x080
EMERGENCY_ID: Final = 0x080
"""Identifier of EMCY of node 0. Add the node id; the same holds for all identifiers below."""
TPDO1_ID: Final = 0x180
TPDO2_ID: Final = 0x280
RPDO1_ID: Final = 0x200
SDO_ANSWER_ID: Final = 0x580
SDO_REQUEST_ID: Final = 0x600
HEARTBEAT_ID: Final = 0x700

GATEWAY_NODE: Final = 0x01
ADC_NODE: Final = 0x10
DAC_NODE: Final = 0x20

FULL_SCALE_BITS: Final = 15
VOLTS_PER_COUNT: Final = 10.0 / (1 << FULL_SCALE_BITS)

_VALUES = Struct("<hhh")
_VALUES_AND_COUNTER = Struct("<hhhB")
_EMERGENCY = Struct("<HBBI")


class RejectedPdoError(Exception):
    """A process data object failed its check and must not be used. ``reason`` is a constant of this class."""

    LENGTH: Final = 1
    CRC: Final = 2

    def __init__(self, reason: int) -> None:
        super().__init__(reason)
        self.reason = reason


class Values(NamedTuple):
    """Content of an analogue PDO: three INTEGER16 counts and the rolling counter (None without a counter)."""

    counts: tuple[int, int, int]
    counter: int | None


def _crc8_table(polynomial: int) -> bytes:
    table = bytearray(256)
    for index in range(256):
        remainder = index
        for _ in range(8):
            remainder = (remainder << 1) ^ (polynomial if remainder & 0x80 else 0)
        table[index] = remainder & 0xFF
    return bytes(table)


_CRC8 = _crc8_table(0x1D)


def crc8(data: bytes) -> int:
    """Return the CRC-8 SAE J1850 of ``data``.

    Polynomial 0x1D, initial value 0xFF, result inverted. The check value of ``b"123456789"`` is 0x4B.
    """
    table = _CRC8
    remainder = 0xFF
    for byte in data:
        remainder = table[remainder ^ byte]
    return remainder ^ 0xFF


def data_identity(identifier: int, wire_version: int) -> bytes:
    """Return the bytes that the CRC of frames with ``identifier`` covers before the data.

    In wire version 2 they are the identifier, low byte first. In version 1 there are none.
    """
    return b"" if wire_version == 1 else bytes((identifier & 0xFF, identifier >> 8))


def encode_values(counts: tuple[int, int, int], counter: int | None, identity: bytes) -> bytes:
    """Encode an analogue PDO: 8 bytes with counter and CRC, or 6 bytes if ``counter`` is None.

    ``identity`` is the data identity of the PDO (:func:`data_identity`).
    """
    if counter is None:
        return _VALUES.pack(*counts)
    body = _VALUES_AND_COUNTER.pack(*counts, counter)
    return body + _BYTES[crc8(identity + body)]


_BYTES = [bytes((value,)) for value in range(256)]


def decode_values(data: bytes, protected: bool, identity: bytes) -> Values:
    """Decode an analogue PDO. Raises RejectedPdoError for a wrong length or a wrong CRC.

    ``identity`` is the data identity of the PDO (:func:`data_identity`).
    """
    if not protected:
        if len(data) != 6:
            raise RejectedPdoError(RejectedPdoError.LENGTH)
        return Values(_VALUES.unpack(data), None)
    if len(data) != 8:
        raise RejectedPdoError(RejectedPdoError.LENGTH)
    if crc8(identity + data[:7]) != data[7]:
        raise RejectedPdoError(RejectedPdoError.CRC)
    first, second, third, counter = _VALUES_AND_COUNTER.unpack_from(data)
    return Values((first, second, third), counter)


def encode_emergency(
    error_code: int, error_register: int, vendor_code: int = 0, vendor_value: int = 0
) -> bytes:
    """Encode an EMCY object: 8 bytes (CiA 301)."""
    return _EMERGENCY.pack(error_code, error_register, vendor_code, vendor_value)


class Converter:
    """An analogue converter with a range of 0 to 10 V and a resolution of ``bits``.

    Code 2^bits would be 10 V, so the largest code is one step below it. Frames carry codes left-adjusted, as
    counts.
    """

    __slots__ = ("_codes_per_volt", "_max_code", "_shift")

    def __init__(self, bits: int) -> None:
        if not 1 <= bits <= FULL_SCALE_BITS:
            raise ValueError(f"bits: {bits} is outside the supported resolutions, 1 to {FULL_SCALE_BITS}")
        self._shift = FULL_SCALE_BITS - bits
        self._max_code = (1 << bits) - 1
        self._codes_per_volt = (1 << bits) / 10.0

    def counts(self, volts: float) -> int:
        """Convert a voltage to counts: the nearest code, limited to the range, left-adjusted."""
        code = int(volts * self._codes_per_volt + 0.5) if volts > 0.0 else 0
        return min(code, self._max_code) << self._shift

    def volts(self, counts: int) -> float:
        """Convert counts (>= 0) to a voltage. Bits below the converter's resolution are ignored."""
        return (counts >> self._shift << self._shift) * VOLTS_PER_COUNT
