"""The length of frames on the wire, beside a second implementation and limits from the standard."""

import random

import pytest

from hil.core.frames import Frame
from hil.core.wire.frame_bits import bits_on_wire, max_bits_on_wire

SHORTEST_STANDARD, SHORTEST_EXTENDED = 47, 67
"""Bits of a frame without data and stuff bits, with the intermission (ISO 11898-1)."""

CAN_UTILS = {
    "000#": 53,
    "7FF#": 50,
    "080#": 51,
    "000#0100": 68,
    "190#00400041004217A5": 120,
    "220#0000000000000000": 125,
    "555#AAAAAAAAAAAAAAAA": 112,
    "7FF#FFFFFFFFFFFFFFFF": 126,
    "078#3C3C3C3C3C3C3C3C": 131,
    "710#05": 58,
    "321#R": 49,
    "00000000#": 74,
    "1FFFFFFF#": 74,
    "1ABCDEF0#F8F9FAFBFCFDFEFF": 142,
    "00123456#0000000000000000": 145,
    "1E0F83C1#0F0F0F0F0F": 112,
    "12345678#R": 69,
}
"""Frames in the notation of candump, and their lengths as can-utils computes them (``canbusload -e``)."""


def read(text: str) -> Frame:
    """Return the frame that candump shows as ``text``."""
    identifier, _, data = text.partition("#")
    is_remote = data == "R"
    content = b"" if is_remote else bytes.fromhex(data)
    return Frame(int(identifier, 16), content, len(identifier) == 8, is_remote)


@pytest.mark.parametrize("text", CAN_UTILS)
def test_the_length_is_that_of_can_utils(text: str) -> None:
    assert bits_on_wire(read(text)) == CAN_UTILS[text]


def remainder(bits: list[int]) -> list[int]:
    """Return the remainder of a polynomial division over GF(2) by x^15+x^14+x^10+x^8+x^7+x^4+x^3+1."""
    generator = [int(bit) for bit in "1100010110011001"]
    rest = [*bits, *[0] * 15]
    for place in range(len(bits)):
        if rest[place]:
            for offset, bit in enumerate(generator):
                rest[place + offset] ^= bit
    return rest[-15:]


def reference_bits(frame: Frame) -> int:
    """Return the length by bit lists, division and string replacement."""
    if frame.is_extended:
        numbers = [(0, 1), (frame.id >> 18, 11), (3, 2), (frame.id % 2**18, 18), (frame.is_remote, 1), (0, 2)]
    else:
        numbers = [(0, 1), (frame.id, 11), (frame.is_remote, 1), (0, 2)]
    numbers += [(len(frame.data), 4), *((byte, 8) for byte in frame.data if not frame.is_remote)]
    bits = [int(bit) for value, width in numbers for bit in format(int(value), f"0{width}b")]
    bits += remainder(bits)
    stuffed: list[int] = []
    for bit in bits:
        stuffed.append(bit)
        if len(stuffed) >= 5 and len(set(stuffed[-5:])) == 1:
            stuffed.append(1 - bit)
    return len(stuffed) + 13


def test_zeros_have_a_stuff_bit_after_each_five() -> None:
    """Identifier 0 without data: 34 zeros, CRC included, since the CRC of zeros is 0."""
    assert bits_on_wire(Frame(0)) == SHORTEST_STANDARD + 6


@pytest.mark.parametrize("seed", range(50))
def test_the_length_agrees_with_a_second_implementation(seed: int) -> None:
    source = random.Random(seed)
    is_extended = source.random() < 0.5
    data = bytes(source.choice((0, 0xFF, source.randrange(256))) for _ in range(source.randrange(9)))
    frame = Frame(source.randrange(2**29 if is_extended else 2**11), data, is_extended)
    bits = bits_on_wire(frame)
    assert bits == reference_bits(frame)
    shortest = (SHORTEST_EXTENDED if is_extended else SHORTEST_STANDARD) + 8 * len(data)
    assert shortest <= bits <= shortest + (shortest - 13 - 1) // 4


@pytest.mark.parametrize("length", range(9))
def test_a_remote_frame_has_no_data_bits(length: int) -> None:
    frame = Frame(0x123, bytes(length), is_remote=True)
    assert bits_on_wire(frame) == reference_bits(frame)
    assert SHORTEST_STANDARD <= bits_on_wire(frame) <= SHORTEST_STANDARD + 8


def test_an_error_frame_of_the_controller_has_no_length() -> None:
    assert bits_on_wire(Frame(0x040, bytes(8), is_error=True)) == 0


@pytest.mark.parametrize("length", range(9))
def test_no_frame_is_longer_than_the_maximum(length: int) -> None:
    generator = random.Random(length)
    frames = [
        Frame(
            generator.choice((0, 0x0F8, 0x7FF, 0x43C)), generator.choice((b"\x00", b"\x3c", b"\xe1")) * length
        )
        for _ in range(40)
    ]
    assert (
        max(map(bits_on_wire, frames)) <= max_bits_on_wire(length) == 47 + 8 * length + (33 + 8 * length) // 4
    )
