"""The lead time of the loop's wake-up, from the times of its rehearsals."""

from __future__ import annotations

from hil.shells.lead_time import FIRST_REHEARSAL_NS, FORGETTING_PERIODS, LeadTime

POLL_NS = 150_000
MAX_REHEARSAL_NS = 1_000_000


def test_without_a_rehearsal_it_is_the_time_of_polling() -> None:
    assert LeadTime(POLL_NS, 0).ns == POLL_NS


def test_it_begins_with_time_for_a_slow_rehearsal() -> None:
    assert LeadTime(POLL_NS, MAX_REHEARSAL_NS).ns == POLL_NS + FIRST_REHEARSAL_NS


def test_a_longer_rehearsal_counts_at_once() -> None:
    lead = LeadTime(POLL_NS, MAX_REHEARSAL_NS)
    lead.measured(700_000)
    assert lead.ns == POLL_NS + 700_000


def test_short_rehearsals_shorten_it_slowly() -> None:
    lead = LeadTime(POLL_NS, MAX_REHEARSAL_NS)
    lead.measured(100_000)
    assert FIRST_REHEARSAL_NS - lead.rehearsal_ns == FIRST_REHEARSAL_NS // FORGETTING_PERIODS
    for _ in range(5 * FORGETTING_PERIODS):
        lead.measured(100_000)
    assert lead.ns == POLL_NS + 100_000


def test_a_stall_does_not_bring_the_wake_up_forward_beyond_the_limit_and_is_forgotten() -> None:
    lead = LeadTime(POLL_NS, MAX_REHEARSAL_NS)
    lead.measured(3_000_000)
    assert lead.rehearsal_ns == 3_000_000
    assert lead.ns == POLL_NS + MAX_REHEARSAL_NS
    for _ in range(2 * FORGETTING_PERIODS):
        lead.omitted()
    assert lead.rehearsal_ns < MAX_REHEARSAL_NS


def test_in_a_short_period_a_rehearsal_that_takes_long_is_omitted() -> None:
    lead = LeadTime(POLL_NS, 125_000)
    lead.measured(400_000)
    assert lead.ns == POLL_NS + 125_000
    assert lead.ns < lead.rehearsal_ns
