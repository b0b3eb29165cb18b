"""The number of bits that a classic CAN frame takes on the wire (ISO 11898-1), stuff bits included."""

from __future__ import annotations

from typing import Final

from hil.core.frames import Frame

_CRC15_POLYNOMIAL: Final = 0x4599
_BITS_AFTER_CRC: Final = 13
"""Bits that are never stuffed: CRC delimiter, acknowledgement and its delimiter, end of frame (7), and the
intermission (3) before the next frame."""
_EQUAL_BITS_BEFORE_STUFFING: Final = 5


def bits_on_wire(frame: Frame) -> int:
    """Return the length of ``frame`` in bits, with stuff bits and the intermission that follows it.

    An error frame of SocketCAN is a report of the host's controller. It has no length of its own; 0 is
    returned.
    """
    if frame.is_error:
        return 0
    bits = _bits_before_crc(frame)
    bits += f"{_crc15(bits):015b}"
    return len(bits) + _stuff_bits(bits) + _BITS_AFTER_CRC


def _bits_before_crc(frame: Frame) -> str:
    """Return the bits from the start of frame to the data, as a text of 0 and 1."""
    remote = "1" if frame.is_remote else "0"
    if frame.is_extended:
        # Start of frame, identifier 28 to 18, SRR, IDE, identifier 17 to 0, RTR, r1, r0.
        header = f"0{frame.id >> 18:011b}11{frame.id & 0x3FFFF:018b}{remote}00"
    else:
        header = f"0{frame.id:011b}{remote}00"  # start of frame, identifier, RTR, IDE, r0
    return f"{header}{len(frame.data):04b}" + "".join(f"{byte:08b}" for byte in frame.data)


def _crc15(bits: str) -> int:
    crc = 0
    for bit in bits:
        is_set = (bit == "1") != bool(crc & 0x4000)
        crc = (crc << 1) & 0x7FFF
        if is_set:
            crc ^= _CRC15_POLYNOMIAL
    return crc


def _stuff_bits(bits: str) -> int:
    """Return the number of stuff bits: after five equal bits, one of the opposite value is inserted."""
    inserted, last, equal = 0, "", 0
    for bit in bits:
        equal = equal + 1 if bit == last else 1
        last = bit
        if equal == _EQUAL_BITS_BEFORE_STUFFING:
            inserted += 1
            last, equal = "0" if bit == "1" else "1", 1
    return inserted
