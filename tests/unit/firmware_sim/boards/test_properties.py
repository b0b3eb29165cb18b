"""Properties of the boards that hold for every sequence of frames and times."""

from __future__ import annotations

from typing import Literal

from hypothesis import given
from hypothesis import strategies as st
from support.board_bench import START, SYNC, Bench, nmt, pdo, with_dac
from support.constants import CENTRED, PERIOD_NS

from hil.core.frames import Frame

Apply = Literal["at sync", "at once"]

modes = st.sampled_from(["at sync", "at once"])
waits_ns = st.integers(0, 40 * PERIOD_NS) | st.just(0)
counters = st.integers(0, 255)
counts = st.tuples(*[st.integers(0, 32767)] * 3)
bodies = st.binary(max_size=8)

good_commands = st.builds(lambda c, n: pdo(0x220, c, n), counts, counters)
commands_of_the_nmt = st.builds(
    nmt, st.sampled_from([1, 1, 1, 2, 128, 129, 130, 7]), st.sampled_from([0, 0x20])
)
identifiers = st.sampled_from([0x000, 0x080, 0x0A0, 0x190, 0x220, 0x701]) | st.integers(0, 0x7FF)
anything = st.builds(Frame, identifiers, bodies, st.booleans(), st.booleans(), st.booleans())
plain = st.builds(Frame, identifiers, bodies)
heartbeats = st.just(Frame(0x701, b"\x05"))
frames = st.one_of(st.just(SYNC), good_commands, commands_of_the_nmt, plain, anything, heartbeats)


@given(modes, st.lists(st.tuples(waits_ns, frames), max_size=40))
def test_no_frame_raises_and_valves_are_centred_unless_operational(
    mode: Apply, steps: list[tuple[int, Frame]]
) -> None:
    bench = Bench(with_dac(apply=mode))
    for wait_ns, frame in steps:
        sent = bench.wait(wait_ns) + bench.give(frame)
        assert bench.rig.next_deadline_ns >= bench.now_ns
        assert all(answer.id in (0x090, 0x0A0, 0x190, 0x710, 0x720) for answer in sent)
        if bench.rig.dac.state != 5:
            assert bench.valve_v == CENTRED
        held_v = bench.plant.held[-1][1] if bench.plant.held else CENTRED
        assert all(0.0 <= volts < 10.0 for volts in held_v)


@given(modes, st.lists(st.tuples(waits_ns, st.one_of(frames, st.just(nmt(START)))), max_size=30))
def test_the_same_calls_give_the_same_frames(mode: Apply, steps: list[tuple[int, Frame]]) -> None:
    one, other = Bench(with_dac(apply=mode)), Bench(with_dac(apply=mode))
    for wait_ns, frame in steps:
        assert one.wait(wait_ns) == other.wait(wait_ns)
        assert one.give(frame) == other.give(frame)
    assert one.plant.held == other.plant.held


below_centre = st.tuples(*[st.integers(0, 16383)] * 3)
above_centre = st.tuples(*[st.integers(16384 + 8, 32767)] * 3)


@given(
    modes,
    st.lists(
        st.tuples(
            st.integers(0, 2 * PERIOD_NS),
            st.booleans(),
            below_centre,
            above_centre,
            counters,
            st.integers(1, 255),
        ),
        max_size=30,
    ),
)
def test_no_voltage_of_a_command_with_a_bad_crc_is_ever_applied(
    mode: Apply,
    steps: list[tuple[int, bool, tuple[int, int, int], tuple[int, int, int], int, int]],
) -> None:
    bench = Bench(with_dac(apply=mode)).started()
    for wait_ns, is_good, good, bad, counter, flip in steps:
        bench.wait(wait_ns)
        if is_good:
            bench.give(pdo(0x220, good, counter))
        else:
            data = pdo(0x220, bad, counter).data
            bench.give(Frame(0x220, data[:7] + bytes((data[7] ^ flip,))))
        bench.give(SYNC)
        assert max(bench.valve_v) <= 5.0


@given(st.integers(1, 50), st.lists(st.integers(0, 3 * PERIOD_NS), min_size=1, max_size=30))
def test_the_watchdog_acts_after_its_periods_to_the_nanosecond(periods: int, gaps_ns: list[int]) -> None:
    bench = Bench(with_dac(apply="at once", watchdog_timeout_s=periods * 0.0112)).started()
    limit_ns = periods * PERIOD_NS
    bench.command(2.5, 2.5, 2.5)
    for gap_ns in gaps_ns:
        bench.wait(gap_ns)
        assert (bench.valve_v == CENTRED) == (gap_ns >= limit_ns)
        bench.command(2.5, 2.5, 2.5)
    bench.wait(limit_ns - 1)
    assert bench.valve_v == (2.5, 2.5, 2.5)
    bench.wait(1)
    assert bench.valve_v == CENTRED
