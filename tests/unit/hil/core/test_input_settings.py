"""Digital inputs in the rig file: what is read, and what is refused with name, value, limit and remedy."""

from __future__ import annotations

import pytest
from support.gateway_bench import rig_text
from support.protected_rigs import EMERGENCY_STOP, ENABLE, protected_rig

from hil.core.board_watch import ADC_NODE, DAC_NODE
from hil.core.error_query import SDO_ANSWER, SDO_REQUEST
from hil.core.errors import DocumentError
from hil.core.foreign_frames import COMMANDS_TO_BOARDS
from hil.core.input_settings import RESERVED_IDENTIFIERS, InputSettings
from hil.core.rig import read_rig
from hil.core.wire import codec


def refusal(tables: str) -> str:
    with pytest.raises(DocumentError) as caught:
        read_rig(rig_text() + tables, "my.toml")
    return str(caught.value)


def test_the_reserved_identifiers_are_those_of_all_other_frames() -> None:
    named = {name: value for name, value in vars(codec).items() if f"{name}_LENGTH" in vars(codec)}
    sdo = {base + node for base in (SDO_REQUEST, SDO_ANSWER) for node in (ADC_NODE, DAC_NODE)}
    expected = set(named.values()) - {codec.TPDO2_ADC} | sdo | set(COMMANDS_TO_BOARDS)
    assert set(RESERVED_IDENTIFIERS) == expected
    for name, identifier in named.items():
        assert RESERVED_IDENTIFIERS.get(identifier, name) == name
    for identifier, what in COMMANDS_TO_BOARDS.items():
        assert RESERVED_IDENTIFIERS[identifier] == what


def test_a_rig_file_needs_no_input_and_no_read_back() -> None:
    rig = read_rig(rig_text(), "my.toml")
    assert rig.inputs == {}
    assert rig.emergency_stop is rig.enable is None
    assert not rig.dac.read_back


def test_an_input_is_read_with_its_frame_bit_and_timeout() -> None:
    rig = protected_rig(EMERGENCY_STOP + "protected = false\n")
    assert rig.emergency_stop == InputSettings(frame=0x290, byte=0, bit=0, timeout_s=0.05, protected=False)
    assert list(protected_rig(ENABLE + EMERGENCY_STOP).inputs) == ["emergency_stop", "enable"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("0x290", "0", "emergency_stop.frame is 0, but must be at least 1"),
        ("0x290", "0x800", "emergency_stop.frame is 2048, but must be at most 2047"),
        ("byte = 0", "byte = 8", "emergency_stop.byte is 8, but must be at most 7"),
        ("bit = 0", "bit = 8", "emergency_stop.bit is 8, but must be at most 7"),
        ("0.05", "1.5", "emergency_stop.timeout_s is 1.5, but must be at most 1.0"),
        ("0.05", "0.0", "emergency_stop.timeout_s is 0.0, but must be at least 0.001"),
        ("byte = 0", "byte = -1", "emergency_stop.byte is -1, but must be at least 0"),
        ("bit = 0\n", "", "emergency_stop: missing key bit"),
        ("0x290", "0x610", "emergency_stop.frame: 0x610 is the identifier of SDO to the ADC board; use"),
        ("0x290", "0x5A0", "emergency_stop.frame: 0x5A0 is the identifier of SDO of the DAC board; use"),
        (
            "0x290",
            "0x190",
            "emergency_stop.frame: 0x190 is the identifier of TPDO1_ADC; use that of the frame with the "
            "digital inputs, such as 0x290",
        ),
        ("0x290", "0x620", "emergency_stop.frame: 0x620 is the identifier of SDO to the DAC board; use"),
        ("0x290", "0x590", "emergency_stop.frame: 0x590 is the identifier of SDO of the ADC board; use"),
        ("0x290", "0x080", "emergency_stop.frame: 0x080 is the identifier of SYNC; use"),
        (
            "byte = 0",
            "byte = 6",
            "emergency_stop.byte: 6 exceeds 5, because the last two of at most 8 bytes are counter and CRC; "
            "reduce it, or write protected = false for a module that has none",
        ),
    ],
)
def test_an_input_that_cannot_be_is_refused(old: str, new: str, said: str) -> None:
    assert refusal(EMERGENCY_STOP.replace(old, new)).startswith(f"my.toml: {said}")


def test_the_last_byte_of_an_unprotected_frame_can_be_used() -> None:
    table = EMERGENCY_STOP.replace("byte = 0", "byte = 7") + "protected = false\n"
    assert protected_rig(table).inputs["emergency_stop"].byte == 7


def test_the_last_byte_before_counter_and_crc_can_be_used() -> None:
    table = EMERGENCY_STOP.replace("byte = 0", "byte = 5")
    assert protected_rig(table).inputs["emergency_stop"].byte == 5


def test_two_contacts_need_two_bits() -> None:
    assert refusal(EMERGENCY_STOP + ENABLE.replace("bit = 1", "bit = 0")) == (
        "my.toml: enable: bit 0 of byte 0 of frame 0x290 is taken by emergency_stop; each contact needs a "
        "bit of its own"
    )


def test_two_contacts_of_one_frame_agree_on_its_protection() -> None:
    assert refusal(EMERGENCY_STOP + ENABLE + "protected = false\n") == (
        "my.toml: enable.protected: frame 0x290 is the same as that of emergency_stop, so both tables need "
        "the same value"
    )


def test_contacts_in_different_frames_do_not_meet() -> None:
    other = ENABLE.replace("0x290", "0x291").replace("bit = 1", "bit = 0") + "protected = false\n"
    assert len(protected_rig(EMERGENCY_STOP + other).inputs) == 2


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("read_back_tolerance_v = 0.001", "dac.read_back_tolerance_v is 0.001, but must be at least 0.005"),
        ("read_back_tolerance_v = 6.0", "dac.read_back_tolerance_v is 6.0, but must be at most 5.0"),
        ("read_back_periods = 0", "dac.read_back_periods is 0, but must be at least 1"),
    ],
)
def test_limits_of_the_read_back_are_checked(line: str, said: str) -> None:
    with pytest.raises(DocumentError) as caught:
        read_rig(rig_text({"dac.protected": f"true\n{line}"}), "my.toml")
    assert str(caught.value) == f"my.toml: {said}"


def test_the_settings_of_an_input_cannot_be_changed() -> None:
    settings = protected_rig(EMERGENCY_STOP).inputs["emergency_stop"]
    with pytest.raises(AttributeError):
        settings.timeout_s = 1.0  # type: ignore[misc]
