"""What a daemon does about requests that are not for the gateway core."""

from __future__ import annotations

import argparse
import socket
from typing import Any

import pytest

from hil.cli.daemon_actions import daemon_actions, event_check
from hil.core.output import LogEntry
from hil.core.requests import Reply
from hil.operation.protocol import EventCall, RecordNewCall, RecordStopCall, ShutdownCall
from hil.shells.run_plan import StopRequest

WHO = "alice (hil, process 7)"


class Noted:
    """A session that keeps its log entries and which recordings were asked for."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def note(self, entry: LogEntry) -> None:
        self.texts.append(entry.text)

    def record_new(self, asked_by: str) -> Reply:
        return Reply(True, f"new for {asked_by}")

    def record_stop(self, asked_by: str) -> Reply:
        return Reply(True, f"stopped for {asked_by}")


@pytest.fixture
def session() -> Any:
    return Noted()


def test_shutdown_asks_the_loop_to_stop(session: Any) -> None:
    stop = StopRequest()
    reply = daemon_actions(stop, None)[ShutdownCall](session, ShutdownCall(), WHO)
    assert reply.accepted
    assert stop.is_set
    assert session.texts == [f"{WHO} asks: shutdown"]


def test_an_event_goes_to_the_boards(session: Any) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        happen = daemon_actions(StopRequest(), ours)[EventCall]
        assert happen(session, EventCall(text="payload:3"), WHO).accepted
        assert theirs.recv(100) == b"payload:3"
        reply = happen(session, EventCall(text="hang:adc@vertical>0.05"), WHO)
        assert reply == Reply(True, "event hang:adc@vertical>0.05 waits for vertical > 0.05")
        assert theirs.recv(100) == b"hang:adc@vertical>0.05"
        theirs.close()
        assert "take no events" in happen(session, EventCall(text="payload:3"), WHO).text
    assert session.texts[0] == f"{WHO} asks: event payload:3"


def test_a_real_arm_has_no_events(session: Any) -> None:
    reply = daemon_actions(StopRequest(), None)[EventCall](session, EventCall(text="payload:3"), WHO)
    assert reply == Reply(False, "only simulated boards have events")


def test_recordings_are_the_sessions(session: Any) -> None:
    actions = daemon_actions(StopRequest(), None)
    assert actions[RecordNewCall](session, RecordNewCall(), WHO).text == f"new for {WHO}"
    assert actions[RecordStopCall](session, RecordStopCall(), WHO).text == f"stopped for {WHO}"


@pytest.mark.parametrize(
    ("linear", "plant", "check"),
    [(False, [], "check_arm_event"), (True, [], "check_model_event"), (False, ["a"], "check_model_event")],
)
def test_linear_models_have_faults_and_no_events(linear: bool, plant: list[str], check: str) -> None:
    options = argparse.Namespace(linear=linear, plant=plant)
    assert event_check(options) == f"firmware_sim.event_input:{check}"
