"""The loop's end of the pipe to the operators: takes requests and gives replies, status and log entries.

The port works after a period's command has left and again shortly before the next deadline. Each time it
takes at most ``MAX_REQUESTS_PER_TURN`` requests, so that a request takes effect within two periods. It never
waits. What the socket process does not take is dropped.
"""

from __future__ import annotations

import math
import socket
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec

from hil.core.gateway import Gateway
from hil.core.life_cycle import Trigger
from hil.core.output import AxisSignals, Cycle, LogEntry, Severity
from hil.core.printable import printable
from hil.core.requests import (
    CheckFailure,
    ControllerRequest,
    JogRequest,
    Reply,
    Request,
    SetpointRequest,
    arm_request,
)
from hil.operation.pipe import MAX_MESSAGE_BYTES, Asked, Logged, Replied, StatusNow
from hil.operation.protocol import (
    ALREADY_SHUTTING_DOWN,
    ArmCall,
    AxisStatus,
    ControllerCall,
    DisarmCall,
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
from hil.shells.session import Session

MAX_REQUESTS_PER_TURN = 2
"""Number of requests that are taken at one time, twice a period."""
SECOND_TURN_NS = 4_100_000
"""Time before a deadline from which on requests are taken a second time in a period."""
MIN_IDLE_NS = 3_000_000
"""Time that must be left until the deadline. Two requests take 0.5 ms, and 2.8 ms were once measured."""
STATUS_PERIODS = 9
"""Number of periods from one status to the next, about 0.1 s."""
MAX_DROPPED_IN_ROW = 20
"""This many messages in a row that the socket process did not take mean that it has stopped."""

Action = Callable[[Session, Any, str], Reply]
"""Takes the session, a request that is not for the core, and who asked. Returns the reply."""


class Described(NamedTuple):
    """Facts about the daemon that a status repeats."""

    bus: str
    is_simulated: bool
    axes: tuple[tuple[str, str], ...]
    """Name and unit of each axis."""
    period_s: float
    epoch_offset_ns: int
    """Epoch time minus monotonic time in ns."""
    calibrated_axis: str | None = None
    """Axis that is being calibrated."""


class OperatorPort:
    """The loop's end of the pipe. It observes the session that it serves.

    ``actions`` has what the daemon does about requests that are not for the core, by the type of the request.
    ``recording`` returns the path of the present recording, or None. ``clock_ns`` returns monotonic ns.
    """

    def __init__(
        self,
        pipe: socket.socket,
        described: Described,
        actions: Mapping[type[LoopCall], Action],
        recording: Callable[[], str | None],
        clock_ns: Callable[[], int],
        failures: tuple[CheckFailure, ...] = (),
    ) -> None:
        """``failures`` are the checks of this machine that have failed; they go into each request to arm."""
        self._pipe = pipe
        self._failures = failures
        self._described = described
        self._actions = actions
        self._recording = recording
        self._clock_ns = clock_ns
        self._decoder = msgspec.msgpack.Decoder(Asked | Logged)
        self._encode = msgspec.msgpack.Encoder().encode
        self._cycle: Cycle | None = None
        self._max_lateness_ns = 0
        """Largest delay of a period since the last regular status."""
        self._max_lateness_since_start_ns = 0
        self._sampled_ns: int | None = None
        """Begin of the last period with a good sample."""
        self._is_due = False
        """True between the end of a period and the next call of ``serve``."""
        self._period_ns = round(described.period_s * 1e9)
        self._turn_ns = 0
        """Deadline before which operators were served a second time."""
        self._is_open = True
        self._dropped_in_row = 0
        self._next_status = 0
        """Number of the period from which on a status is sent."""

    def log(self, entry: LogEntry) -> None:
        """Pass on a log entry."""
        time_ns = self._clock_ns() + self._described.epoch_offset_ns
        self._send(Logged(LogLine(time_ns, int(entry.severity), entry.source, entry.text)))

    def cycle(self, cycle: Cycle, _gateway: Gateway) -> None:
        """Take a completed period."""
        self._cycle = cycle
        self._is_due = True
        late_ns = cycle.wake_ns - cycle.deadline_ns
        self._max_lateness_ns = max(self._max_lateness_ns, late_ns)
        self._max_lateness_since_start_ns = max(self._max_lateness_since_start_ns, late_ns)
        if cycle.fresh:
            self._sampled_ns = cycle.wake_ns

    def serve(self, session: Session) -> None:
        """Take the requests that wait, if it is time for it. Raises LinkError.

        It is time once after a period's command has left, and once more shortly before the next deadline.
        """
        if not self._is_due and not self._is_second_turn(session):
            return
        self._is_due = False
        is_changed = self._take_requests(session)
        cycle = self._cycle
        if cycle is not None and (is_changed or cycle.number >= self._next_status):
            self._next_status = cycle.number + STATUS_PERIODS
            self._send(StatusNow(self._status(cycle, session.gateway)))
            self._max_lateness_ns = 0
        if self._dropped_in_row >= MAX_DROPPED_IN_ROW and self._is_open:
            self._dropped_in_row = -(10**9)  # one report
            session.note(
                LogEntry(
                    Severity.ERROR,
                    "operation",
                    "the socket process takes no messages: clients get no answers; the loop goes on",
                )
            )

    def _is_second_turn(self, session: Session) -> bool:
        """Return whether it is shortly before a deadline, for the first time and with enough time left.

        The present period must be complete: a sample that is late must not wait for operators.
        """
        deadline_ns = session.gateway.next_deadline_ns
        cycle = self._cycle
        if deadline_ns == self._turn_ns or cycle is None or deadline_ns - cycle.deadline_ns > self._period_ns:
            return False
        if not MIN_IDLE_NS <= deadline_ns - self._clock_ns() <= SECOND_TURN_NS:
            return False
        self._turn_ns = deadline_ns
        return True

    def _take_requests(self, session: Session) -> bool:
        """Take some requests. Return whether there were any."""
        replies: list[Replied] = []
        for _ in range(MAX_REQUESTS_PER_TURN if self._is_open else 0):
            try:
                data = self._pipe.recv(MAX_MESSAGE_BYTES)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if not data:
                self._close(session)
                break
            try:
                asked = self._decoder.decode(data)
            except ValueError:
                continue  # nobody waits for an answer to it
            if isinstance(asked, Logged):
                line = asked.line
                session.note(LogEntry(Severity(line.severity), line.source, line.text))
                continue
            accepted, text = self._operate(session, asked)
            replies.append(Replied(asked.number, accepted, text))
        if replies and self._cycle is not None:
            # First the status, so that a client that asks for it after its reply sees the effect.
            self._send(StatusNow(self._status(self._cycle, session.gateway)))
        for reply in replies:
            self._send(reply)
        return bool(replies)

    def _operate(self, session: Session, asked: Asked) -> Reply:
        if session.plan.ending is not None:
            if isinstance(asked.call, ShutdownCall):
                return Reply(True, ALREADY_SHUTTING_DOWN)
            # A start or a jog now would move a valve after the last commands that centre it.
            reply = Reply(False, "refused: the daemon is ending, with centred valves")
            session.note(LogEntry(Severity.WARNING, "operator", f"{asked.asked_by}: {reply.text}"))
            return reply
        if isinstance(asked.call, SetpointsCall):
            return _set_setpoints(session, asked.call, asked)
        request = _core_request(asked.call, self._failures)
        if request is not None:
            return session.operate(request, asked.asked_by, asked.prepared or next(iter(asked.tables), None))
        action = self._actions.get(type(asked.call))
        if action is None:
            return Reply(False, "this daemon does not know the request")
        return action(session, asked.call, asked.asked_by)

    def _status(self, cycle: Cycle, gateway: Gateway) -> Status:
        described = self._described
        return Status(
            state=gateway.state.name.lower(),
            fault=gateway.fault_reason,
            readiness=gateway.readiness,
            bus=described.bus,
            is_simulated=described.is_simulated,
            period=cycle.number,
            period_s=described.period_s,
            time_ns=cycle.wake_ns + described.epoch_offset_ns,
            max_lateness_ms=self._max_lateness_ns / 1e6,
            missed_periods=gateway.missed_periods,
            rejected_frames=gateway.rejected_frames,
            lost_samples=gateway.lost_samples,
            recording=self._recording(),
            max_lateness_since_start_ms=self._max_lateness_since_start_ns / 1e6,
            calibrated_axis=described.calibrated_axis,
            overridden_checks=gateway.overridden_checks,
            sample_age_s=None if self._sampled_ns is None else (cycle.wake_ns - self._sampled_ns) * 1e-9,
            axes=tuple(
                _axis_status(name, unit, signals)
                for (name, unit), signals in zip(described.axes, cycle.axes, strict=True)
            ),
        )

    def _send(self, message: msgspec.Struct) -> None:
        if not self._is_open:
            return
        try:
            self._pipe.send(self._encode(message))
        except OSError:
            self._dropped_in_row += 1
        else:
            self._dropped_in_row = 0

    def _close(self, session: Session) -> None:
        """Go on without operators."""
        self._is_open = False
        session.note(
            LogEntry(
                Severity.ERROR,
                "operation",
                "the socket process has ended: no client can operate this daemon any more; the loop goes on, "
                "and SIGTERM ends it",
            )
        )


_TRIGGERS: dict[type[LoopCall], Trigger] = {
    DisarmCall: Trigger.DISARM,
    StartCall: Trigger.START,
    StopCall: Trigger.STOP,
    ResetCall: Trigger.RESET,
}


def _core_request(call: LoopCall, failures: tuple[CheckFailure, ...]) -> Request | None:
    """Return the core's request, or None if the request is not for the core."""
    match call:
        case ArmCall():
            return arm_request(failures, call.override)
        case SetpointCall():
            return SetpointRequest(call.axis, call.setpoint, call.table)
        case ControllerCall():
            return ControllerRequest(call.axis, call.name, call.document)
        case JogCall():
            return JogRequest(call.axis, call.offset_v, call.duration_s)
    return _TRIGGERS.get(type(call))


def _set_setpoints(session: Session, call: SetpointsCall, asked: Asked) -> Reply:
    """Give the core every setpoint of a request, or none if one is refused.

    The check changes nothing. So the recording has the setpoints that were given, one by one.
    """
    tables = iter(asked.tables)
    requests = [
        (SetpointRequest(one.axis, one.setpoint, one.table), next(tables, None) if one.table else None)
        for one in call.setpoints
    ]
    refusals = [
        reply.text
        for request, table in (requests if len(requests) > 1 else [])  # The core itself checks one.
        if (reply := session.gateway.refuse_setpoint(request, table)) is not None
    ]
    if refusals:
        reply = Reply(False, f"no setpoint is changed: {'; '.join(refusals)}")
        text = printable(f"{asked.asked_by} asks: setpoints of {_axes_of(call)}: {reply.text}")
        session.note(LogEntry(Severity.WARNING, "operator", text))
        return reply
    lines: list[str] = []
    is_accepted = True
    for request, table in requests:
        reply = session.operate(request, asked.asked_by, table)
        is_accepted = is_accepted and reply.accepted
        # A refusal names its axis.
        lines.append(f"{request.axis}: {reply.text}" if reply.accepted else reply.text)
    return Reply(is_accepted, "\n".join(lines))


def _axes_of(call: SetpointsCall) -> str:
    return ", ".join(one.axis for one in call.setpoints)


def _axis_status(name: str, unit: str, signals: AxisSignals) -> AxisStatus:
    return AxisStatus(name, unit, *(v if math.isfinite(v) else None for v in signals[:6]))
