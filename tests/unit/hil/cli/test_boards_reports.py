"""The gateway's end of the connection to simulated boards."""

from __future__ import annotations

import socket
from types import SimpleNamespace
from typing import Any

import pytest

from hil.cli.boards_reports import MAX_REPORTS_PER_PERIOD, BoardsReports
from hil.core.life_cycle import LifeCycleState
from hil.core.output import LogEntry, Severity

ENTRY = LogEntry(Severity.INFO, "life cycle", "ready -> armed (arm)")


class Bench:
    """The observer, the boards' end of the socket, and a session that keeps its log."""

    def __init__(self, faults: tuple[str, ...] = (), events: tuple[str, ...] = ()) -> None:
        ours, self.boards = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        self.boards.setblocking(False)
        self.gateway: Any = SimpleNamespace(state=LifeCycleState.OFFLINE)
        self.noted: list[tuple[str, int]] = []
        self.reports = BoardsReports(ours, faults, events)
        session: Any = SimpleNamespace(gateway=self.gateway, note=self.note)
        self.reports.attach(session)

    def note(self, entry: LogEntry, at_ns: int) -> None:
        self.noted.append((f"{entry.source}: {entry.text}", at_ns))

    def period(self, wake_ns: int) -> None:
        cycle: Any = SimpleNamespace(wake_ns=wake_ns)
        self.reports.cycle(cycle, self.gateway)


def test_the_boards_are_told_each_state_once() -> None:
    bench = Bench()
    for state in (LifeCycleState.READY, LifeCycleState.ARMED, LifeCycleState.ARMED, LifeCycleState.RUNNING):
        bench.gateway.state = state
        bench.reports.log(ENTRY)
        bench.period(0)
    told = [bench.boards.recv(100) for _ in range(4)]
    assert told == [b"state offline", b"state ready", b"state armed", b"state running"]
    with pytest.raises(BlockingIOError):
        bench.boards.recv(100)


def test_a_reported_fault_is_logged_at_its_instant() -> None:
    bench = Bench(("unplug@vertical>0.05", "hang:adc@0.5"))
    bench.boards.send(b"1500000000 fault unplug@vertical>0.05")
    bench.period(1_000_000_000)
    assert bench.noted == [("simulated fault: unplug@vertical>0.05 begins", 1_500_000_000)]
    bench.boards.send(b"1500000000 fault hang:adc@0.5")
    assert bench.reports.finish() == {"0.5000 s": "unplug@vertical>0.05 hang:adc@0.5"}
    assert len(bench.noted) == 2


def test_one_period_takes_a_bounded_number_of_reports_and_none_is_lost() -> None:
    bench = Bench()
    for number in range(MAX_REPORTS_PER_PERIOD + 2):
        bench.boards.send(b"%d fault hang:adc@0" % number)
    bench.period(0)
    assert len(bench.noted) == MAX_REPORTS_PER_PERIOD
    bench.period(0)
    assert [at_ns for _, at_ns in bench.noted] == list(range(MAX_REPORTS_PER_PERIOD + 2))


def test_a_reported_event_is_logged_at_its_instant_and_is_no_fault() -> None:
    bench = Bench(events=("payload:3@2",))
    bench.boards.send(b"2000000000 event payload:3@2")
    bench.period(2_011_000_000)
    assert bench.noted == [("arm: payload:3@2 begins", 2_000_000_000)]
    assert bench.reports.events_begun == [(2_000_000_000, "payload:3@2")]
    assert bench.reports.finish() == {}


def test_what_an_operator_asks_for_is_logged_but_not_kept() -> None:
    bench = Bench(("hang:adc@0",), ("payload:3@2",))
    for number in range(1000):
        bench.boards.send(b"%d fault hang:adc@0" % number)
        bench.boards.send(b"%d event payload:3@2" % number)
        bench.period(number)
    assert len(bench.noted) == 2000
    assert len(bench.reports.faults_begun) == len(bench.reports.events_begun) == 1


def test_boards_that_have_ended_are_no_error() -> None:
    bench = Bench()
    bench.boards.close()
    bench.gateway.state = LifeCycleState.READY
    bench.reports.log(ENTRY)
    bench.period(0)
    assert bench.reports.finish() == {}
