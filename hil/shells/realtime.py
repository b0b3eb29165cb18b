"""The real-time shell: CLOCK_MONOTONIC, absolute deadlines, one thread, one link.

A late wake-up is followed by one period, never by a burst of periods. Frames that wait are read before a
late deadline is served, so that the answer to the last SYNC is not taken for an answer to the next one.
However a run ends, the valves are centred, as long as anything can still be sent.

The kernel wakes a thread some 20 to 200 us after the time that was asked for. The loop can therefore wake up
shortly before a deadline, and then poll the link and the clock until the deadline (:class:`Polling`). Frames
that arrive meanwhile are served at once. After SYNC, the loop can poll for the sample that answers it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from time import monotonic_ns, sleep
from typing import NamedTuple

from hil.core.errors import LinkError
from hil.core.output import LogEntry, Severity
from hil.links import Link
from hil.shells.lead_time import LeadTime
from hil.shells.run_plan import CENTRING_PERIODS, Ending, StopRequest
from hil.shells.session import Session

MAX_WAITING_FRAMES = 64
"""Number of waiting frames that are read before a deadline that is due is served all the same."""
OPERATORS_TURN_NS = 4_000_000
"""Time before each deadline at which operators are served once more. Loops with a shorter period omit it."""
PUNCTUAL_NS = 20_000
"""Lateness up to which frames are not read again before a deadline, because polling has just read them."""
MAX_SAMPLE_POLL_SHARE = 4
"""The loop polls for a sample during at most one such part of the time until the next deadline."""
CENTRING_TIMEOUT_NS = 1_000_000_000
"""Time for which centring is tried after a failure. Then the board's watchdog has centred the valves."""


class Polling(NamedTuple):
    """Times in which the loop polls instead of sleeping, in nanoseconds. 0 means that it sleeps."""

    before_deadline_ns: int = 0
    for_sample_ns: int = 0
    """Longest time after SYNC, in state running."""
    rehearse: Callable[[], None] | None = None
    """Called before each deadline, to fill the processor's caches. It must neither wait nor fail."""
    max_rehearsal_ns: int = 1_000_000
    """A rehearsal that takes longer is omitted."""


NO_POLLING = Polling()


def run(
    session: Session,
    link: Link,
    stop: StopRequest,
    serve_operators: Callable[[Session], None] | None = None,
    polling: Polling = NO_POLLING,
) -> Exception | None:
    """Run until the session's plan is over, the link fails, or an internal error occurs.

    ``serve_operators`` is called after each frame and each deadline that was served, and
    ``OPERATORS_TURN_NS`` before each deadline. It must not wait.

    Returns the internal error, for a report, or None. It is a defect of this program or of a library.
    """
    unreadable = _UnreadableFrames(session, link)
    lead = LeadTime(polling.before_deadline_ns, polling.max_rehearsal_ns if polling.rehearse else 0)
    while not session.plan.is_over:
        try:
            if serve_operators is None or not _await_operators_turn(session, link):
                _step(session, link, polling, lead)
            unreadable.report()
            if serve_operators is not None:
                serve_operators(session)
        except LinkError as error:
            _end(session, link, Ending.LINK, str(error))
            return None
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            _end(session, link, Ending.ERROR, f"internal error: {text}")
            session.note(LogEntry(Severity.FATAL, "hil", f"an internal error ended the run: {text}"))
            return error
        if stop.is_set:
            session.plan.end(Ending.INTERRUPTED)
    return None


class _UnreadableFrames:
    """Reports the frames that the link discards: the first one, then each time their number has doubled."""

    def __init__(self, session: Session, link: Link) -> None:
        self._session = session
        self._link = link
        self._next_reported = 1

    def report(self) -> None:
        """Report the discarded frames if there are enough new ones."""
        count = self._link.unreadable
        if count < self._next_reported:
            return
        self._next_reported = 2 * count
        text = f"{count} unreadable frames discarded so far: not classic CAN, or corrupt"
        self._session.note(LogEntry(Severity.WARNING, "link", text))


def _await_operators_turn(session: Session, link: Link) -> bool:
    """Take one frame that arrives before the operators' turn. Return False if it is their turn or later."""
    remaining_ns = session.gateway.next_deadline_ns - OPERATORS_TURN_NS - monotonic_ns()
    if remaining_ns <= 0:
        return False
    _receive(session, link, remaining_ns * 1e-9)
    return True


def _step(session: Session, link: Link, polling: Polling, lead: LeadTime) -> None:
    """Take one frame that arrives before the next deadline, or serve the deadline."""
    deadline_ns = session.gateway.next_deadline_ns
    remaining_ns = deadline_ns - monotonic_ns()
    # After the timeout, polling begins at once: a way through the caller would take 50 us with cold caches.
    if remaining_ns > lead.ns and _receive(session, link, (remaining_ns - lead.ns) * 1e-9):
        return
    if polling.rehearse is not None:
        _rehearse(polling.rehearse, lead, deadline_ns)
    now_ns = _poll(session, link, deadline_ns)
    if now_ns - deadline_ns > PUNCTUAL_NS:
        for _ in range(MAX_WAITING_FRAMES):
            if not _receive(session, link, 0.0):
                break
        now_ns = monotonic_ns()
    session.on_deadline(now_ns)
    if polling.for_sample_ns > 0:
        _poll_for_sample(session, link, now_ns, polling.for_sample_ns)


def _rehearse(rehearse: Callable[[], None], lead: LeadTime, deadline_ns: int) -> None:
    """Rehearse a period, unless it would not be over before the deadline."""
    began_ns = monotonic_ns()
    if deadline_ns - began_ns <= lead.rehearsal_ns:
        lead.omitted()
        return
    rehearse()
    lead.measured(monotonic_ns() - began_ns)


def _poll_for_sample(session: Session, link: Link, sync_ns: int, for_sample_ns: int) -> None:
    """Serve frames without sleeping until the sample has been answered, or for a limited time."""
    gateway = session.gateway
    end_ns = sync_ns + min(for_sample_ns, (gateway.next_deadline_ns - sync_ns) // MAX_SAMPLE_POLL_SHARE)
    while gateway.awaits_sample and monotonic_ns() < end_ns:
        _receive(session, link, 0.0)


def _poll(session: Session, link: Link, deadline_ns: int) -> int:
    """Serve frames without sleeping until the deadline. Return the time, which is not before the deadline."""
    while (now_ns := monotonic_ns()) < deadline_ns:
        _receive(session, link, 0.0)
    return now_ns


def _receive(session: Session, link: Link, timeout_s: float) -> bool:
    """Give the session one frame from the link. Return False if none arrived in time."""
    received = link.receive(timeout_s)
    if received is None:
        return False
    session.receive(received.frame, monotonic_ns(), received.stamp_ns)
    return True


def _end(session: Session, link: Link, ending: Ending, reason: str) -> None:
    """Fault, then send the command that centres the valves for some periods, and report whether it was sent.

    A link that fails is opened again.
    """
    end_ns = monotonic_ns() + CENTRING_TIMEOUT_NS
    may_continue = _attempt(link, lambda: session.end_with_failure(ending, reason))
    while may_continue and session.commands_taken < CENTRING_PERIODS and monotonic_ns() < end_ns:
        sleep(max(session.gateway.next_deadline_ns - monotonic_ns(), 0) * 1e-9)
        may_continue = _attempt(link, lambda: session.on_deadline(monotonic_ns()))
    session.note(_describe_centring(session.commands_taken))


def _attempt(link: Link, action: Callable[[], None]) -> bool:
    """Try to send. Open the link again if it fails. Return False after an internal error."""
    try:
        action()
    except LinkError:
        with contextlib.suppress(LinkError):
            link.reopen()
    except Exception:
        return False
    return True


def _describe_centring(commands_sent: int) -> LogEntry:
    if commands_sent >= CENTRING_PERIODS:
        text = f"the valves were centred: the command was sent {commands_sent} times"
        return LogEntry(Severity.INFO, "link", text)
    return LogEntry(
        Severity.ERROR,
        "link",
        f"the command that centres the valves was sent {commands_sent} times, not {CENTRING_PERIODS}: "
        "the DAC board's watchdog has to centre them (rig: dac.watchdog_timeout_s)",
    )
