"""The read-back of the valves against their commands: tolerance, number of periods, missing frames."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import pytest
from support.constants import CENTRED, COUNT_V
from support.gateway_bench import AXES
from support.protected_rigs import protected_rig, read_back_frame

from hil.core.valve_read_back import NO_FRAME_YET, ValveReadBack

OPEN = (6.0, 5.0, 5.0)


class Answers:
    """A board that answers each SYNC, with the next counter."""

    def __init__(self, protected: bool = True, axes: Sequence[str] = AXES) -> None:
        self.subject = ValveReadBack(protected_rig(read_back=True, protected=protected, axes=axes))
        self.protected = protected
        self.axes = axes
        self.counter = 0

    def answer(self, pins: tuple[float, ...], commanded: tuple[float, ...] = CENTRED) -> str | None:
        self.subject.sync_sent(commanded[: len(self.axes)])
        self.counter += 1
        return self.subject.receive(read_back_frame(pins, self.counter, self.protected).data)


@pytest.mark.parametrize("protected", [True, False])
def test_the_first_good_answer_shows_that_the_valves_follow(protected: bool) -> None:
    board = Answers(protected)
    assert board.subject.problem == NO_FRAME_YET
    assert board.answer(CENTRED) is None
    assert board.subject.problem is None


def test_a_first_answer_that_differs_shows_nothing() -> None:
    board = Answers()
    board.answer(OPEN)
    assert board.subject.problem == NO_FRAME_YET


@pytest.mark.parametrize(("difference_v", "is_fault"), [(0.049, False), (0.051, True), (-0.051, True)])
def test_a_difference_over_the_tolerance_for_three_periods_is_a_fault(
    difference_v: float, is_fault: bool
) -> None:
    board = Answers()
    board.answer(CENTRED)
    pins = (5.0, 5.0 + difference_v, 5.0)
    for _ in range(2):
        board.answer(pins)
        assert board.subject.problem is None
    board.answer(pins)
    assert (board.subject.problem is not None) is is_fault


def test_the_fault_names_axis_values_limits_and_keys() -> None:
    board = Answers()
    for _ in range(3):
        board.answer((5.0, 5.0, 7.5), (5.0, 5.0, 5.25))
    assert board.subject.problem == (
        "valve of rotation: 7.500 V on the pin, commanded 5.250 V: they differ by 2.250 V, limit 0.05 V "
        "(rig: dac.read_back_tolerance_v), in 3 periods in a row, limit 3 (rig: dac.read_back_periods): "
        "check the board's output and the valve's wiring"
    )


def test_differences_that_do_not_follow_one_another_are_tolerated() -> None:
    board = Answers()
    board.answer(CENTRED)
    for pins in (OPEN, OPEN, CENTRED, OPEN, OPEN, CENTRED):
        board.answer(pins)
        assert board.subject.problem is None


def test_each_valve_is_counted_by_itself() -> None:
    board = Answers()
    board.answer(CENTRED)
    for pins in (OPEN, (5.0, 6.0, 5.0), OPEN, (5.0, 6.0, 5.0)):
        board.answer(pins)
    assert board.subject.problem is None


def test_a_valve_that_follows_again_ends_the_problem() -> None:
    board = Answers()
    for _ in range(4):
        board.answer(OPEN)
    assert board.subject.problem is not None
    board.answer(OPEN, OPEN)
    assert board.subject.problem is None


def test_the_channels_of_the_rig_decide_which_pin_belongs_to_an_axis() -> None:
    board = Answers(axes=("rotation",))
    board.subject.sync_sent((6.0,))
    board.subject.receive(read_back_frame((1.0, 2.0, 6.0), 1).data)
    assert board.subject.problem is None


def test_missing_answers_are_a_fault_after_the_stale_periods() -> None:
    board = Answers()
    board.answer(CENTRED)
    for _ in range(3):
        board.subject.sync_sent(CENTRED)
        assert board.subject.problem is None
    board.subject.sync_sent(CENTRED)
    assert board.subject.problem == (
        "no read-back of the valves (TPDO1_DAC) for 3 periods, limit 3 (rig: adc.stale_after_periods)"
    )
    board.answer(CENTRED)
    assert board.subject.problem is None


def test_an_answer_ends_the_count_of_missing_ones() -> None:
    board = Answers()
    for _ in range(6):
        board.answer(CENTRED)
        board.subject.sync_sent(CENTRED)
        board.subject.sync_sent(CENTRED)
    assert board.subject.problem is None


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "TPDO1_DAC has 0 bytes, not 8 (rig: dac.protected)"),
        (read_back_frame(CENTRED, 2).data[:6], "TPDO1_DAC has 6 bytes, not 8 (rig: dac.protected)"),
        (read_back_frame(CENTRED, 1).data, "TPDO1_DAC: counter 1 after 1 is no newer frame"),
        (read_back_frame(CENTRED, 129).data, "TPDO1_DAC: counter 129 after 1 is no newer frame"),
        (read_back_frame(CENTRED, 2).data[:7] + b"\0", "TPDO1_DAC: CRC 0x00, computed 0x"),
    ],
)
def test_a_bad_frame_is_rejected_and_answers_nothing(data: bytes, said: str) -> None:
    board = Answers()
    board.answer(CENTRED)
    board.subject.sync_sent(CENTRED)
    rejection = board.subject.receive(data)
    assert rejection is not None and rejection.startswith(said)
    for _ in range(3):
        board.subject.sync_sent(CENTRED)
    assert board.subject.problem is not None


def test_two_answers_to_each_sync_come_from_two_boards() -> None:
    board = Answers(protected=False)
    for _ in range(3):
        assert board.subject.problem in (None, NO_FRAME_YET)
        board.answer(CENTRED)
        board.subject.receive(read_back_frame(CENTRED, 0, False).data)
    assert board.subject.problem == (
        "TPDO1_DAC: more answers than SYNCs in 3 periods: another node sends the same identifier; check the "
        "node ids"
    )


def test_a_frame_that_the_bus_delivers_twice_is_tolerated() -> None:
    board = Answers()
    for _ in range(4):
        board.answer(CENTRED)
        board.subject.receive(read_back_frame(CENTRED, board.counter).data)
        for _ in range(2):
            board.answer(CENTRED)
    assert board.subject.problem is None


def test_an_answer_without_sync_is_rejected() -> None:
    board = Answers(protected=False)
    board.answer(CENTRED)
    assert board.subject.receive(read_back_frame(CENTRED, 0, False).data) == (
        "TPDO1_DAC: no SYNC is unanswered: the frame came twice, or was sent without SYNC"
    )


@pytest.mark.parametrize(
    ("advance", "is_newer"), [(1, True), (127, True), (128, False), (255, False), (0, False)]
)
def test_a_counter_may_advance_by_1_to_127(advance: int, is_newer: bool) -> None:
    board = Answers()
    board.answer(CENTRED)
    board.counter += advance - 1
    assert (board.answer(CENTRED) is None) is is_newer


@pytest.mark.parametrize(("counts", "is_fault"), [(20, False), (21, True)])
def test_a_difference_of_exactly_the_tolerance_is_none(counts: int, is_fault: bool) -> None:
    rig = protected_rig(read_back=True)
    dac = msgspec.structs.replace(rig.dac, read_back_tolerance_v=20 * COUNT_V)
    board = Answers()
    board.subject = ValveReadBack(msgspec.structs.replace(rig, dac=dac))
    board.answer(CENTRED)
    for _ in range(3):
        board.answer((5.0, 5.0 + counts * COUNT_V, 5.0))
    assert (board.subject.problem is not None) is is_fault
