"""The boards' own reading of the wire (arm.dbc, CiA 301, CiA 401): identifiers, layouts and checksum.

It is written by hand and does not share code with ``hil.core.wire``: the boards must catch a mistake made
there, and the gateway a mistake made here. Analogue values are left-adjusted INTEGER16, 10 V = 2^15.
"""

from __future__ import annotations

from struct import Struct
from typing import Final, NamedTuple

NMT_ID: Final = 0x000
SYNC_ID: Final = 0x080
EMERGENCY_ID: Final = 0x080
"""Plus the node id, like those below."""
TPDO1_ID: Final = 0x180
RPDO1_ID: Final = 0x200
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
    """A process data object that must not be used. ``reason`` is one of the class constants."""

    LENGTH: Final = 1
    CRC: Final = 2

    def __init__(self, reason: int) -> None:
        super().__init__(reason)
        self.reason = reason


class Values(NamedTuple):
    """An analogue PDO: three INTEGER16 counts, and the rolling counter (None where the PDO has none)."""

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
    """CRC-8 SAE J1850: polynomial 0x1D, initial value 0xFF, result inverted; 0x4B for ``b"123456789"``."""
    table = _CRC8
    remainder = 0xFF
    for byte in data:
        remainder = table[remainder ^ byte]
    return remainder ^ 0xFF


def encode_values(counts: tuple[int, int, int], counter: int | None) -> bytes:
    """Bytes of an analogue PDO: 8 with counter and CRC, 6 where ``counter`` is None."""
    if counter is None:
        return _VALUES.pack(*counts)
    body = _VALUES_AND_COUNTER.pack(*counts, counter)
    return body + _BYTES[crc8(body)]


_BYTES = [bytes((value,)) for value in range(256)]


def decode_values(data: bytes, protected: bool) -> Values:
    """Counts and counter of an analogue PDO. Raises RejectedPdoError for a wrong length or CRC."""
    if not protected:
        if len(data) != 6:
            raise RejectedPdoError(RejectedPdoError.LENGTH)
        return Values(_VALUES.unpack(data), None)
    if len(data) != 8:
        raise RejectedPdoError(RejectedPdoError.LENGTH)
    if crc8(data[:7]) != data[7]:
        raise RejectedPdoError(RejectedPdoError.CRC)
    first, second, third, counter = _VALUES_AND_COUNTER.unpack_from(data)
    return Values((first, second, third), counter)


def encode_emergency(
    error_code: int, error_register: int, vendor_code: int = 0, vendor_value: int = 0
) -> bytes:
    """The 8 bytes of an EMCY object (CiA 301)."""
    return _EMERGENCY.pack(error_code, error_register, vendor_code, vendor_value)


class Converter:
    """A converter of ``bits`` over 0 to 10 V: code 2^bits would be 10 V, codes travel left adjusted."""

    __slots__ = ("_codes_per_volt", "_largest_code", "_shift")

    def __init__(self, bits: int) -> None:
        if not 1 <= bits <= FULL_SCALE_BITS:
            raise ValueError(f"a converter of {bits} bits does not fit: 1 to {FULL_SCALE_BITS}")
        self._shift = FULL_SCALE_BITS - bits
        self._largest_code = (1 << bits) - 1
        self._codes_per_volt = (1 << bits) / 10.0

    def counts(self, volts: float) -> int:
        """Analogue to digital: the nearest code within the range, left adjusted."""
        code = int(volts * self._codes_per_volt + 0.5) if volts > 0.0 else 0
        return min(code, self._largest_code) << self._shift

    def volts(self, counts: int) -> float:
        """Digital to analogue: bits under the converter's resolution are ignored; ``counts`` >= 0."""
        return (counts >> self._shift << self._shift) * VOLTS_PER_COUNT
