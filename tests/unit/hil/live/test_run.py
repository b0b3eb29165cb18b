"""What the serving process knows of a run: all that is in the feed, and no more than a bounded part of it."""

import dataclasses
import json
from collections.abc import Iterator

import numpy as np
import pytest
from support.live_feeds import RUN, STATES, cycle, gateway, make_feed, write_periods

from hil.core.output import LogEntry, Severity
from hil.live.feed import STATUS_PERIODS, LiveFeed
from hil.live.feed_file import FeedReader
from hil.live.readings import readings
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


def _rows_of(setpoint: np.ndarray, position: np.ndarray) -> np.ndarray:
    time_s = np.arange(len(setpoint)) * 0.0112
    running, fresh, none = np.full(len(setpoint), 3.0), np.ones(len(setpoint)), np.zeros(len(setpoint))
    return np.column_stack([time_s, none, none, running, fresh, setpoint, position, none])


def test_a_limited_move_of_a_daemon_is_read_as_a_step() -> None:
    ramp = np.concatenate([np.zeros(100), np.linspace(0.0, 0.1, 20), np.full(400, 0.1)])
    kernel = np.exp(-np.arange(200) / 20)
    lag = np.convolve(ramp, kernel / kernel.sum())[: len(ramp)]
    reading = readings(_rows_of(ramp, lag), [("vertical", "m")], STATES)["vertical"]
    assert reading["kind"] == "StepResponse"
    assert (reading["step_from"], reading["step_to"]) == (0.0, 0.1)
    assert reading["overshoot_percent"] == pytest.approx(0.0, abs=1e-9)
    settled = np.flatnonzero(np.abs(lag - 0.1) > 0.002)[-1] + 1
    assert reading["settling_s"] == pytest.approx((settled - 101) * 0.0112, abs=0.012)


def test_a_setpoint_that_still_moves_is_no_step() -> None:
    ramp = np.concatenate([np.zeros(100), np.linspace(0.0, 0.1, 20)])
    assert readings(_rows_of(ramp, ramp), [("vertical", "m")], STATES)["vertical"]["kind"] == "Tracking"


def test_a_slow_ramp_is_no_step() -> None:
    ramp = np.concatenate([np.zeros(100), np.linspace(0.0, 0.1, 1000), np.full(50, 0.1)])
    assert readings(_rows_of(ramp, ramp), [("vertical", "m")], STATES)["vertical"]["kind"] == "Tracking"


def test_a_setpoint_that_never_stops_is_read_over_the_last_half_minute() -> None:
    time_s = np.arange(10_000) * 0.0112
    setpoint = np.sin(time_s)
    position = np.where(time_s < 50.0, 0.0, setpoint - 0.01)
    reading = readings(_rows_of(setpoint, position), [("vertical", "m")], STATES)["vertical"]
    assert reading["kind"] == "Tracking" and reading["max_error"] == pytest.approx(0.01)


def test_what_disturbs_an_axis_long_after_a_step_does_not_change_its_reading() -> None:
    setpoint = np.concatenate([np.zeros(1000), np.full(9000, 0.1)])
    early = readings(_rows_of(setpoint, setpoint)[:6500], [("vertical", "m")], STATES)["vertical"]
    disturbed = setpoint.copy()
    disturbed[7000:] += 0.05
    assert readings(_rows_of(setpoint, disturbed), [("vertical", "m")], STATES)["vertical"] == early


def test_a_second_move_is_read_by_itself() -> None:
    ramp = np.concatenate([np.zeros(100), np.linspace(0.0, 0.1, 20), np.full(400, 0.1)])
    both = np.concatenate([ramp, 0.1 - 0.5 * ramp])
    reading = readings(_rows_of(both, both), [("vertical", "m")], STATES)["vertical"]
    assert reading["kind"] == "StepResponse"
    assert (reading["step_from"], reading["step_to"]) == (0.1, pytest.approx(0.05))


def test_a_change_below_the_smallest_step_is_no_step() -> None:
    """A daemon that holds a position changes the setpoint by about one count of the converter."""
    setpoint = np.concatenate([np.zeros(100), np.full(400, 0.0002)])
    rows = _rows_of(setpoint, setpoint)
    assert readings(rows, [("vertical", "m")], STATES)["vertical"]["kind"] == "StepResponse"
    with_limit = readings(rows, [("vertical", "m")], STATES, {"vertical": 0.00125})
    assert with_limit["vertical"]["kind"] == "Tracking"


@pytest.mark.parametrize("now_s", [0.9, 1.0, 1.005, 1.0112, 5.37])
def test_the_server_works_while_the_loop_waits(feed: LiveFeed, run: Run, now_s: float) -> None:
    assert run.until_idle_s(now_s, 0.03) == 0.03, "nothing is known of the loop yet"
    run.history.add_rows(np.array([[1.0, 0.0, 0.3, 3.0, 1.0, 0.0, 0.0, 5.0]]))
    wait_s = run.until_idle_s(now_s, 0.03)
    assert 0.03 <= wait_s <= 0.03 + 0.0112
    periods = (now_s + wait_s - 1.0) / 0.0112
    assert periods % 1.0 == pytest.approx(0.15)
    following_s = run.until_idle_s(now_s + wait_s + 0.001, 0.03)
    assert 0.001 + following_s == pytest.approx(3 * 0.0112), "30 times a second"


def test_the_page_reads_no_step_from_a_change_by_one_count(run: Run) -> None:
    setpoint = np.concatenate([np.zeros(100), np.full(400, 0.0002)])
    run.history.add_rows(_rows_of(setpoint, setpoint))
    run.update_readings()
    assert run.readings["vertical"]["kind"] == "Tracking"


def test_the_bus_is_left_when_the_run_ends() -> None:
    feed = make_feed(dataclasses.replace(RUN, bus="inproc:run"))
    run = Run(FeedReader(feed.path))
    assert run._bus._link is not None
    feed.close()
    run.update()
    assert run.is_over and run._bus._link is None
