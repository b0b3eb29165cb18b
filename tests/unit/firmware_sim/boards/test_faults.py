"""Faults of the boards: what a broken board shows on the bus, and that it works again after repair."""

from __future__ import annotations

import pytest
from support.board_bench import (
    HEARTBEAT_NS,
    START,
    STOP,
    SYNC,
    Bench,
    decoded,
    emergency,
    nmt,
    with_dac,
)
from support.constants import CENTRED, PERIOD_NS

from firmware_sim.boards.codec import RejectedPdoError
from firmware_sim.boards.faults import AdcFaults, DacFaults
from hil.core.frames import Frame


def samples(bench: Bench, count: int) -> list[Frame]:
    return [frame for _ in range(count) for frame in bench.give(SYNC)]


def test_lost_samples_leave_a_gap_in_the_counter() -> None:
    bench = Bench().started()
    bench.give(SYNC)
    bench.rig.adc.faults = AdcFaults(samples_to_lose=3)
    assert [frame.data[6] for frame in samples(bench, 5)] == [4, 5]


def test_a_frozen_channel_reads_its_voltage_until_the_board_is_repaired() -> None:
    bench = Bench().started()
    bench.plant.volts = [1.25, 2.5, 5.0]
    bench.rig.adc.faults = AdcFaults(frozen_v={2: 7.5})
    (frame,) = samples(bench, 1)
    assert decoded(frame).counts == (4096, 24576, 16384)
    bench.rig.adc.faults = None
    (frame,) = samples(bench, 1)
    assert decoded(frame).counts == (4096, 8192, 16384)


def test_corrupt_crcs() -> None:
    bench = Bench().started()
    bench.rig.adc.faults = AdcFaults(crcs_to_corrupt=2)
    bad, worse, good = samples(bench, 3)
    for frame in (bad, worse):
        with pytest.raises(RejectedPdoError):
            decoded(frame)
    assert decoded(good).counter == 2


def test_repeated_counters() -> None:
    bench = Bench().started()
    bench.give(SYNC)
    bench.rig.adc.faults = AdcFaults(counters_to_repeat=2)
    assert [frame.data[6] for frame in samples(bench, 4)] == [0, 0, 1, 2]


def test_a_silent_heartbeat_on_one_board() -> None:
    bench = Bench().started()
    bench.rig.adc.faults = AdcFaults(silent_heartbeat=True)
    assert bench.wait(2 * HEARTBEAT_NS) == [Frame(0x720, b"\x05")] * 2
    assert len(samples(bench, 1)) == 1
    bench.rig.adc.faults = None
    assert bench.wait(HEARTBEAT_NS) == [Frame(0x710, b"\x05"), Frame(0x720, b"\x05")]


def test_a_hung_adc_board_is_silent_and_resumes_where_it_was() -> None:
    bench = Bench().started()
    bench.rig.adc.faults = AdcFaults(hung=True)
    assert samples(bench, 3) == []
    assert bench.give(nmt(STOP, 0x10)) == []
    assert {frame.id for frame in bench.wait(10**9)} == {0x720}
    bench.rig.adc.faults = None
    assert samples(bench, 1)[0].data[6] == 0
    assert Frame(0x710, b"\x05") in bench.wait(HEARTBEAT_NS)


def test_a_hung_dac_board_holds_its_valves_and_centres_once_it_resumes() -> None:
    bench = Bench(with_dac(apply="at once")).started()
    bench.command(6.25, 5.0, 5.0)
    bench.rig.dac.faults = DacFaults(hung=True)
    assert bench.give(nmt(STOP, 0x20)) == bench.command(7.5, 5.0, 5.0) == []
    assert {frame.id for frame in bench.wait(10**9)} == {0x710}
    assert bench.valve_v == (6.25, 5.0, 5.0)
    bench.rig.dac.faults = None
    bench.wait(HEARTBEAT_NS)
    assert bench.valve_v == CENTRED


def test_an_emergency_is_sent_once_at_the_next_sync_or_heartbeat() -> None:
    bench = Bench().started()
    bench.rig.adc.faults = AdcFaults(emergency_code=0x5000)
    bench.rig.dac.faults = DacFaults(emergency_code=0x3100)
    reported = [emergency(frame) for frame in bench.give(SYNC) if frame.id < 0x100]
    assert reported == [(0x10, 0x5000, 0x11), (0x20, 0x3100, 0x11)]
    assert [frame.id for frame in bench.give(SYNC)] == [0x190]
    bench.rig.dac.faults.emergency_code = 0x3200
    reported = [emergency(frame) for frame in bench.wait(HEARTBEAT_NS) if frame.id < 0x100]
    assert reported == [(0x20, 0x3200, 0x11)]


def test_a_frozen_valve_channel_ignores_commands() -> None:
    bench = Bench().started()
    bench.period(6.25, 5.0, 5.0)
    bench.rig.dac.faults = DacFaults(frozen_v={1: 0.0})
    bench.period(7.5, 7.5, 7.5)
    assert bench.valve_v == (0.0, 5.0, 5.0)
    bench.period(7.5, 7.5, 7.5)
    assert bench.valve_v == (0.0, 7.5, 7.5)
    bench.give(nmt(STOP))
    assert bench.valve_v == (0.0, 5.0, 5.0)
    bench.rig.dac.faults = None
    bench.give(nmt(START))
    bench.period(7.5, 7.5, 7.5)
    bench.give(SYNC)
    assert bench.valve_v == (7.5, 7.5, 7.5)
    assert bench.plant.held[-1] == (PERIOD_NS, CENTRED)
