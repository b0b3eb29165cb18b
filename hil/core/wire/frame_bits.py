"""The number of bits that a classic CAN frame takes on the wire (ISO 11898-1), stuff bits included.

After five equal bits the sender inserts one bit of the opposite value, from the start of frame to the end of
the CRC. The inserted bits are counted with a state machine whose state is the value and the number of the
equal bits so far. It reads eight bits at once from a table, as the CRC does.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple

from hil.core.frames import Frame

INTERMISSION_BITS: Final = 3
"""Recessive bits after each frame, before the next one may begin."""

_CRC15_POLYNOMIAL: Final = 0x4599
_CRC_BITS: Final = 15
_STANDARD_HEADER_BITS: Final = 19
"""Bits of a frame with an 11-bit identifier before its data."""
_BITS_AFTER_CRC: Final = 10 + INTERMISSION_BITS
"""Bits that are never stuffed: CRC delimiter, acknowledgement and its delimiter, end of frame (7), and the
intermission (3) before the next frame."""
_MAX_EQUAL_BITS: Final = 5
_CACHED_HEADERS: Final = 4096


def bits_on_wire(frame: Frame) -> int:
    """Return the length of ``frame`` in bits, with stuff bits and the intermission that follows it.

    A remote frame has no data bits, whatever length it asks for. An error frame of SocketCAN is a report of
    the host's controller. It has no length of its own; 0 is returned.
    """
    identifier, data, is_extended, is_remote, is_error = frame
    if is_error:
        return 0
    bits, state, crc = _header(identifier, is_extended, is_remote, len(data))
    if not is_remote:
        stuff, table = _STUFFING_8, _CRC_TABLE
        bits += 8 * len(data)
        for byte in data:
            state = stuff[state & _STATE_MASK | byte] + (state & _COUNT_MASK)
            crc = table[crc >> 7 ^ byte] ^ crc << 8 & 0x7FFF
    state = _STUFFING_8[state & _STATE_MASK | crc >> 7] + (state & _COUNT_MASK)
    state = _STUFFING_7[state & _STATE_MASK | crc & 0x7F] + (state & _COUNT_MASK)
    return bits + (state >> _COUNT_SHIFT) + _CRC_BITS + _BITS_AFTER_CRC


def max_bits_on_wire(length: int) -> int:
    """Return the largest number of bits of a data frame with an 11-bit identifier and ``length`` data bytes.

    Stuff bits and the intermission are included. Of the n bits that can be stuffed, at most (n - 1) // 4 are
    followed by a stuff bit (Davis et al., Controller Area Network (CAN) schedulability analysis, Real-Time
    Systems 35, 2007).
    """
    stuffable = _STANDARD_HEADER_BITS + 8 * length + _CRC_BITS
    return stuffable + (stuffable - 1) // 4 + _BITS_AFTER_CRC


_STATE_MASK: Final = 0x700
"""Bits of a state that hold value and number of the equal bits so far; the byte to read is added below."""
_COUNT_SHIFT: Final = 11
"""Place of the number of stuff bits so far, above value and number of the equal bits."""
_COUNT_MASK: Final = -1 << _COUNT_SHIFT


class _Header(NamedTuple):
    """The part of a frame before its data."""

    bits: int
    state: int
    """State of the stuffing after it, with the number of stuff bits."""
    crc: int


@lru_cache(maxsize=_CACHED_HEADERS)
def _header(identifier: int, is_extended: bool, is_remote: bool, length: int) -> _Header:
    remote = "1" if is_remote else "0"
    if is_extended:
        # Start of frame, identifier 28 to 18, SRR, IDE, identifier 17 to 0, RTR, r1, r0, length.
        text = f"0{identifier >> 18:011b}11{identifier & 0x3FFFF:018b}{remote}00{length:04b}"
    else:
        text = f"0{identifier:011b}{remote}00{length:04b}"  # start of frame, identifier, RTR, IDE, r0, length
    value, equal, inserted, crc = 1, 0, 0, 0
    for letter in text:
        bit = int(letter)
        value, equal, is_inserted = _stuff(value, equal, bit)
        inserted += is_inserted
        crc = _crc_of_bit(crc, bit)
    return _Header(len(text), _state(value, equal, inserted), crc)


def _stuff(value: int, equal: int, bit: int) -> tuple[int, int, bool]:
    """Take one bit after ``equal`` bits of ``value``. Return both anew, and whether a bit is inserted."""
    equal = equal + 1 if bit == value else 1
    if equal == _MAX_EQUAL_BITS:
        return 1 - bit, 1, True
    return bit, equal, False


def _state(value: int, equal: int, inserted: int) -> int:
    return inserted << _COUNT_SHIFT | (value << 2 | equal - 1) << 8


def _stuffing_table(width: int) -> tuple[int, ...]:
    """Return the state after ``width`` bits, by the state before them (without its count) and the bits."""
    table = []
    for before in range(8):
        for bits in range(256):
            value, equal, inserted = before >> 2, (before & 3) + 1, 0
            for place in reversed(range(width)):
                value, equal, is_inserted = _stuff(value, equal, bits >> place & 1)
                inserted += is_inserted
            table.append(_state(value, equal, inserted))
    return tuple(table)


def _crc_of_bit(crc: int, bit: int) -> int:
    is_set = bool(bit) != bool(crc & 0x4000)
    crc = crc << 1 & 0x7FFF
    return crc ^ _CRC15_POLYNOMIAL if is_set else crc


def _crc_of_byte(byte: int) -> int:
    crc = 0
    for place in reversed(range(8)):
        crc = _crc_of_bit(crc, byte >> place & 1)
    return crc


_STUFFING_8: Final = _stuffing_table(8)
_STUFFING_7: Final = _stuffing_table(7)
_CRC_TABLE: Final = tuple(_crc_of_byte(byte) for byte in range(256))
