"""The loop's end of the operators' pipe, on a lockstep run: requests, status, and a dead other end."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from support.operated_runs import OperatedRun

from hil.core.life_cycle import LifeCycleState
from hil.core.output import LogEntry, Severity
from hil.core.requests import CheckFailure, Reply, SetpointRequest
from hil.core.setpoint_change import prepare_setpoint
from hil.host.controller_files import SHIPPED_CONTROLLERS
from hil.operation.pipe import Asked, FromLoop, Logged, Replied, StatusNow, pipe
from hil.operation.protocol import (
    ArmCall,
    AxisSetpoint,
    ControllerCall,
    DisarmCall,
    EventCall,
    JogCall,
    LogLine,
    LoopCall,
    ResetCall,
    SetpointCall,
    SetpointsCall,
    ShutdownCall,
    StartCall,
    Status,
    StopCall,
)
from hil.shells.observers import Observers
from hil.shells.operator_port import (
    MAX_DROPPED_IN_ROW,
    MAX_REQUESTS_PER_TURN,
    STATUS_PERIODS,
    Action,
    Described,
    OperatorPort,
)
from hil.shells.run_plan import CENTRING_PERIODS, Ending

WHO = "alice (hil, process 7)"


class PortBench:
    """A lockstep run with a port, and the socket process' end of the pipe."""

    def __init__(self, path: Path, actions: dict[type[LoopCall], Action]) -> None:
        self.run = OperatedRun(path, dict.fromkeys(("vertical", "horizontal", "rotation"), "hold"))
        ours, self.end = pipe()
        self._ours = ours
        axes = tuple((name, axis.unit) for name, axis in self.run.setup.rig.axes.items())
        described = Described("can7", False, axes, 0.0112, 10**18)
        self.port = OperatorPort(ours, described, actions, lambda: "one.mcap", lambda: self.now_ns)
        self.now_ns = 0
        self.run.session._observer = Observers(self.port, self.run.shown)
        self.number = 0

    def ask(self, call: LoopCall) -> None:
        self.number += 1
        self.end.send(msgspec.msgpack.encode(Asked(self.number, WHO, call)))

    def period(self, number: int = 1) -> None:
        for _ in range(number):
            self.run.periods(1)
            self.port.serve(self.run.session)

    def received(self) -> list[FromLoop]:
        found: list[FromLoop] = []
        while True:
            try:
                found.append(msgspec.msgpack.decode(self.end.recv(1 << 20), type=FromLoop))
            except BlockingIOError:
                return found

    def replies(self) -> list[Replied]:
        return [message for message in self.received() if isinstance(message, Replied)]

    def reply_to(self, call: LoopCall) -> Replied:
        self.ask(call)
        self.period()
        (reply,) = self.replies()
        return reply

    def close(self) -> None:
        self.run.close()
        self._ours.close()
        self.end.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[PortBench]:
    made = PortBench(
        tmp_path / "run.mcap",
        {ShutdownCall: lambda _session, _call, asked_by: Reply(True, f"the daemon ends for {asked_by}")},
    )
    made.period(20)
    made.received()
    yield made
    made.close()


def texts(bench: PortBench, source: str) -> list[str]:
    return [entry.text for entry in bench.run.shown.entries if entry.source == source]


def test_checks_of_the_machine_refuse_to_arm_unless_they_are_overridden(bench: PortBench) -> None:
    bench.port._failures = (CheckFailure("SCHED_FIFO", "not permitted"),)
    reply = bench.reply_to(ArmCall())
    assert not reply.accepted
    assert reply.text.startswith("arm refused: SCHED_FIFO: not permitted")
    assert bench.reply_to(ArmCall(override=("SCHED_FIFO",))).accepted
    bench.period(STATUS_PERIODS + 1)
    states = [message.status for message in bench.received() if isinstance(message, StatusNow)]
    assert states[-1].overridden_checks == ("SCHED_FIFO",)
    entries = bench.run.shown.entries
    asked = [entry for entry in entries if entry.source == "operator"]
    assert asked[-1] == LogEntry(Severity.WARNING, "operator", f"{WHO} asks: arm, overriding SCHED_FIFO")
    found = LogEntry(Severity.WARNING, "preflight", "SCHED_FIFO is overridden: not permitted")
    assert found in entries


def test_the_lateness_is_that_of_the_last_periods_and_that_since_the_start(bench: PortBench) -> None:
    late = bench.run.shown.cycles[-1]
    bench.port.cycle(late._replace(wake_ns=late.deadline_ns + 5_000_000), bench.run.gateway)
    bench.period(2 * STATUS_PERIODS + 2)
    first, *_, last = [m.status for m in bench.received() if isinstance(m, StatusNow)]
    assert (first.max_lateness_ms, first.max_lateness_since_start_ms) == (5.0, 5.0)
    assert (last.max_lateness_ms, last.max_lateness_since_start_ms) == (0.0, 5.0)


def test_a_status_has_the_age_of_the_last_good_sample(bench: PortBench) -> None:
    last = bench.run.shown.cycles[-1]
    assert last.fresh
    late = last._replace(fresh=False, number=last.number + STATUS_PERIODS, wake_ns=last.wake_ns + 3 * 10**9)
    bench.port.cycle(late, bench.run.gateway)
    bench.port.serve(bench.run.session)
    (found,) = [m.status for m in bench.received() if isinstance(m, StatusNow)]
    assert found.sample_age_s == pytest.approx(3.0)
    bench.period(2 * STATUS_PERIODS + 2)
    *_, found = [m.status for m in bench.received() if isinstance(m, StatusNow)]
    assert found.sample_age_s == 0.0


def test_requests_reach_the_core_with_who_asked(bench: PortBench) -> None:
    document = (SHIPPED_CONTROLLERS / "ppid.json").read_text()
    for call, is_accepted in (
        (StartCall(), False),
        (ArmCall(), True),
        (SetpointCall(axis="vertical", setpoint="0.05"), True),
        (SetpointCall(axis="elbow", setpoint="0.05"), False),
        (ControllerCall(axis="vertical", name="c.json", document=document), True),
        (ControllerCall(axis="vertical", name="c.json", document="{}"), False),
        (JogCall(axis="vertical", offset_v=0.3, duration_s=0.02), True),
        (StopCall(), True),
        (StartCall(), True),
        (StopCall(), True),
        (DisarmCall(), True),
        (ResetCall(), False),
    ):
        reply = bench.reply_to(call)
        assert reply.number == bench.number
        assert (reply.accepted, bool(reply.text)) == (is_accepted, True), reply
    assert texts(bench, "operator")[:2] == [f"{WHO} asks: start", f"{WHO} asks: arm"]


def test_nothing_moves_any_more_while_the_daemon_ends(bench: PortBench) -> None:
    assert bench.reply_to(SetpointCall(axis="vertical", setpoint="0.1")).accepted
    for call in (ArmCall(), StartCall()):
        assert bench.reply_to(call).accepted
    bench.period(20)
    assert bench.run.shown.cycles[-1].axes[0].command_v != 5.0
    bench.run.plan.end(Ending.INTERRUPTED)
    jog = JogCall(axis="vertical", offset_v=1.0, duration_s=0.3)
    for number in range(CENTRING_PERIODS):
        bench.ask(StartCall() if number % 2 else jog)
        bench.period()
        assert bench.run.gateway.state is LifeCycleState.ARMED
        assert {axis.command_v for axis in bench.run.shown.cycles[-1].axes} == {5.0}
    assert bench.run.plan.is_over
    assert {(reply.accepted, reply.text) for reply in bench.replies()} == {
        (False, "refused: the daemon is ending, with centred valves")
    }


def test_a_second_shutdown_is_accepted_while_the_daemon_ends(bench: PortBench) -> None:
    bench.run.plan.end(Ending.INTERRUPTED)
    reply = bench.reply_to(ShutdownCall())
    assert (reply.accepted, reply.text) == (True, "the daemon is already shutting down")


def test_other_requests_are_the_daemons(bench: PortBench) -> None:
    assert bench.reply_to(ShutdownCall()) == Replied(1, True, f"the daemon ends for {WHO}")
    refused = bench.reply_to(EventCall(text="payload:3"))
    assert not refused.accepted


def test_the_status_with_the_effect_comes_before_the_reply(bench: PortBench) -> None:
    bench.ask(ArmCall())
    bench.period()
    kinds = [type(message) for message in bench.received() if not isinstance(message, Logged)]
    assert kinds == [StatusNow, Replied, StatusNow] or kinds == [StatusNow, Replied]


def test_a_period_takes_a_bounded_number_of_requests(bench: PortBench) -> None:
    for _ in range(3 * MAX_REQUESTS_PER_TURN):
        bench.ask(ArmCall())
    for _ in range(3):
        bench.period()
        assert len(bench.replies()) == MAX_REQUESTS_PER_TURN
    bench.period()
    assert bench.replies() == []


def test_nothing_is_taken_before_the_period_is_over(bench: PortBench) -> None:
    bench.ask(ArmCall())
    bench.port.serve(bench.run.session)
    assert bench.replies() == []


@pytest.mark.parametrize(
    ("before_ns", "is_taken"), [(6_000_000, False), (4_000_000, True), (3_000_000, True), (2_900_000, False)]
)
def test_requests_are_taken_again_shortly_before_the_deadline(
    bench: PortBench, before_ns: int, is_taken: bool
) -> None:
    bench.ask(ArmCall())
    bench.now_ns = bench.run.gateway.next_deadline_ns - before_ns
    bench.port.serve(bench.run.session)
    assert len(bench.replies()) == is_taken
    bench.ask(ArmCall())
    bench.port.serve(bench.run.session)
    assert bench.replies() == [], "once before each deadline"


def test_a_request_takes_effect_within_two_periods(bench: PortBench) -> None:
    bench.reply_to(ArmCall())
    bench.reply_to(StartCall())
    bench.period(5)
    before = bench.run.shown.cycles[-1]
    bench.ask(SetpointCall(axis="vertical", setpoint="0.05"))
    bench.period(2)
    after = bench.run.shown.cycles[-1]
    assert after.number - before.number == 2
    assert after.axes[0].setpoint > before.axes[0].setpoint


def test_the_status_has_the_signals_and_comes_regularly(bench: PortBench) -> None:
    bench.period(10 * STATUS_PERIODS)
    statuses = [message.status for message in bench.received() if isinstance(message, StatusNow)]
    assert 9 <= len(statuses) <= 11
    last: Status = statuses[-1]
    assert (last.state, last.bus, last.recording, last.fault) == ("ready", "can7", "one.mcap", None)
    assert [(axis.name, axis.unit) for axis in last.axes] == [
        ("vertical", "m"),
        ("horizontal", "m"),
        ("rotation", "rad"),
    ]
    assert last.axes[0].command_v == 5.0
    assert last.readiness == "adc operational; dac operational"


def test_numbers_that_are_not_known_are_none(tmp_path: Path) -> None:
    bench = PortBench(tmp_path / "run.mcap", {})
    bench.run.gateway.on_deadline(1)  # without a sample
    bench.period()
    bench.port._next_status = 0
    (first, *_) = [message.status for message in bench.received() if isinstance(message, StatusNow)]
    assert first.axes[0].position is None or isinstance(first.axes[0].position, float)
    bench.close()


def test_log_entries_are_passed_on_in_both_directions(bench: PortBench) -> None:
    bench.port.log(LogEntry(Severity.WARNING, "loop", "late"))
    assert bench.received() == [Logged(LogLine(10**18, 30, "loop", "late"))]
    line = LogLine(1, int(Severity.ERROR), "operation", "the server ended")
    bench.end.send(msgspec.msgpack.encode(Logged(line)))
    bench.period()
    assert LogEntry(Severity.ERROR, "operation", "the server ended") in bench.run.shown.entries


def test_garbage_from_the_socket_process_is_dropped(bench: PortBench) -> None:
    bench.end.send(b"\xc1garbage")
    assert bench.reply_to(ArmCall()).accepted


def test_a_socket_process_that_has_stopped_is_reported_once(bench: PortBench) -> None:
    for _ in range(10_000):
        bench.port.log(LogEntry(Severity.INFO, "loop", "x" * 100))
        if bench.port._dropped_in_row >= MAX_DROPPED_IN_ROW:
            break
    bench.period(10 * STATUS_PERIODS)
    assert len([text for text in texts(bench, "operation") if "takes no messages" in text]) == 1
    assert bench.run.gateway.state.name == "READY"


def test_the_loop_goes_on_when_the_socket_process_has_ended(bench: PortBench) -> None:
    bench.end.shutdown(socket.SHUT_RDWR)
    bench.period(10 * STATUS_PERIODS)
    (text,) = texts(bench, "operation")
    assert text.startswith("the socket process has ended")
    assert bench.run.gateway.state.name == "READY"


def test_setpoints_of_several_axes_are_all_given_or_none(bench: PortBench) -> None:
    good, bad = AxisSetpoint("horizontal", "0.03"), AxisSetpoint("rotation", "30")
    reply = bench.reply_to(SetpointsCall(setpoints=(good, bad)))
    assert not reply.accepted
    assert reply.text.startswith("no setpoint is changed: setpoint refused: rotation: setpoint")
    assert "setpoints of horizontal, rotation: no setpoint is changed" in texts(bench, "operator")[-1]
    assert bench.reply_to(SetpointsCall(setpoints=(bad,))).text.startswith("setpoint refused: rotation: ")
    assert bench.reply_to(ArmCall()).accepted
    started = bench.reply_to(StartCall())
    assert "horizontal approaches" not in started.text
    reply = bench.reply_to(SetpointsCall(setpoints=(good, AxisSetpoint("rotation", "0.2"))))
    assert reply.accepted
    lines = reply.text.splitlines()
    assert lines[0].startswith("horizontal: setpoint 0.03, approached now")
    assert lines[1].startswith("rotation: setpoint 0.2, approached now")


def test_the_tables_of_several_setpoints_are_used_for_their_axes(bench: PortBench) -> None:
    given = (
        AxisSetpoint("vertical", "csv:a.csv", "0,0\n1,0.02\n"),
        AxisSetpoint("rotation", "0.1"),
        AxisSetpoint("horizontal", "csv:b.csv", "0,0\n1,0.03\n"),
    )
    rig = bench.run.setup.rig
    requests = [SetpointRequest(*msgspec.structs.astuple(one)) for one in given]
    tables = [prepare_setpoint(request, rig) for request in requests if request.table]
    bench.number += 1
    call = SetpointsCall(setpoints=given)
    bench.end.send(msgspec.msgpack.encode(Asked(bench.number, WHO, call, None, tuple(filter(None, tables)))))
    bench.period()
    (reply,) = bench.replies()
    assert reply.accepted
    assert [line.partition(":")[0] for line in reply.text.splitlines()] == [
        "vertical",
        "rotation",
        "horizontal",
    ]
