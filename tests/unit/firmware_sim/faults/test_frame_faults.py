"""Faults of frames, on single frames."""

from __future__ import annotations

from random import Random

import pytest
from support.board_bench import decoded, pdo

from firmware_sim.faults.fault_text import parse_fault
from firmware_sim.faults.frame_faults import Arrival, FrameChanger, Selection, changed_by, with_counter_step
from firmware_sim.faults.kinds import FrameChange
from hil.core.frames import Frame


def sample(counter: int) -> Frame:
    return pdo(0x190, (16384, 1000, 32000), counter)


def changer(text: str, seed: int = 1) -> FrameChanger:
    fault = parse_fault(text)
    assert isinstance(fault, FrameChange)
    return FrameChanger(fault, Random(seed), 2)


def arriving(fault: FrameChanger, frames: list[Frame]) -> list[Frame]:
    return [arrival.frame for frame in frames for arrival in fault.change(frame)]


FRAMES = [sample(counter) for counter in range(4)]


@pytest.mark.parametrize(
    ("text", "counters"),
    [
        ("lose:sample,2@0", [2, 3]),
        ("lose:sample@0", []),
        ("repeat:sample,1@0", [0, 0, 1, 2, 3]),
        ("reorder:sample,1@0", [1, 0, 2, 3]),
        ("reorder:sample@0", [1, 0, 3, 2]),
        ("miscount:sample,-1,1@0", [255, 1, 2, 3]),
        ("miscount:sample,5@0", [5, 6, 7, 8]),
    ],
)
def test_frames_arrive_in_this_order(text: str, counters: list[int]) -> None:
    frames = arriving(changer(text), FRAMES)
    assert [decoded(frame).counter for frame in frames] == counters


def test_a_mislabelled_frame_is_a_copy_with_the_same_data_under_another_identifier() -> None:
    changer_of_one = changer("mislabel:sample,command,1@0")
    assert changer_of_one.change(FRAMES[0]) == (
        Arrival(FRAMES[0]),
        Arrival(Frame(0x220, FRAMES[0].data), is_additional=True),
    )
    assert changer_of_one.change(FRAMES[1]) == (Arrival(FRAMES[1]),)


def test_faults_of_one_frame_follow_each_other() -> None:
    (late,) = changed_by(changer("late:sample,0.02@0"), Arrival(FRAMES[0], 5))
    assert late.delay_ns == 20_000_005
    copy = Arrival(Frame(0x190, b""), is_additional=True)
    assert changed_by(changer("lose:sample@0"), copy) == (copy,)
    assert changed_by(changer("lose:command@0"), late) == (late,)


def test_a_late_frame_has_a_delay() -> None:
    (arrival,) = changer("late:sample,0.02@0").change(FRAMES[0])
    assert (arrival.frame, arrival.delay_ns) == (FRAMES[0], 20_000_000)


def test_a_corrupt_frame_differs_by_one_bit() -> None:
    fault = changer("corrupt:sample@0")
    for frame in FRAMES:
        (changed,) = arriving(fault, [frame])
        before, after = (int.from_bytes(data, "little") for data in (frame.data, changed.data))
        assert (before ^ after).bit_count() == 1


def test_a_corrupt_frame_without_data_gets_a_byte() -> None:
    assert arriving(changer("corrupt:sync@0"), [Frame(0x080)]) == [Frame(0x080, b"\x01")]


def test_an_altered_frame_has_another_value_and_a_correct_crc() -> None:
    (changed,) = arriving(changer("alter:sample@0"), [FRAMES[0]])
    values = decoded(changed)
    assert values.counts != (16384, 1000, 32000)
    assert values.counter == 0


def test_frames_without_counter_and_crc_are_altered_too() -> None:
    frame = pdo(0x190, (1, 2, 3), None)
    assert with_counter_step(frame, 1, 2) == frame
    (changed,) = arriving(changer("alter:sample@0"), [frame])
    assert len(changed.data) == 6
    assert changed != frame


def test_a_share_selects_that_part_of_the_frames_with_the_same_choice_for_the_same_seed() -> None:
    first, second = (Selection("25%", Random(7)) for _ in range(2))
    chosen = [first.takes_next() for _ in range(4000)]
    assert sum(chosen) == pytest.approx(1000, abs=100)
    assert chosen == [second.takes_next() for _ in range(4000)]
