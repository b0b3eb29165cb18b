"""The matching of answers to SYNCs: states, rules, and the examples of the module's docstring."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import pytest
from support.constants import PERIOD_NS

from hil.core import sync_matching
from hil.core.sync_matching import (
    ANSWER_TIMEOUT_PERIODS,
    FRESH,
    UNASKED,
    UNCOUNTED_ANSWER_TIMEOUT_PERIODS,
    Earlier,
    Match,
    MatchState,
    SyncMatcher,
    TooMany,
    TooOld,
)

SEARCHING, MATCHED = MatchState.SEARCHING, MatchState.MATCHED
BEHIND, RESYNCHRONISING = MatchState.BEHIND, MatchState.RESYNCHRONISING
QUICK_NS = PERIOD_NS // 10
"""Latency of an answer on a quick link."""


class Steps:
    """A matcher in simulated time. Periods begin at multiples of the period."""

    def __init__(self, has_counter: bool = True) -> None:
        self.matcher = SyncMatcher(PERIOD_NS, has_counter)
        self.period = -1

    @property
    def state(self) -> MatchState:
        return self.matcher.state

    def begin(self, may_wait: bool = True) -> bool:
        self.period += 1
        return self.matcher.begin_period(self.period * PERIOD_NS, may_wait)

    def answer(self, step: int = 1, after_ns: int = QUICK_NS) -> Match:
        """An answer arrives ``after_ns`` after the beginning of the period."""
        return self.matcher.match(step, self.period * PERIOD_NS + after_ns)

    def periods_without_sync(self) -> int:
        """Begin periods until one sends SYNC; the number of those before it."""
        for number in range(20):
            if self.begin():
                return number
        raise AssertionError("SYNC never leaves")


def matched(has_counter: bool = True) -> Steps:
    steps = Steps(has_counter)
    assert steps.begin()
    assert steps.answer() is FRESH
    assert steps.state is MATCHED
    return steps


def behind() -> Steps:
    """The SYNC of period 1 is lost. The answer to the SYNC of period 2 is matched to it."""
    steps = matched()
    steps.begin()
    steps.begin()
    assert steps.answer() == Earlier(1)
    assert steps.state is BEHIND
    return steps


def resynchronising() -> Steps:
    """A SYNC has left in the present period."""
    steps = behind()
    assert steps.periods_without_sync() == 2
    assert steps.state is RESYNCHRONISING
    return steps


class TestTransitions:
    def test_a_matcher_begins_by_searching(self) -> None:
        assert Steps().state is SEARCHING

    @pytest.mark.parametrize(
        ("after_ns", "match", "state"),
        [(PERIOD_NS, FRESH, MATCHED), (PERIOD_NS + 1, TooOld(PERIOD_NS + 1), SEARCHING)],
    )
    def test_searching_ends_with_an_answer_within_one_period(
        self, after_ns: int, match: Match, state: MatchState
    ) -> None:
        steps = Steps()
        steps.begin()
        assert steps.answer(after_ns=after_ns) == match
        assert steps.state is state

    def test_resynchronising_ends_with_an_answer_within_one_period(self) -> None:
        steps = resynchronising()
        assert steps.answer(after_ns=PERIOD_NS + 1) == TooOld(PERIOD_NS + 1)
        assert steps.state is RESYNCHRONISING
        assert steps.begin()
        assert steps.answer() is FRESH
        assert steps.state is MATCHED

    def test_an_answer_that_is_too_old_stays_matched(self) -> None:
        steps = matched()
        steps.begin()
        assert steps.answer(after_ns=PERIOD_NS + 1) == TooOld(PERIOD_NS + 1)
        assert steps.state is MATCHED

    def test_the_answer_to_the_last_sync_ends_being_behind(self) -> None:
        steps = behind()
        assert not steps.begin()
        assert steps.answer() == TooOld(PERIOD_NS + QUICK_NS)
        assert steps.state is MATCHED

    @pytest.mark.parametrize("build", [matched, behind, resynchronising])
    def test_a_restart_leads_back_to_searching(self, build: Callable[[], Steps]) -> None:
        steps = build()
        steps.matcher.restart()
        assert steps.state is SEARCHING

    @pytest.mark.parametrize("build", [matched, behind])
    def test_more_answers_than_syncs_are_not_matched(self, build: Callable[[], Steps]) -> None:
        steps = build()
        outstanding, state = steps.matcher.outstanding, steps.state
        assert steps.answer(outstanding + 1) == TooMany(outstanding)
        assert (steps.matcher.outstanding, steps.state) == (outstanding, state)

    def test_while_resynchronising_the_counter_may_advance_by_more(self) -> None:
        steps = resynchronising()
        assert steps.answer(3) is FRESH

    @pytest.mark.parametrize("has_counter", [True, False])
    def test_an_answer_without_a_sync_is_unasked(self, has_counter: bool) -> None:
        assert Steps(has_counter).matcher.match(1, 0) is UNASKED

    def test_without_a_counter_a_second_answer_is_unasked(self) -> None:
        steps = matched(has_counter=False)
        assert steps.answer() is UNASKED
        assert steps.state is MATCHED


class TestRules:
    def test_1_a_counter_step_skips_the_syncs_of_lost_answers(self) -> None:
        steps = matched()
        for _ in range(4):
            assert steps.begin()
        assert steps.answer(2) == Earlier(2)
        assert steps.answer(2) is FRESH

    def test_2_while_matched_sync_leaves_in_every_period(self) -> None:
        steps = matched()
        assert all(steps.begin() for _ in range(200))

    @pytest.mark.parametrize(
        ("later_syncs", "after_ns", "silent"),
        [(1, 0, 2), (1, QUICK_NS, 2), (2, 0, 2), (2, 1, 3), (3, QUICK_NS, 4), (4, QUICK_NS, 4), (9, 0, 4)],
    )
    def test_3_while_behind_sync_waits_for_the_latency_and_one_period(
        self, later_syncs: int, after_ns: int, silent: int
    ) -> None:
        """The latency is that of the answer to the SYNC that it is matched to; at most five periods count."""
        steps = matched()
        for _ in range(1 + later_syncs):
            assert steps.begin()
        assert steps.answer(after_ns=after_ns) == Earlier(later_syncs)
        assert steps.periods_without_sync() == silent
        assert steps.state is RESYNCHRONISING

    def test_4_while_searching_one_sync_at_a_time_is_outstanding(self) -> None:
        steps = Steps()
        had_sync = [steps.begin() for _ in range(3 * ANSWER_TIMEOUT_PERIODS)]
        assert had_sync == ([True] + [False] * (ANSWER_TIMEOUT_PERIODS - 1)) * 3

    @pytest.mark.parametrize("build", [Steps, behind])
    def test_5_elapsed_time_alone_does_not_end_a_wait(self, build: Callable[[], Steps]) -> None:
        steps = build()
        if build is Steps:
            steps.begin()
        for _ in range(2):
            steps.period += 100  # the machine stalls
            assert not steps.begin()
        steps.period += 100
        assert steps.begin()

    def test_5_each_wait_counts_its_own_periods(self) -> None:
        steps = behind()
        steps.periods_without_sync()
        steps.period += 10
        assert not steps.begin()

    def test_4_each_sync_is_given_up_at_its_own_time(self) -> None:
        steps = Steps()
        assert steps.begin(may_wait=False) and steps.begin(may_wait=False)
        for _ in range(4):
            assert not steps.begin()
        assert steps.answer() == TooOld(4 * PERIOD_NS + QUICK_NS)

    def test_6_without_a_counter_sync_waits_after_every_unanswered_one(self) -> None:
        steps = matched(has_counter=False)
        assert steps.begin()
        assert steps.periods_without_sync() == UNCOUNTED_ANSWER_TIMEOUT_PERIODS - 1
        assert steps.state is RESYNCHRONISING

    def test_6_without_a_counter_the_first_sync_is_given_up_after_five_periods(self) -> None:
        steps = Steps(has_counter=False)
        steps.begin()
        assert steps.periods_without_sync() == ANSWER_TIMEOUT_PERIODS - 1

    @pytest.mark.parametrize("build", [Steps, behind, resynchronising])
    def test_7_a_sync_that_may_not_wait_leaves(self, build: Callable[[], Steps]) -> None:
        steps = build()
        for _ in range(3):
            assert steps.begin(may_wait=False)

    def test_7_then_an_answer_is_matched_to_the_oldest_sync(self) -> None:
        steps = Steps()
        for _ in range(3):
            steps.begin(may_wait=False)
        assert steps.answer() == Earlier(2)
        assert steps.state is SEARCHING


def example_rows(name: str) -> dict[str, list[str]]:
    """The rows of one of the two examples in the module's docstring, cut into columns of one period."""
    assert sync_matching.__doc__ is not None
    block = sync_matching.__doc__.split(name)[1].split("::\n\n")[1].split("\n\n")[0]
    rows = {}
    for line in block.splitlines():
        label, content = line[4:14].strip(), line[14:].ljust(80)
        rows[label] = [content[place : place + 10].strip() for place in range(0, 70, 10)]
    return rows


def words(match: Match) -> str:
    """A verdict as the examples name it."""
    if match is FRESH:
        return "fresh"
    return "too old" if isinstance(match, TooOld) else "earlier"


@pytest.mark.parametrize(
    ("name", "lost", "latencies"),
    [
        ("A SYNC is lost.", {1}, [0.1] * 7),
        ("The link becomes slow", set(), [0.1] + [1.1] * 6),
    ],
)
def test_the_examples_of_the_docstring(name: str, lost: set[int], latencies: Sequence[float]) -> None:
    rows = example_rows(name)
    steps = Steps()
    answers: list[tuple[float, int]] = []
    number = -1
    state = ""
    for period in range(7):
        if steps.begin():
            number += 1
            assert re.match(rf"S{number}\b", rows["SYNC"][period])
            if number not in lost:
                answers.append((period + latencies[number], number))
        else:
            assert rows["SYNC"][period] == "-"
        arrived = [answer for answer in answers if period <= answer[0] < period + 1]
        assert rows["answer"][period] == "".join(f"a{n}" for _, n in arrived)
        verdicts = [words(steps.answer(after_ns=round((at % 1) * PERIOD_NS))) for at, _ in arrived]
        assert rows["verdict"][period] == "".join(verdicts)
        if rows["state"][period]:
            state = rows["state"][period]
        if arrived:
            assert steps.state.name == state
