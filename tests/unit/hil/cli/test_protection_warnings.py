"""Warnings of the protection that the rig file of a real arm does not have."""

from __future__ import annotations

from dataclasses import replace

import pytest
from support.protected_rigs import protected_rig

from hil.cli.confirmation import protection_warnings
from hil.shells.run_setup import load_setup


@pytest.mark.parametrize(
    ("bus", "is_warned"),
    [("can0", True), ("slcan:/dev/ttyACM0", True), ("sim", False), ("vcan0", False), ("udp:4711", False)],
)
def test_only_a_real_arm_without_an_emergency_stop_is_warned_of(bus: str, is_warned: bool) -> None:
    setup = load_setup(None, {}, {})
    texts = [entry.text for entry in protection_warnings(setup, bus)]
    assert [text[:53] for text in texts] == [
        "the rig file has no emergency stop (rig: emergency_st"
    ] * is_warned
    assert protection_warnings(replace(setup, rig=protected_rig()), bus) == []
