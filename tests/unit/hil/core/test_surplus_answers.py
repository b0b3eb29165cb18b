"""The count of surplus answers: when a second sender is suspected, and when it is certain."""

from __future__ import annotations

import pytest

from hil.core.surplus_answers import SurplusAnswers


def period(surplus: SurplusAnswers, answers: int) -> bool:
    """A period with SYNC and ``answers``; whether a second sender is certain."""
    surplus.begin_period()
    surplus.sync_sent()
    verdicts = [surplus.answer_received() for _ in range(answers)]
    return any(verdicts)


def test_at_the_beginning_nothing_is_suspected() -> None:
    assert not SurplusAnswers().is_suspected


def test_an_answer_before_the_first_period_is_a_surplus() -> None:
    surplus = SurplusAnswers()
    surplus.answer_received()
    assert surplus.is_suspected


def test_one_answer_to_each_sync_is_no_surplus() -> None:
    surplus = SurplusAnswers()
    assert not any(period(surplus, 1) for _ in range(100))
    assert not surplus.is_suspected


def test_two_answers_in_each_of_three_periods_are_certain() -> None:
    surplus = SurplusAnswers()
    assert [period(surplus, 2) for _ in range(3)] == [False, False, True]


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
    for _ in range(4):
        period(surplus, 0)
    period(surplus, 5)
    assert not surplus.is_suspected


def test_no_more_than_five_syncs_may_still_be_answered() -> None:
    surplus = SurplusAnswers()
    for _ in range(100):
        period(surplus, 0)
    period(surplus, 5)
    assert not surplus.is_suspected
    for _ in range(100):
        period(surplus, 0)
    period(surplus, 6)
    assert surplus.is_suspected


@pytest.mark.parametrize("periods", [6, 100])
def test_a_second_sender_that_has_gone_is_forgotten_after_six_periods(periods: int) -> None:
    surplus = SurplusAnswers()
    for _ in range(periods):
        period(surplus, 2)
    for _ in range(6):
        assert surplus.is_suspected
        period(surplus, 1)
    period(surplus, 1)
    assert not surplus.is_suspected
