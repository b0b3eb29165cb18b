"""What a daemon does about requests that are not for the gateway core."""

from __future__ import annotations

import argparse
import socket
from collections.abc import Mapping

from hil.core.output import LogEntry, Severity
from hil.core.requests import Reply
from hil.core.rig import Rig
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


def unseen_events(rig: Rig) -> dict[str, str]:
    """Return the events that the gateway cannot see, and the section that the rig file lacks."""
    inputs = {
        "emergency-stop": ("emergency_stop", rig.emergency_stop),
        "enable-switch": ("enable", rig.enable),
    }
    return {event: section for event, (section, settings) in inputs.items() if settings is None}


def daemon_actions(
    stop: StopRequest, events: socket.socket | None, unseen: Mapping[str, str] | None = None
) -> Mapping[type[LoopCall], Action]:
    """Return the action for each type of request.

    ``stop`` ends the daemon. ``events`` leads to the simulated boards; None if there are none. ``unseen``
    is the result of :func:`unseen_events`.
    """

    def shut_down(session: Session, _call: ShutdownCall, asked_by: str) -> Reply:
        session.note(LogEntry(Severity.INFO, "operator", f"{asked_by} asks: shutdown"))
        stop.set()
        return Reply(True, "the daemon centres the valves, closes the recording and ends")

    def happen(session: Session, call: EventCall, asked_by: str) -> Reply:
        session.note(LogEntry(Severity.INFO, "operator", f"{asked_by} asks: event {call.text}"))
        if events is None:
            return Reply(False, "only simulated boards have events")
        section = (unseen or {}).get(call.text.partition(":")[0])
        if section is not None:
            return Reply(
                False,
                f"the rig file has no [{section}], so the gateway would not see {call.text}; add it first",
            )
        try:
            events.send(call.text.encode())
        except OSError as error:
            return Reply(False, f"the simulated boards take no events: {error.strerror}")
        when = "is armed; its time counts from now" if "@" in call.text else "happens now"
        return Reply(True, f"event {call.text} {when}")

    return {
        ShutdownCall: shut_down,
        EventCall: happen,
        RecordNewCall: lambda session, _call, asked_by: session.record_new(asked_by),
        RecordStopCall: lambda session, _call, asked_by: session.record_stop(asked_by),
    }
