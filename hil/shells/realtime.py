"""The real-time shell: CLOCK_MONOTONIC, absolute deadlines, one thread, one link.

A late wake-up is followed by one period, never by a burst. Frames that wait are taken before a late deadline
is served, so that an answer to the last SYNC is not mistaken for one to the next.
"""

from __future__ import annotations

from time import monotonic_ns

from hil.errors import LinkError
from hil.links import Link
from hil.shells.run_plan import Ending, StopRequest
from hil.shells.session import Session

MOST_WAITING_FRAMES = 64
"""Frames taken from a backlog before a due deadline is served all the same."""


def run(session: Session, link: Link, stop: StopRequest) -> None:
    """Run until the session's plan is over. A failing link ends the run with centred valves."""
    while not session.plan.is_over:
        try:
            _one_step(session, link)
        except LinkError as error:
            session.link_failed(str(error))
            return
        if stop.is_set:
            session.plan.end(Ending.INTERRUPTED)


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
