"""What the log says about a real bus at first: the bit rate of its adapter, and missing protection."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import pytest
from support.protected_rigs import protected_rig

from hil.cli.confirmation import announce_bit_rate, bus_notes
from hil.core.rig import Bus
from hil.shells.run_setup import load_setup


@pytest.mark.parametrize(
    ("bus", "is_warned"),
    [("can0", True), ("slcan:/dev/ttyACM0", True), ("sim", False), ("vcan0", False), ("udp:4711", False)],
)
def test_only_a_real_arm_without_an_emergency_stop_is_warned_of(bus: str, is_warned: bool) -> None:
    setup = load_setup(None, {}, {})
    texts = [entry.text for entry in bus_notes(setup, bus)]
    assert [text[:53] for text in texts] == [
        "the rig file has no emergency stop (rig: emergency_st"
    ] * is_warned
    assert bus_notes(replace(setup, rig=protected_rig()), bus) == []


@pytest.mark.parametrize("bus", ["can0", "sim", "slcan:/dev/ttyACM0"])
def test_a_bit_rate_of_the_rig_file_is_named_where_it_sets_an_adapter(bus: str) -> None:
    rig = msgspec.structs.replace(protected_rig(), bus=Bus(bit_rate=250_000))
    texts = [entry.text for entry in bus_notes(replace(load_setup(None, {}, {}), rig=rig), bus)]
    assert texts == [
        "slcan:/dev/ttyACM0: the serial adapter is set to 250 kbit/s (rig: bus.bit_rate)"
    ] * bus.startswith("slcan")


@pytest.mark.parametrize(
    ("bus", "bit_rate", "is_said"),
    [
        ("slcan:/dev/ttyACM0", 250_000, True),
        ("slcan:/dev/ttyACM0", 500_000, False),
        ("slcan:/dev/ttyACM0", None, False),
        ("can0", 250_000, False),
    ],
)
def test_an_unusual_rate_is_said_before_a_serial_adapter_joins(
    bus: str, bit_rate: int | None, is_said: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    announce_bit_rate(bus, bit_rate, "my.toml")
    said = (
        "hil: slcan:/dev/ttyACM0 joins the bus at 250 kbit/s (my.toml: bus.bit_rate); all nodes must have "
        "this rate\n"
    )
    assert capsys.readouterr().err == said * is_said
