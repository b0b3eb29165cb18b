"""Both boards with a plant between them: how the plant's time passes, and what happens when it fails."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from support.board_bench import HEARTBEAT_NS, MS, RIG, START, SYNC, Bench, HandPlant, nmt, with_dac
from support.constants import CENTRED, PERIOD_NS

from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import HilError


def test_the_plant_advances_although_no_sync_arrives() -> None:
    bench = Bench().started()
    bench.give(SYNC)
    bench.wait(10**9)
    assert bench.plant.held == [(HEARTBEAT_NS, CENTRED)] * 10


def test_the_plants_time_starts_with_the_first_sample() -> None:
    bench = Bench()
    bench.wait(10**10)
    bench.give(SYNC)  # the board is not operational and takes no sample
    bench.wait(10**9)
    bench.started().give(SYNC)
    assert bench.plant.held == []
    bench.wait(PERIOD_NS)
    bench.give(SYNC)
    assert bench.plant.held == [(PERIOD_NS, CENTRED)]


def test_the_plants_time_starts_with_a_valve_that_moves_before_the_first_sample() -> None:
    bench = Bench(with_dac(apply="at once")).started()
    bench.command(6.25, 5.0, 5.0)
    bench.wait(MS)
    bench.command(5.0, 5.0, 5.0)
    assert bench.plant.held == [(MS, (6.25, 5.0, 5.0))]


def test_the_plant_does_not_advance_when_time_stands_still_or_goes_back() -> None:
    bench = Bench().started()
    bench.give(SYNC)
    bench.now_ns -= 5 * MS
    bench.give(SYNC)
    assert bench.plant.held == []


def test_the_rig_raises_the_error_of_a_plant_that_fails() -> None:
    class Diverging(HandPlant):
        def advance(self, duration_ns: int, valve_v: Sequence[float]) -> None:
            raise HilError("vertical: position 3.2 m exceeds 0.15 m")

    rig = SimulatedRig(RIG, Diverging())
    rig.start(0)
    rig.receive(nmt(START), 0)
    rig.receive(SYNC, 0)
    with pytest.raises(HilError, match="exceeds"):
        rig.receive(SYNC, PERIOD_NS)
