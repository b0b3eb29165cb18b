"""The loop's end of the live page: nothing that a viewer does can make the loop wait."""

from collections.abc import Iterator
from unittest import mock

import numpy as np
import pytest
from support.live_feeds import PERIOD_NS, RUN, SIGNALS, cycle, gateway, make_feed, write_periods

from hil.core.life_cycle import LifeCycleState
from hil.core.output import LogEntry, Severity
from hil.core.requests import ControllerRequest
from hil.live.feed import STATUS_PERIODS, LiveFeed
from hil.live.feed_file import FeedReader
from hil.live.period_record import unpack_periods
from hil.shells.observers import Observers


@pytest.fixture
def feed() -> Iterator[LiveFeed]:
    made = make_feed()
    yield made
    made.close()


@pytest.fixture
def reader(feed: LiveFeed) -> FeedReader:
    return FeedReader(feed.path)


def test_every_period_is_read_with_all_its_signals_and_instants(feed: LiveFeed, reader: FeedReader) -> None:
    write_periods(feed, 1, 2, 3)
    periods = unpack_periods(reader.periods.read().messages, 1)
    assert list(periods["number"]) == [1, 2, 3]
    last = periods[-1]
    assert last["deadline_ns"] == 3 * PERIOD_NS
    after_wake = [last[name] - last["wake_ns"] for name in ("receive_ns", "computed_ns", "sent_ns")]
    assert after_wake == [200_000, 300_000, 400_000]
    assert (last["state"], last["fresh"]) == (LifeCycleState.RUNNING, True)
    assert last["axes"][0].item()[:7] == SIGNALS


def test_log_entries_and_status_are_read_once(feed: LiveFeed, reader: FeedReader) -> None:
    feed.log(LogEntry(Severity.WARNING, "adc", "late"))
    feed.cycle(cycle(STATUS_PERIODS), gateway(missed_periods=3, fault_reason="adc: lost"))
    (entry,) = reader.log()
    assert (entry.severity, entry.source, entry.text) == (30, "adc", "late")
    status = reader.status()
    assert status is not None and status.counts["missed periods"] == 3
    assert (status.fault, status.readiness, status.recording) == ("adc: lost", "both up", "run.mcap")
    assert reader.log() == [] and reader.status() is None


def test_a_status_is_written_five_times_a_second(feed: LiveFeed, reader: FeedReader) -> None:
    feed.cycle(cycle(STATUS_PERIODS + 1), gateway())
    assert reader.status() is None


def test_the_controller_in_use_is_in_the_status(feed: LiveFeed, reader: FeedReader) -> None:
    feed.controller_changed(ControllerRequest("vertical", "new.json", "{}"))
    feed.cycle(cycle(STATUS_PERIODS), gateway())
    status = reader.status()
    assert status is not None and status.controllers == {"vertical": "new.json"}


def test_long_texts_are_cut_off_and_never_fail(feed: LiveFeed, reader: FeedReader) -> None:
    feed.log(LogEntry(Severity.ERROR, "ε" * 5000, "\ud800" + "ü" * 5000))
    feed.controller_changed(ControllerRequest("vertical", "n" * 10_000, ""))
    feed.cycle(cycle(STATUS_PERIODS), gateway(fault_reason="f" * 10_000, readiness="r" * 10_000))
    (entry,) = reader.log()
    assert len(entry.source.encode()) == 2000 and entry.text.startswith("?üü")
    status = reader.status()
    assert status is not None and status.fault == "f" * 2000 and status.controllers["vertical"] == "n" * 300


def test_a_reader_that_reads_nothing_costs_nothing(feed: LiveFeed, reader: FeedReader) -> None:
    slots = round(600 / RUN.period_s)
    write_periods(feed, *range(slots + 100))
    messages, lost = reader.periods.read()
    assert (len(messages), lost) == (slots, 100)
    assert np.all(np.diff(unpack_periods(messages, 1)["number"]) == 1)


def test_observers_pass_on_to_each_of_them() -> None:
    observers = [mock.Mock(), mock.Mock()]
    together = Observers(*observers)
    entry = LogEntry(Severity.INFO, "a", "b")
    core = gateway()
    together.log(entry)
    together.cycle(cycle(1), core)
    for observer in observers:
        observer.log.assert_called_once_with(entry)
        observer.cycle.assert_called_once_with(cycle(1), core)
