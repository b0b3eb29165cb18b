"""The connection to simulated boards in a process of their own, besides the bus.

Both sides write to a pair of sockets that keep the boundaries of messages, and neither waits for the other.
``firmware_sim.event_input`` is the other end.
"""

from __future__ import annotations

import contextlib
import socket

from firmware_sim.event_input import MAX_TEXT_BYTES, STATE_MESSAGE
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.core.output import Cycle, LogEntry
from hil.shells.session import Session
from hil.shells.simulated_faults import StateReports, fault_entry, faults_by_instant

MAX_REPORTS_PER_PERIOD = 4
"""Number of reports that are taken in one period. The others wait in the socket."""


class BoardsReports:
    """Observer that tells the boards the gateway's state, and logs the faults that they report.

    ``boards`` is the socket to their process. It must not block. :meth:`attach` comes before the first
    period.
    """

    def __init__(self, boards: socket.socket) -> None:
        self._boards = boards
        self._session: Session | None = None
        self._states: StateReports | None = None
        self._origin_ns: int | None = None
        """Time at which the first period began, from which a recording counts."""
        self._begun: list[tuple[int, str]] = []

    def attach(self, session: Session) -> None:
        """Take the session that is observed, and tell the boards the gateway's state."""
        self._session = session
        self._states = StateReports(session.gateway, self._tell)
        self._states.update()

    def log(self, _entry: LogEntry) -> None:
        """Tell the boards the state if it has changed."""
        if self._states is not None:
            self._states.update()

    def cycle(self, cycle: Cycle, _gateway: Gateway) -> None:
        """Take reports. All answers of the core in this period have been recorded."""
        if self._origin_ns is None:
            self._origin_ns = cycle.wake_ns
        for _ in range(MAX_REPORTS_PER_PERIOD):
            if not self._take_report():
                return

    def finish(self) -> dict[str, str]:
        """Take all reports that wait. Return all faults so far, by their seconds from the first period."""
        while self._take_report():
            pass
        return faults_by_instant(self._begun, self._origin_ns or 0)

    def _take_report(self) -> bool:
        """Log a fault that the boards have reported, at its instant. Return False if no report waits."""
        try:
            report = self._boards.recv(2 * MAX_TEXT_BYTES)
        except OSError:
            return False
        if not report or self._session is None:  # the boards have ended, which the gateway notices
            return False
        at_ns, _, text = report.decode().partition(" ")
        self._begun.append((int(at_ns), text))
        self._session.note(fault_entry(text), int(at_ns))
        return True

    def _tell(self, state: LifeCycleState) -> None:
        with contextlib.suppress(OSError):  # boards that have ended are noticed by their silence
            self._boards.send(f"{STATE_MESSAGE}{state.name.lower()}".encode())
