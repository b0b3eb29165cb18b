"""The boards' codec against published checksums and against cantools with the shipped DBC."""

from __future__ import annotations

from importlib.resources import files

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.boards import codec

DATABASE = cantools.database.load_string((files("hil.core.wire") / "arm.dbc").read_text(), "dbc")

SAMPLE, COMMAND = codec.data_identity(0x190, 2), codec.data_identity(0x220, 2)
counts16 = st.integers(0, 0x7FFF)
three_counts = st.tuples(counts16, counts16, counts16)
bytes8 = st.integers(0, 0xFF)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ("313233343536373839", 0x4B),  # check value of the CRC catalogue
        # AUTOSAR, Specification of CRC Routines, 8-bit SAE J1850
        ("00000000", 0x59),
        ("F20183", 0x37),
        ("0FAA0055", 0x79),
        ("00FF5511", 0xB8),
        ("332255AABBCCDDEEFF", 0xCB),
        ("926B55", 0x8C),
        ("FFFFFFFF", 0x74),
    ],
)
def test_crc_matches_the_published_vectors(data: str, expected: int) -> None:
    assert codec.crc8(bytes.fromhex(data)) == expected


@given(three_counts, bytes8)
def test_samples_read_by_cantools(counts: tuple[int, int, int], counter: int) -> None:
    data = codec.encode_values(counts, counter, SAMPLE)
    read = DATABASE.get_message_by_name("TPDO1_ADC").decode(data)
    assert [read[f"Potentiometer{n}"] for n in (1, 2, 3)] == [c * 10 / 32768 for c in counts]
    assert read["Counter"] == counter
    assert read["Crc8"] == codec.crc8(b"\x90\x01" + data[:7])


@given(st.tuples(*[st.integers(-0x8000, 0x7FFF)] * 3), bytes8)
def test_commands_written_by_cantools(counts: tuple[int, int, int], counter: int) -> None:
    message = DATABASE.get_message_by_name("RPDO1_DAC")
    signals = {f"Valve{n}": count for n, count in enumerate(counts, 1)} | {"Counter": counter}
    body = message.encode(signals | {"Crc8": 0}, scaling=False, strict=False)[:7]
    data = message.encode(signals | {"Crc8": codec.crc8(b"\x20\x02" + body)}, scaling=False, strict=False)
    assert codec.decode_values(data, True, COMMAND) == (counts, counter)


@given(three_counts)
def test_unprotected_values_are_the_first_six_bytes(counts: tuple[int, int, int]) -> None:
    data = codec.encode_values(counts, None, COMMAND)
    assert data == codec.encode_values(counts, 0, COMMAND)[:6]
    assert codec.decode_values(data, False, COMMAND) == (counts, None)


@given(three_counts, bytes8, st.integers(0, 63))
def test_the_crc_detects_every_single_bit_error(counts: tuple[int, int, int], counter: int, bit: int) -> None:
    corrupt = bytearray(codec.encode_values(counts, counter, COMMAND))
    corrupt[bit // 8] ^= 1 << bit % 8
    with pytest.raises(codec.RejectedPdoError) as caught:
        codec.decode_values(bytes(corrupt), True, COMMAND)
    assert caught.value.reason == codec.RejectedPdoError.CRC


@pytest.mark.parametrize(("protected", "length"), [(True, 8), (False, 6)])
def test_every_other_length_is_rejected(protected: bool, length: int) -> None:
    for wrong in set(range(9)) - {length}:
        with pytest.raises(codec.RejectedPdoError) as caught:
            codec.decode_values(bytes(wrong), protected, COMMAND)
        assert caught.value.reason == codec.RejectedPdoError.LENGTH


@pytest.mark.parametrize(("board", "node"), [("ADC", codec.ADC_NODE), ("DAC", codec.DAC_NODE)])
def test_emergencies_read_by_cantools(board: str, node: int) -> None:
    message = DATABASE.get_message_by_name(f"EMCY_{board}")
    assert message.frame_id == codec.EMERGENCY_ID + node
    read = message.decode(codec.encode_emergency(0x8130, 0x11, 7, 0x01020304), decode_choices=False)
    assert read == {
        "ErrorCode": 0x8130,
        "ErrorRegister": 0x11,
        "VendorCode": 7,
        "VendorValue": 0x01020304,
    }


def test_identifiers_are_those_of_the_dbc() -> None:
    identifiers = {message.name: message.frame_id for message in DATABASE.messages}
    assert identifiers == {
        "NMT": codec.NMT_ID,
        "SYNC": codec.SYNC_ID,
        "EMCY_ADC": codec.EMERGENCY_ID + codec.ADC_NODE,
        "EMCY_DAC": codec.EMERGENCY_ID + codec.DAC_NODE,
        "TPDO1_ADC": codec.TPDO1_ID + codec.ADC_NODE,
        "TPDO1_DAC": codec.TPDO1_ID + codec.DAC_NODE,
        "TPDO2_ADC": codec.TPDO2_ID + codec.ADC_NODE,
        "RPDO1_DAC": codec.RPDO1_ID + codec.DAC_NODE,
        "HEARTBEAT_GATEWAY": codec.HEARTBEAT_ID + codec.GATEWAY_NODE,
        "HEARTBEAT_ADC": codec.HEARTBEAT_ID + codec.ADC_NODE,
        "HEARTBEAT_DAC": codec.HEARTBEAT_ID + codec.DAC_NODE,
    }


@given(st.integers(1, 15), st.floats(-20.0, 30.0))
def test_conversion_is_exact_to_half_a_code_and_limited_to_the_range(bits: int, volts: float) -> None:
    step_v = 10.0 / 2**bits
    converter = codec.Converter(bits)
    counts = converter.counts(volts)
    assert counts % (1 << (15 - bits)) == 0
    assert abs(converter.volts(counts) - min(max(volts, 0.0), 10.0 - step_v)) <= step_v / 2 * (1 + 1e-9)


@given(st.integers(1, 15), counts16)
def test_digital_to_analogue_conversion_ignores_bits_below_the_resolution(bits: int, counts: int) -> None:
    volts = codec.Converter(bits).volts(counts)
    assert 0.0 <= counts * 10 / 32768 - volts < 10.0 / 2**bits
    assert codec.Converter(bits).counts(volts) == counts >> (15 - bits) << (15 - bits)


def test_the_valve_centre_is_exact() -> None:
    converter = codec.Converter(12)
    assert converter.counts(5.0) == 2048 << 3
    assert converter.volts(2048 << 3) == 5.0
    assert converter.counts(10.0) == 4095 << 3


@pytest.mark.parametrize("bits", [0, 16])
def test_unsupported_resolutions_are_rejected(bits: int) -> None:
    with pytest.raises(ValueError, match=r"bits: \d+ is outside the supported resolutions, 1 to 15"):
        codec.Converter(bits)
