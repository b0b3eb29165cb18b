"""The load of the bus by the rig's own frames, beside sums made by hand."""

from __future__ import annotations

import pytest

from hil.core.own_bus_load import own_bus_load
from hil.core.rig import Rig, read_rig
from hil.shells.run_setup import SHIPPED

SYNC_BITS, SIX_BYTES, EIGHT_BYTES, HEARTBEAT_BITS = 55, 115, 135, 65


def rig(*replaced: tuple[str, str]) -> Rig:
    text = (SHIPPED / "rig.toml").read_text()
    for old, new in replaced:
        text = text.replace(old, new)
    return read_rig(text, "rig.toml")


def heartbeats(bit_rate: int) -> float:
    per_s = 1 / (9 * 0.0112) + 2 * 3 / 0.3024
    return per_s * HEARTBEAT_BITS / bit_rate


@pytest.mark.parametrize(
    ("replaced", "bits"),
    [
        ((), SYNC_BITS + 2 * EIGHT_BYTES),
        ((("protected = true", "protected = false"),), SYNC_BITS + 2 * SIX_BYTES),
        ((("# read_back = true", "read_back = true"),), SYNC_BITS + 3 * EIGHT_BYTES),
    ],
)
def test_the_load_is_that_of_one_period_and_the_heartbeats(
    replaced: tuple[tuple[str, str], ...], bits: int
) -> None:
    expected = bits / 0.0112 / 125_000 + heartbeats(125_000)
    assert own_bus_load(rig(*replaced), 125_000) == pytest.approx(expected)


def test_two_inputs_in_one_frame_are_one_frame() -> None:
    text = "[{}]\nframe = 0x290\nbyte = 0\nbit = {}\ntimeout_s = 0.1\n\n"
    both = text.format("emergency_stop", 0) + text.format("enable", 1)
    added = own_bus_load(rig(("[axes.vertical]\n", both + "[axes.vertical]\n")), 125_000)
    assert added - own_bus_load(rig(), 125_000) == pytest.approx(EIGHT_BYTES / 0.0112 / 125_000)
