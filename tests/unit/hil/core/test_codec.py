"""The codec is compiled from arm.dbc; the checksum is that of SAE J1850."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import cantools
import pytest

from hil.core.board_watch import EMERGENCIES
from hil.core.wire import codec
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
