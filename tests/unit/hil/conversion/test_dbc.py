"""Signals of a DBC file, beside cantools."""

from __future__ import annotations

import random
from importlib.resources import files

import cantools
import pytest

from hil.conversion.dbc import read_dbc
from hil.core.errors import DocumentError

MIXED = """VERSION ""
BU_: GATEWAY ADC

BO_ 2364540158 FAR: 8 ADC
 SG_ Low : 3|12@1+ (0.5,-10) [0|0] "V" GATEWAY
 SG_ Signed : 16|13@1- (0.25,0) [0|0] "V" GATEWAY
 SG_ Motorola : 39|16@0- (2,1) [0|0] "" GATEWAY
 SG_ Crossing : 51|10@0+ (1,0) [0|0] "" GATEWAY
"""


@pytest.mark.parametrize("text", [(files("hil.core.wire") / "arm.dbc").read_text(), MIXED])
def test_every_signal_is_decoded_as_by_cantools(text: str) -> None:
    database = cantools.database.load_string(text)
    messages = read_dbc(text, "arm.dbc")
    chance = random.Random(1)
    assert set(messages) == {message.name for message in database.messages}
    for theirs in database.messages:
        ours = messages[theirs.name]
        assert (ours.identifier, ours.is_extended) == (theirs.frame_id, theirs.is_extended_frame)
        assert [ours.sender] == theirs.senders
        for _ in range(50):
            data = chance.randbytes(theirs.length)
            expected = theirs.decode(data, decode_choices=False)
            assert {name: signal.decode(data) for name, signal in ours.signals.items()} == expected


def test_a_frame_that_is_too_short_has_no_value() -> None:
    signals = read_dbc(MIXED, "mixed.dbc")["FAR"].signals
    assert signals["Low"].decode(b"\x01") is None
    assert signals["Low"].decode(b"\x00\x00") == -10.0
    assert signals["Motorola"].decode(bytes(5)) is None
    assert signals["Motorola"].decode(bytes(6)) == 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no message"),
        ("hello\n", "has no message"),
        ("BO_ 1 A: 8 B\n SG_ S : 0|8@1+ (x,0) [0|0] \"\" C\n", "line 2: signal S: factor or offset"),
        ("BO_ 1 A: 8 B\n SG_ S : 0|65@1+ (1,0) [0|0] \"\" C\n", "65 bits, but a frame has 64"),
        ("BO_ 1 A: 8 B\n SG_ S : 64|1@1+ (1,0) [0|0] \"\" C\n", "starts at bit 64"),
    ],
)  # fmt: skip
def test_what_is_no_dbc_file_is_refused_with_its_line(text: str, message: str) -> None:
    with pytest.raises(DocumentError, match=message):
        read_dbc(text, "my.dbc")
