"""What the serving process knows of a run: all that is in the feed, and no more than a bounded part of it."""

import json
from collections.abc import Iterator

import numpy as np
import pytest
from support.live_feeds import cycle, gateway, make_feed, write_periods

from hil.core.output import LogEntry, Severity
from hil.live.feed import STATUS_PERIODS, LiveFeed
from hil.live.feed_file import FeedReader
from hil.live.run import MAX_LOG_ENTRIES, Run


@pytest.fixture
def feed() -> Iterator[LiveFeed]:
    made = make_feed()
    yield made
    made.close()


@pytest.fixture
def run(feed: LiveFeed) -> Run:
    return Run(FeedReader(feed.path))


def test_periods_log_and_status_are_taken(feed: LiveFeed, run: Run) -> None:
    write_periods(feed, 1, 2)
    feed.log(LogEntry(Severity.WARNING, "adc", "late"))
    feed.cycle(cycle(STATUS_PERIODS), gateway(missed_periods=3, readiness="both up"))
    run.update()
    assert len(run.history.since(0)) == 2
    assert run.log[0][1:] == [30, "adc", "late"]
    assert run.status["counts"]["missed periods"] == 3
    assert run.status["controllers"] == {"vertical": "ppid"} and run.status["recording"] == "run.mcap"
    assert not run.is_over


def test_what_was_before_the_page_was_opened_is_shown_too(feed: LiveFeed) -> None:
    write_periods(feed, *range(100))
    late = Run(FeedReader(feed.path))
    late.update()
    assert len(late.history.since(0)) == 100


def test_the_last_periods_are_taken_when_the_run_ends(run: Run) -> None:
    feed = make_feed()
    run = Run(FeedReader(feed.path))
    write_periods(feed, 1)
    feed.close()
    run.update()
    assert run.is_over and len(run.history.since(0)) == 1


def test_periods_that_were_overwritten_are_counted(feed: LiveFeed, run: Run) -> None:
    slots = round(600 / 0.0112)
    write_periods(feed, *range(slots + 5))
    feed.cycle(cycle(STATUS_PERIODS), gateway())
    run.update()
    assert run.status["counts"]["periods that this page missed"] == 5


def test_the_log_keeps_the_last_entries(feed: LiveFeed, run: Run) -> None:
    for part in range(5):
        for number in range(200):
            feed.log(LogEntry(Severity.INFO, "a", str(200 * part + number)))
        run.update()
    assert run.log_end == 1000 and len(run.log) == MAX_LOG_ENTRIES
    assert run.log[-1][3] == "999"


def test_the_last_step_is_read(feed: LiveFeed, run: Run) -> None:
    write_periods(feed, *range(50))
    run.update()
    run.update_readings()
    reading = run.readings["vertical"]
    assert reading["kind"] == "Tracking" and reading["max_error"] == pytest.approx(0.01)
    assert np.isfinite(reading["rms_error"])
    json.dumps(run.readings, allow_nan=False)
