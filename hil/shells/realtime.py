"""The real-time shell: CLOCK_MONOTONIC, absolute deadlines, one thread, one link.

A late wake-up is followed by one period, never by a burst. Frames that wait are taken before a late deadline
is served, so that an answer to the last SYNC is not mistaken for one to the next. However a run ends, the
valves are centred, as far as anything can still be sent.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from time import monotonic_ns, sleep

from hil.core.errors import LinkError
from hil.core.output import LogEntry, Severity
from hil.links import Link
from hil.shells.run_plan import CENTRING_PERIODS, Ending, StopRequest
from hil.shells.session import Session

MOST_WAITING_FRAMES = 64
"""Frames taken from a backlog before a due deadline is served all the same."""
CENTRING_PATIENCE_NS = 1_000_000_000
"""After a failure, centring is tried for so long: the board's watchdog has centred the valves by then."""


def run(session: Session, link: Link, stop: StopRequest) -> Exception | None:
    """Run until the session's plan is over. A failing link ends the run, and so does an error in here.

    Returns that error: a mistake of this program, or of a library, to be reported.
    """
    unreadable = _Unreadable()
    while not session.plan.is_over:
        try:
            _one_step(session, link)
            unreadable.tell(session, link)
        except LinkError as error:
            _end(session, link, Ending.LINK, str(error))
            return None
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            _end(session, link, Ending.ERROR, f"internal error: {text}")
            session.note(LogEntry(Severity.FATAL, "hil", f"internal error, the run was ended: {text}"))
            return error
        if stop.is_set:
            session.plan.end(Ending.INTERRUPTED)
    return None


class _Unreadable:
    """Tells of what the link discards: the first, then whenever its number has doubled."""

    def __init__(self) -> None:
        self._next = 1

    def tell(self, session: Session, link: Link) -> None:
        if link.unreadable < self._next:
            return
        self._next = 2 * link.unreadable
        text = f"{link.unreadable} unreadable frames discarded so far: none of classic CAN, or garbled"
        session.note(LogEntry(Severity.WARNING, "link", text))


def _one_step(session: Session, link: Link) -> None:
    """Take what arrives before the next deadline, or serve the deadline."""
    remaining_ns = session.gateway.next_deadline_ns - monotonic_ns()
    if remaining_ns > 0:
        _take(session, link, remaining_ns * 1e-9)
        return
    for _ in range(MOST_WAITING_FRAMES):
        if not _take(session, link, 0.0):
            break
    session.on_deadline(monotonic_ns())


def _take(session: Session, link: Link, timeout_s: float) -> bool:
    received = link.receive(timeout_s)
    if received is None:
        return False
    session.receive(received.frame, monotonic_ns(), received.stamp_ns)
    return True


def _end(session: Session, link: Link, ending: Ending, reason: str) -> None:
    """Fault, then centre the valves for some periods, on a link that is opened anew where it fails; tell."""
    end_ns = monotonic_ns() + CENTRING_PATIENCE_NS
    may_go_on = _attempt(link, lambda: session.failed(ending, reason))
    while may_go_on and session.commands_taken < CENTRING_PERIODS and monotonic_ns() < end_ns:
        sleep(max(session.gateway.next_deadline_ns - monotonic_ns(), 0) * 1e-9)
        may_go_on = _attempt(link, lambda: session.on_deadline(monotonic_ns()))
    taken = session.commands_taken
    if taken >= CENTRING_PERIODS:
        event = LogEntry(Severity.INFO, "link", f"the valves were centred: the command left {taken} times")
    else:
        text = f"the command that centres the valves left {taken} times, not {CENTRING_PERIODS}"
        watchdog = "the DAC board's watchdog has to centre them (rig: dac.watchdog_timeout_s)"
        event = LogEntry(Severity.ERROR, "link", f"{text}: {watchdog}")
    session.note(event)


def _attempt(link: Link, act: Callable[[], None]) -> bool:
    """Try to send; where the link fails, open it anew. False: this program itself fails."""
    try:
        act()
    except LinkError:
        with contextlib.suppress(LinkError):
            link.reopen()
    except Exception:
        return False
    return True
