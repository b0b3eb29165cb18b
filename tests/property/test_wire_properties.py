"""The codec against cantools: every message of arm.dbc, every signal over its whole range, both ways."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.wire import codec
from hil.core.wire.crc8 import crc8_j1850

DATABASE: Any = cantools.database.load_file(str(Path(codec.__file__).with_name("arm.dbc")))
MESSAGES = [message for message in DATABASE.messages if message.signals]
each_message = pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.name)


def snake(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def decode(message: Any, data: bytes) -> dict[str, float]:
    fields: Any = getattr(codec, f"decode_{message.name.lower()}")(data)
    return dict(fields._asdict())


def encode(message: Any, values: dict[str, float]) -> bytes:
    return bytes(getattr(codec, f"encode_{message.name.lower()}")(**values))


def raw_range(signal: Any) -> tuple[int, int]:
    span: int = 1 << signal.length
    return (-span // 2, span // 2 - 1) if signal.is_signed else (0, span - 1)


def raw_values(message: Any) -> st.SearchStrategy[dict[str, int]]:
    """Every signal over all that its bits can hold, limits included."""
    return st.fixed_dictionaries(
        {
            signal.name: st.integers(*raw_range(signal)) | st.sampled_from(raw_range(signal))
            for signal in message.signals
        }
    )


@each_message
def test_all_signals_and_no_others_are_decoded(message: Any) -> None:
    assert set(decode(message, bytes(message.length))) == {snake(signal.name) for signal in message.signals}


@each_message
@given(st.data())
def test_any_bytes_decode_alike(message: Any, data: st.DataObject) -> None:
    payload = data.draw(st.binary(min_size=message.length, max_size=message.length))
    theirs = message.decode(payload, decode_choices=False)
    assert decode(message, payload) == {snake(name): value for name, value in theirs.items()}


@each_message
@given(st.data())
def test_any_values_encode_alike(message: Any, data: st.DataObject) -> None:
    raw = data.draw(raw_values(message))
    physical = {signal.name: raw[signal.name] * signal.scale for signal in message.signals}
    theirs = message.encode(physical, strict=False)
    ours = encode(message, {snake(name): value for name, value in physical.items()})
    assert ours == theirs
    assert decode(message, ours) == {snake(name): value for name, value in physical.items()}


@each_message
@given(st.data())
def test_values_between_counts_are_rounded_alike(message: Any, data: st.DataObject) -> None:
    analogue = [signal for signal in message.signals if signal.scale != 1]
    physical: dict[str, float] = {signal.name: 0 for signal in message.signals}
    for signal in analogue:
        physical[signal.name] = data.draw(st.floats(float(signal.minimum), float(signal.maximum)))
    ours = encode(message, {snake(name): value for name, value in physical.items()})
    assert ours == message.encode(physical)
    decoded = decode(message, ours)
    for signal in analogue:
        assert abs(decoded[snake(signal.name)] - physical[signal.name]) <= signal.scale / 2


@each_message
@given(st.data())
def test_another_length_is_an_error(message: Any, data: st.DataObject) -> None:
    length = data.draw(st.integers(0, 12).filter(lambda n: n != message.length))
    with pytest.raises(struct.error):
        decode(message, bytes(length))


def remainder_of_long_division(data: bytes) -> int:
    """CRC-8 SAE J1850 by polynomial division over GF(2): no table, no byte-wise register."""
    bits = [int(bit) for byte in data for bit in f"{byte:08b}"] + [0] * 8
    for place in range(8):
        bits[place] ^= 1  # the initial value 0xFF
    for place in range(len(bits) - 8):
        if bits[place]:
            for offset, coefficient in enumerate("100011101"):  # x^8 + x^4 + x^3 + x^2 + 1
                bits[place + offset] ^= int(coefficient)
    return int("".join(map(str, bits[-8:])), 2) ^ 0xFF


@given(st.binary(min_size=1, max_size=16))
def test_the_crc_is_the_remainder_of_long_division(data: bytes) -> None:
    assert crc8_j1850(data) == remainder_of_long_division(data)


@given(st.binary(min_size=7, max_size=7), st.sets(st.integers(0, 63), min_size=1, max_size=3))
def test_up_to_three_wrong_bits_in_a_frame_are_noticed(data: bytes, places: set[int]) -> None:
    """Hamming distance 4 up to 119 bits (Koopman and Chakravarty, 2004)."""
    frame = bytearray(data + bytes((crc8_j1850(data),)))
    for place in places:
        frame[place // 8] ^= 1 << place % 8
    assert crc8_j1850(bytes(frame[:7])) != frame[7]


@given(st.binary(min_size=7, max_size=7), st.integers(1, 255), st.integers(0, 56))
def test_a_burst_of_up_to_eight_bits_is_noticed(data: bytes, burst: int, place: int) -> None:
    frame = int.from_bytes(data + bytes((crc8_j1850(data),)), "big") ^ burst << place
    wrong = frame.to_bytes(8, "big")
    assert crc8_j1850(wrong[:7]) != wrong[7]
