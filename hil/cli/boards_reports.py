"""The connection to simulated boards in a process of their own, besides the bus.

Both sides write to a pair of sockets that keep the boundaries of messages, and neither waits for the other.
``firmware_sim.event_input`` is the other end.
"""

from __future__ import annotations

import contextlib
import socket
from collections import Counter
from collections.abc import Iterable

from firmware_sim.event_input import EVENT_REPORT, MAX_TEXT_BYTES, STATE_MESSAGE
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.core.output import Cycle, LogEntry
from hil.shells.session import Session
from hil.shells.simulated_faults import StateReports, event_entry, fault_entry, faults_by_instant

MAX_REPORTS_PER_PERIOD = 4
"""Number of reports that are taken in one period. The others wait in the socket."""


class BoardsReports:
    """Observer that tells the boards the gateway's state, and logs the faults and events that they report.

    ``boards`` is the socket to their process. It must not block. ``planned_faults`` and ``planned_events``
    are the texts of those that the boards know from the start. Only of these is kept which have begun: those
    that an operator asks for later are logged, and a daemon may see any number of them. :meth:`attach` comes
    before the first period.
    """

    def __init__(
        self, boards: socket.socket, planned_faults: Iterable[str] = (), planned_events: Iterable[str] = ()
    ) -> None:
        self._boards = boards
        self._session: Session | None = None
        self._states: StateReports | None = None
        self._origin_ns: int | None = None
        """Time at which the first period began, from which a recording counts."""
        self.faults_begun: list[tuple[int, str]] = []
        """Monotonic time in nanoseconds and text of each planned fault that has begun."""
        self.events_begun: list[tuple[int, str]] = []
        """Monotonic time in nanoseconds and text of each planned event that has begun."""
        self._awaited_faults = Counter(planned_faults)
        self._awaited_events = Counter(planned_events)

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
        """Take all reports that wait. Return the planned faults that have begun, by their seconds
        from the first period.
        """
        while self._take_report():
            pass
        return faults_by_instant(self.faults_begun, self._origin_ns or 0)

    def _take_report(self) -> bool:
        """Log a fault or event that the boards have reported, at its instant. Return False if none waits."""
        try:
            report = self._boards.recv(2 * MAX_TEXT_BYTES)
        except OSError:
            return False
        if not report or self._session is None:  # the boards have ended, which the gateway notices
            return False
        instant, kind, text = report.decode().split(" ", 2)
        at_ns = int(instant)
        if kind == EVENT_REPORT:
            entry, awaited, begun = event_entry(text), self._awaited_events, self.events_begun
        else:
            entry, awaited, begun = fault_entry(text), self._awaited_faults, self.faults_begun
        if awaited[text] > 0:
            awaited[text] -= 1
            begun.append((at_ns, text))
        self._session.note(entry, at_ns)
        return True

    def _tell(self, state: LifeCycleState) -> None:
        with contextlib.suppress(OSError):  # boards that have ended are noticed by their silence
            self._boards.send(f"{STATE_MESSAGE}{state.name.lower()}".encode())
