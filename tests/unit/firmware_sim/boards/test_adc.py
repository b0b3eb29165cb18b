"""The potentiometer board: samples in answer to SYNC."""

from __future__ import annotations

import msgspec
from support.board_bench import RESET_NODE, RIG, START, STOP, SYNC, Bench, decoded, emergency, nmt

from hil.core.frames import Frame


def test_sync_is_answered_only_in_state_operational() -> None:
    bench = Bench()
    assert bench.give(SYNC) == []
    bench.give(nmt(START))
    assert [frame.id for frame in bench.give(SYNC)] == [0x190]
    bench.give(nmt(STOP))
    assert bench.give(SYNC) == []


def test_samples_are_left_adjusted_12_bit_codes() -> None:
    bench = Bench().started()
    bench.plant.volts = [0.0, 5.0, 10.0]
    (frame,) = bench.give(SYNC)
    assert decoded(frame) == ((0, 2048 << 3, 4095 << 3), 0)


def test_the_constructor_sets_the_resolution() -> None:
    bench = Bench(resolution_bits=15).started()
    bench.plant.volts = [10.0 / 32768, 5.0, 10.0]
    (frame,) = bench.give(SYNC)
    assert decoded(frame).counts == (1, 16384, 32767)


def test_the_counter_rolls_over_and_restarts_after_a_reset() -> None:
    bench = Bench().started()
    counters = [bench.give(SYNC)[0].data[6] for _ in range(258)]
    assert counters == [*range(256), 0, 1]
    bench.give(nmt(RESET_NODE))
    bench.give(nmt(START))
    assert bench.give(SYNC)[0].data[6] == 0


def test_unprotected_samples_are_six_bytes() -> None:
    rig = msgspec.structs.replace(RIG, adc=msgspec.structs.replace(RIG.adc, protected=False))
    (frame,) = Bench(rig).started().give(SYNC)
    assert decoded(frame, protected=False).counts == (16384, 16384, 16384)


def test_a_sync_with_data_is_rejected_with_emcy_8240_until_a_valid_one_arrives() -> None:
    bench = Bench().started()
    refusals = bench.give(Frame(0x080, b"\x01"))
    assert [emergency(frame) for frame in refusals] == [(0x10, 0x8240, 0x11), (0x20, 0x8240, 0x11)]
    assert bench.give(Frame(0x080, b"\x02")) == []
    sample, *recoveries = bench.give(SYNC)
    assert sample.id == 0x190
    assert [emergency(frame) for frame in recoveries] == [(0x10, 0, 0), (0x20, 0, 0)]
