"""Planned faults and events of simulated boards: what is reported of them, and what never began."""

from __future__ import annotations

import argparse
import socket
from collections.abc import Iterable

from firmware_sim.arm.event_text import event_text
from firmware_sim.faults.fault_text import fault_text
from firmware_sim.simulated_plant import arm_events, events_not_begun, faults_not_begun, planned_faults
from hil.cli.boards_reports import BoardsReports
from hil.core.output import LogEntry, Severity
from hil.recording.recorder import EVENT_SOURCE, FAULT_SOURCE
from hil.shells.session import Session


def planned_reports(boards: socket.socket, options: argparse.Namespace) -> BoardsReports:
    """Return the observer of boards with the planned faults and events of ``options``."""
    return BoardsReports(
        boards, map(fault_text, planned_faults(options)), map(event_text, arm_events(options))
    )


def note_not_begun(
    session: Session,
    options: argparse.Namespace,
    faults_begun: Iterable[tuple[int, str]],
    events_begun: Iterable[tuple[int, str]],
) -> None:
    """Log, at the end of a run, the planned faults and events that have not begun.

    ``faults_begun`` and ``events_begun`` have time in nanoseconds and text of those that have.
    """
    for sentence in faults_not_begun(options, [text for _, text in faults_begun]):
        session.note(LogEntry(Severity.WARNING, FAULT_SOURCE, sentence))
    for sentence in events_not_begun(options, [text for _, text in events_begun]):
        session.note(LogEntry(Severity.WARNING, EVENT_SOURCE, sentence))
