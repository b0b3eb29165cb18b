"""What a daemon does about requests that are not for the gateway core."""

from __future__ import annotations

import argparse
import socket
from collections.abc import Mapping

from firmware_sim.event_input import beginning_text
from hil.core.output import LogEntry, Severity
from hil.core.requests import Reply
from hil.operation.protocol import EventCall, LoopCall, RecordNewCall, RecordStopCall, ShutdownCall
from hil.shells.operator_port import Action
from hil.shells.run_plan import StopRequest
from hil.shells.session import Session


def event_check(options: argparse.Namespace) -> str:
    """Return the function that checks the text of an event. The socket process imports it by this name.

    Only faults can happen if a linear model replaces the arm.
    """
    has_arm = not (options.linear or options.plant)
    return f"firmware_sim.event_input:{'check_arm_event' if has_arm else 'check_model_event'}"


def daemon_actions(stop: StopRequest, events: socket.socket | None) -> Mapping[type[LoopCall], Action]:
    """Return the action for each type of request.

    ``stop`` ends the daemon. ``events`` leads to the simulated boards; None if there are none.
    """

    def shut_down(session: Session, _call: ShutdownCall, asked_by: str) -> Reply:
        session.note(LogEntry(Severity.INFO, "operator", f"{asked_by} asks: shutdown"))
        stop.set()
        return Reply(True, "the daemon centres the valves, closes the recording and ends")

    def happen(session: Session, call: EventCall, asked_by: str) -> Reply:
        session.note(LogEntry(Severity.INFO, "operator", f"{asked_by} asks: event {call.text}"))
        if events is None:
            return Reply(False, "only simulated boards have events")
        try:
            events.send(call.text.encode())
        except OSError as error:
            return Reply(False, f"the simulated boards take no events: {error.strerror}")
        return Reply(True, f"event {call.text} {beginning_text(call.text)}")

    return {
        ShutdownCall: shut_down,
        EventCall: happen,
        RecordNewCall: lambda session, _call, asked_by: session.record_new(asked_by),
        RecordStopCall: lambda session, _call, asked_by: session.record_stop(asked_by),
    }
