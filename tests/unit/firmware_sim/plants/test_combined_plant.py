"""Several plants behind the same boards."""

from __future__ import annotations

import pytest
from support.board_bench import HandPlant

from firmware_sim.plants.combined_plant import CombinedPlant


def test_each_channel_reads_the_plant_that_uses_it() -> None:
    first, second = HandPlant(), HandPlant()
    first.volts, second.volts = [1.25, 0.0, 7.5], [0.0, 2.5, 0.0]
    assert list(CombinedPlant([first, second]).potentiometer_v()) == [1.25, 2.5, 7.5]


def test_every_plant_gets_all_valve_voltages() -> None:
    parts = [HandPlant(), HandPlant()]
    CombinedPlant(parts).advance(5, (1.0, 2.0, 3.0))
    assert [part.held for part in parts] == [[(5, (1.0, 2.0, 3.0))]] * 2


def test_the_error_of_a_part_is_raised() -> None:
    class Failing(HandPlant):
        def advance(self, duration_ns: int, valve_v: object) -> None:
            raise ArithmeticError

    with pytest.raises(ArithmeticError):
        CombinedPlant([HandPlant(), Failing()]).advance(1, (5.0, 5.0, 5.0))
