"""When a board is started: three times at once, then after 1, 2, 4 and 5 s, until it has settled."""

from __future__ import annotations

from itertools import pairwise

from hil.core.nmt_starts import IMMEDIATE_STARTS, MAX_WAIT_NS, SETTLED_NS, NmtStarts

SECOND = 1_000_000_000
HEARTBEAT_NS = SECOND // 10


def starts_of(subject: NmtStarts, heartbeats: int, first_ns: int = 0) -> list[int]:
    """Times of the starts of a board that never becomes operational."""
    times = []
    for now_ns in range(first_ns, first_ns + heartbeats * HEARTBEAT_NS, HEARTBEAT_NS):
        if subject.should_start(now_ns):
            subject.start_sent(now_ns)
            times.append(now_ns)
    return times


def test_the_first_starts_do_not_wait() -> None:
    assert starts_of(NmtStarts(), 3) == [0, HEARTBEAT_NS, 2 * HEARTBEAT_NS]


def test_further_starts_wait_for_ever_longer_times() -> None:
    times = starts_of(NmtStarts(), 300)
    gaps = [(later - sooner) / SECOND for sooner, later in pairwise(times[2:])]
    assert gaps[:4] == [1.0, 2.0, 4.0, 5.0]
    assert set(gaps[3:]) == {MAX_WAIT_NS / SECOND}


def test_the_wait_does_not_grow_without_limit() -> None:
    subject = NmtStarts()
    subject.sent = 10**6
    assert subject.should_start(MAX_WAIT_NS)


def test_a_board_that_stays_operational_has_its_starts_forgotten() -> None:
    subject = NmtStarts()
    starts_of(subject, 10)
    assert subject.are_ignored
    subject.operational(10 * SECOND)
    subject.operational(10 * SECOND + SETTLED_NS - 1)
    assert subject.are_ignored
    subject.operational(10 * SECOND + SETTLED_NS)
    assert subject.sent == 0 and not subject.are_ignored


def test_a_board_that_left_operational_after_it_had_settled_is_started_at_once() -> None:
    subject = NmtStarts()
    starts_of(subject, 3)
    subject.operational(SECOND)
    assert subject.should_start(SECOND + SETTLED_NS)
    assert subject.sent == 0


def test_a_board_that_toggles_does_not_settle() -> None:
    subject = NmtStarts()
    starts = 0
    for number in range(600):
        now_ns = number * HEARTBEAT_NS
        if number % 2:
            subject.operational(now_ns)
        elif subject.should_start(now_ns):
            subject.start_sent(now_ns)
            starts += 1
    assert IMMEDIATE_STARTS < starts <= 16
    assert subject.are_excessive


def test_a_board_that_left_operational_three_times_must_settle() -> None:
    subject = NmtStarts()
    for number in range(3):
        assert not subject.are_excessive
        subject.operational(2 * number * HEARTBEAT_NS)
        subject.should_start((2 * number + 1) * HEARTBEAT_NS)
    assert subject.are_excessive
    subject.operational(SECOND)
    subject.operational(SECOND + SETTLED_NS)
    assert not subject.are_excessive


def test_silence_does_not_count_as_operational() -> None:
    subject = NmtStarts()
    starts_of(subject, 3)
    subject.operational(SECOND)
    subject.silent()
    subject.operational(5 * SECOND)
    assert subject.sent == 3


def test_three_starts_are_ignored_and_more_are_excessive() -> None:
    starts = NmtStarts()
    found = []
    for number in range(4):
        starts.start_sent(number)
        found.append((starts.are_ignored, starts.are_excessive))
    assert found == [(False, False), (False, False), (True, False), (True, True)]
