"""The loop's end of the live page: nothing that the page does can make the loop wait."""

import json
import os
import socket
from pathlib import Path
from unittest import mock

import pytest

import hil
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.core.output import AxisSignals, Cycle, LogEntry, Severity
from hil.live import feed as feed_module
from hil.live.address import open_address
from hil.live.feed import BATCH_PERIODS, PERIODS, LiveFeed, RunInformation
from hil.live.history import History
from hil.live.run import Run
from hil.shells.observers import Observers

SHIPPED_TEXT = (Path(hil.__file__).parent / "shipped" / "rig.toml").read_text()
SIGNALS = AxisSignals(0.1, 0.09, 0.01, 1.0, 6.0, 7.0)
INFORMATION = RunInformation(
    [("vertical", "m")], 0.0112, ["offline"], "rig.toml", "slcan:none", {}, "run.mcap", 0, 0, SHIPPED_TEXT
)


def cycle(number: int) -> Cycle:
    deadline_ns = number * 11_200_000
    return Cycle(number, deadline_ns, deadline_ns + 50_000, 0, LifeCycleState.RUNNING, True, (SIGNALS,))


@pytest.fixture
def gateway() -> mock.Mock:
    counts = dict.fromkeys(("missed_periods", "rejected_frames", "lost_samples", "error_frames"), 0)
    return mock.Mock(spec=Gateway, fault_reason=None, readiness="both up", **counts)


@pytest.fixture
def ends(monkeypatch: pytest.MonkeyPatch) -> tuple[LiveFeed, socket.socket]:
    """Give a feed, and the end that the serving process would read."""
    theirs = []

    def start(_address: object, *, feed: int, operator_socket: str | None) -> mock.Mock:
        theirs.append(socket.socket(fileno=os.dup(feed)))
        return mock.Mock(wait=mock.Mock(return_value=0))

    monkeypatch.setattr(feed_module, "start_server", start)
    with open_address() as address:
        made = LiveFeed(INFORMATION, address)
    theirs[0].setblocking(False)
    return made, theirs[0]


def test_the_run_comes_first_then_every_period(
    ends: tuple[LiveFeed, socket.socket], gateway: mock.Mock
) -> None:
    made, theirs = ends
    assert json.loads(theirs.recv(65536))["run"]["axes"] == [["vertical", "m"]]
    for number in range(1, BATCH_PERIODS + 1):
        made.cycle(cycle(number), gateway)
    message = theirs.recv(65536)
    assert message.startswith(PERIODS)
    history = History(1, 0.0112)
    history.add_message(message[1:])
    rows = history.since(0)
    assert len(rows) == BATCH_PERIODS
    assert list(rows[0, 3:]) == [LifeCycleState.RUNNING, 1.0, 0.1, 0.09, 6.0]
    assert rows[0, 0] == pytest.approx(0.0112)


def test_counts_and_log_entries_reach_the_page(
    ends: tuple[LiveFeed, socket.socket], gateway: mock.Mock
) -> None:
    made, theirs = ends
    gateway.missed_periods = 3
    made.log(LogEntry(Severity.WARNING, "adc", "late"))
    made.cycle(cycle(18), gateway)
    run = Run()
    for _ in range(3):
        run.take_message(theirs.recv(65536))
    assert run.log[0][1:] == [30, "adc", "late"]
    assert run.status["counts"]["missed periods"] == 3


def test_a_process_that_reads_nothing_costs_messages_and_no_time(
    ends: tuple[LiveFeed, socket.socket], gateway: mock.Mock
) -> None:
    made, _theirs = ends
    for number in range(20_000):
        made.cycle(cycle(number), gateway)
    assert made.dropped > 1000


def test_a_process_that_has_ended_troubles_nobody(
    ends: tuple[LiveFeed, socket.socket], gateway: mock.Mock
) -> None:
    made, theirs = ends
    theirs.close()
    for number in range(100):
        made.cycle(cycle(number), gateway)
    made.log(LogEntry(Severity.INFO, "a", "b"))
    made.close()


def test_every_observer_of_an_audience_is_told(gateway: mock.Mock) -> None:
    observers = [mock.Mock(), mock.Mock()]
    audience = Observers(*observers)
    entry = LogEntry(Severity.INFO, "a", "b")
    audience.log(entry)
    audience.cycle(cycle(1), gateway)
    for observer in observers:
        observer.log.assert_called_once_with(entry)
        observer.cycle.assert_called_once_with(cycle(1), gateway)
