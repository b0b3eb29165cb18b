"""The count of surplus answers: when a second sender is suspected, and when it is certain."""

from __future__ import annotations

import pytest

from hil.core.surplus_answers import (
    MAX_SURPLUS_PERIODS,
    MAX_UNANSWERED_SYNCS,
    SURPLUS_PERIODS_LIMIT,
    SurplusAnswers,
)


def period(surplus: SurplusAnswers, answers: int) -> bool:
    """A period with SYNC and ``answers``; whether a second sender is certain."""
    surplus.begin_period()
    surplus.sync_sent()
    verdicts = [surplus.answer_received() for _ in range(answers)]
    return any(verdicts)


def test_one_answer_to_each_sync_is_no_surplus() -> None:
    surplus = SurplusAnswers()
    assert not any(period(surplus, 1) for _ in range(100))
    assert not surplus.is_suspected


def test_two_answers_in_each_period_are_certain_at_the_limit() -> None:
    surplus = SurplusAnswers()
    assert [period(surplus, 2) for _ in range(SURPLUS_PERIODS_LIMIT)] == [False, False, True]


def test_one_surplus_answer_is_suspicious_for_one_period() -> None:
    surplus = SurplusAnswers()
    period(surplus, 2)
    assert surplus.is_suspected
    period(surplus, 1)
    assert surplus.is_suspected
    period(surplus, 1)
    assert not surplus.is_suspected


def test_several_surplus_answers_in_a_period_count_once() -> None:
    surplus = SurplusAnswers()
    assert not period(surplus, 50)
    period(surplus, 1)
    period(surplus, 1)
    assert not surplus.is_suspected


def test_a_surplus_in_every_other_period_is_never_certain() -> None:
    surplus = SurplusAnswers()
    assert not any(period(surplus, 1 + number % 2) for number in range(100))


def test_late_answers_to_earlier_syncs_are_no_surplus() -> None:
    surplus = SurplusAnswers()
    for _ in range(MAX_UNANSWERED_SYNCS):
        period(surplus, 0)
    assert not period(surplus, MAX_UNANSWERED_SYNCS)
    assert not surplus.is_suspected


def test_syncs_of_long_ago_do_not_hide_a_surplus() -> None:
    surplus = SurplusAnswers()
    for _ in range(100):
        period(surplus, 0)
    period(surplus, MAX_UNANSWERED_SYNCS + 1)
    assert surplus.is_suspected


@pytest.mark.parametrize("periods", [MAX_SURPLUS_PERIODS, 100])
def test_a_second_sender_that_has_gone_is_forgotten(periods: int) -> None:
    surplus = SurplusAnswers()
    for _ in range(periods):
        period(surplus, 2)
    for _ in range(MAX_SURPLUS_PERIODS):
        assert surplus.is_suspected
        period(surplus, 1)
    period(surplus, 1)
    assert not surplus.is_suspected
