"""The codec is compiled from arm.dbc; the checksum is that of SAE J1850."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

import cantools
import pytest

from hil.core.board_watch import EMERGENCIES
from hil.core.wire import codec, crc8
from hil.core.wire.compile_dbc import compile_dbc
from hil.core.wire.crc8 import crc8_j1850

DBC = Path(codec.__file__).with_name("arm.dbc")
DATABASE: Any = cantools.database.load_file(str(DBC))


class TestCompiled:
    def test_the_codec_in_the_repository_is_the_compiled_dbc(self) -> None:
        formatted = subprocess.run(
            [sys.executable, "-m", "ruff", "format", "--stdin-filename", "hil/wire/codec.py", "-"],
            input=compile_dbc(DBC),
            capture_output=True,
            text=True,
            check=True,
            cwd=Path(codec.__file__).parents[3],
        ).stdout
        assert Path(codec.__file__).read_text() == formatted

    def test_every_message_has_its_identifier_and_length(self) -> None:
        for message in DATABASE.messages:
            assert getattr(codec, message.name) == message.frame_id
            assert getattr(codec, f"{message.name}_LENGTH") == message.length

    @pytest.mark.parametrize("message", ["RPDO1_DAC", "TPDO1_DAC"])
    def test_the_initial_value_of_a_valve_in_the_dbc_is_its_centre(self, message: str) -> None:
        signals = DATABASE.get_message_by_name(message).signals
        assert [signal.initial for signal in signals if signal.name.startswith("Valve")] == [5.0] * 3

    @pytest.mark.parametrize("name", ["EMCY_ADC", "EMCY_DAC"])
    def test_the_dbc_and_the_gateway_describe_emergencies_in_the_same_words(self, name: str) -> None:
        choices = DATABASE.get_message_by_name(name).get_signal_by_name("ErrorCode").choices
        assert {code: str(text) for code, text in choices.items()} == {0: "no error"} | EMERGENCIES

    @pytest.mark.parametrize(
        ("name", "identifier"),
        [
            ("NMT", 0x000),
            ("SYNC", 0x080),
            ("EMCY_ADC", 0x080 + 0x10),
            ("EMCY_DAC", 0x080 + 0x20),
            ("TPDO1_ADC", 0x180 + 0x10),
            ("TPDO1_DAC", 0x180 + 0x20),
            ("TPDO2_ADC", 0x280 + 0x10),
            ("RPDO1_DAC", 0x200 + 0x20),
            ("HEARTBEAT_GATEWAY", 0x700 + 0x01),
            ("HEARTBEAT_ADC", 0x700 + 0x10),
            ("HEARTBEAT_DAC", 0x700 + 0x20),
        ],
    )
    def test_identifiers_are_those_of_cia_301(self, name: str, identifier: int) -> None:
        assert getattr(codec, name) == identifier

    def test_analogue_values_are_left_adjusted_integer16_after_cia_401(self) -> None:
        data = codec.encode_rpdo1_dac(5.0, 2.5, 9.99969482421875, 1, 2)
        assert data == struct.pack("<hhhBB", 0x4000, 0x2000, 0x7FFF, 1, 2)
        assert codec.decode_tpdo1_adc(data) == (5.0, 2.5, 9.99969482421875, 1, 2)

    @pytest.mark.parametrize("volts", [10.0, -10.0002, 1e9])
    def test_a_voltage_that_a_frame_cannot_carry_is_an_error(self, volts: float) -> None:
        with pytest.raises(struct.error):
            codec.encode_rpdo1_dac(volts, 5.0, 5.0, 0, 0)

    @pytest.mark.parametrize("counter", [-1, 256])
    def test_a_counter_of_more_than_a_byte_is_an_error(self, counter: int) -> None:
        with pytest.raises(struct.error):
            codec.encode_rpdo1_dac(5.0, 5.0, 5.0, counter, 0)


SIGNAL = 'BO_ 1 M: 2 A\n SG_ First : 0|8@1+ (1,0) [0|255] "" B\n SG_ Second : {} (1,{}) [0|255] "" B\n'


@pytest.mark.parametrize(
    ("layout", "offset", "said"),
    [
        ("15|8@0+", 0, "M.Second: only whole little-endian bytes"),
        ("9|7@1+", 0, "M.Second: only whole little-endian bytes"),
        ("8|4@1+", 0, "M.Second: only whole little-endian bytes"),
        ("8|8@1+", 3, "M.Second: only whole little-endian bytes without gaps or offset"),
    ],
)
def test_a_layout_that_is_not_supported_is_refused(
    layout: str, offset: int, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "m.dbc"
    path.write_text('VERSION ""\nNS_ :\nBS_:\nBU_: A B\n' + SIGNAL.format(layout, offset))
    with pytest.raises(ValueError, match=said):
        compile_dbc(path)


def test_a_frame_longer_than_its_signals_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.dbc"
    path.write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A B\nBO_ 1 M: 3 A\n SG_ First : 0|8@1+ (1,0) [0|255] "" B\n'
    )
    with pytest.raises(ValueError, match="M: signals end at bit 8, the frame at 24"):
        compile_dbc(path)


class TestCrc8:
    @pytest.mark.parametrize(
        ("data", "crc"),
        [
            # AUTOSAR, Specification of CRC Routines, CRC-8 SAE J1850.
            ("00000000", 0x59),
            ("F20183", 0x37),
            ("0FAA0055", 0x79),
            ("00FF5511", 0xB8),
            ("332255AABBCCDDEEFF", 0xCB),
            ("926B55", 0x8C),
            ("FFFFFFFF", 0x74),
        ],
    )
    def test_autosars_vectors(self, data: str, crc: int) -> None:
        assert crc8_j1850(bytes.fromhex(data)) == crc

    def test_the_check_value(self) -> None:
        assert crc8_j1850(b"123456789") == 0x4B

    def test_the_crc_of_no_data(self) -> None:
        assert crc8_j1850(b"") == 0x00


class TestAgainstCantools:
    """Every frame, encoded and decoded by cantools from the same DBC, with another value for each signal."""

    MESSAGES: ClassVar[list[Any]] = [message for message in DATABASE.messages if message.signals]

    @staticmethod
    def values(message: Any) -> list[float]:
        """A value of each signal, in the order of the frame. All bytes of the frame differ."""
        signals = sorted(message.signals, key=lambda signal: signal.start)
        digits = iter(range(0x11, 0x80, 7))
        raw = [int.from_bytes([next(digits) for _ in range(signal.length // 8)]) for signal in signals]
        return [value * signal.scale for value, signal in zip(raw, signals, strict=True)]

    def frame(self, message: Any) -> bytes:
        signals = sorted(message.signals, key=lambda signal: signal.start)
        named = {signal.name: value for signal, value in zip(signals, self.values(message), strict=True)}
        return bytes(message.encode(named))

    @pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.name)
    def test_a_frame_is_encoded_to_the_same_bytes(self, message: Any) -> None:
        encode = getattr(codec, f"encode_{message.name.lower()}")
        assert encode(*self.values(message)) == self.frame(message)

    @pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.name)
    def test_a_frame_is_decoded_to_the_same_values(self, message: Any) -> None:
        decode = getattr(codec, f"decode_{message.name.lower()}")
        decoded = decode(self.frame(message))
        assert list(decoded) == self.values(message)
        names = [signal.name.lower() for signal in sorted(message.signals, key=lambda signal: signal.start)]
        assert [name.replace("_", "") for name in decoded._fields] == names


def remainder(byte: int) -> int:
    """The remainder of ``byte`` times x^8, divided by x^8 + x^4 + x^3 + x^2 + 1 over GF(2)."""
    rest = byte << 8
    for place in range(15, 7, -1):
        if rest >> place & 1:
            rest ^= 0x11D << place - 8
    return rest


def test_the_table_of_the_crc_holds_the_remainders_of_all_bytes() -> None:
    assert list(crc8._table()) == [remainder(byte) for byte in range(256)]


def test_a_crc_can_go_on_from_the_bytes_before() -> None:
    start = crc8.crc8_register(b"1234")
    assert crc8_j1850(b"56789", start) == 0x4B
    assert crc8.crc8_register(b"56789", start) == 0x4B ^ 0xFF
    assert crc8.crc8_register(b"") == 0xFF
