"""What was late in a run, and why, from its recording and the evidence of a witness."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from hil.recording.reader import Recording
from loaded.witness import Evidence

PERIOD_NS = 11_200_000
MARGIN_NS = 4_000_000
"""Tolerance between the clocks of run and witness, and the time between two readings of figures."""
WAITED_NS = 2_000_000
"""A process that waited longer for a processor was not scheduled. A witness that was late for longer shows
that the host or the kernel stalled."""


class Cause(StrEnum):
    """Why something was late."""

    HOST = "host or kernel stalled"
    DISK = "waited for the disk"
    STARVED = "not scheduled"
    GUEST = "slow guest"
    """User-mode Linux itself: it runs its programs in turns, and changes between them slowly."""
    OTHER = "other"


class Incident(NamedTuple):
    """One period that was missed. Times are epoch ns."""

    begin_ns: int
    end_ns: int
    is_loop: bool
    """True if the loop itself was late, False if the sample did not arrive in time."""


def incidents(recording: Recording) -> list[Incident]:
    """Return the periods from the first one in state running on in which something was late."""
    timing = recording.timing()
    controlled = np.flatnonzero(timing["running"])
    if not len(controlled):
        return []
    found = []
    before = -1
    for row in range(controlled[0], len(timing["number"])):
        deadline_ns, wake_ns = int(timing["deadline_ns"][row]), int(timing["wake_ns"][row])
        number = int(timing["number"][row])
        skipped = number - before - 1 if before >= 0 else 0
        before = number
        offset = recording.epoch_offset_ns
        if skipped or wake_ns - deadline_ns > PERIOD_NS // 2:
            begin_ns = deadline_ns - skipped * PERIOD_NS
            found.append(Incident(begin_ns + offset, wake_ns + offset, True))
        elif not timing["fresh"][row] and timing["running"][row]:
            found.append(Incident(wake_ns + offset, wake_ns + PERIOD_NS + offset, False))
    return found


def cause_of(incident: Incident, evidence: Evidence) -> tuple[Cause, str]:
    """Return the cause of an incident, and the figures that show it."""
    begin_ns, end_ns, is_loop = incident
    roles = ("loop", "guest") if is_loop else ("boards", "loop", "guest")
    stalled_ns = sum(
        min(woke_ns, end_ns) - max(due_ns, begin_ns - MARGIN_NS)
        for due_ns, woke_ns in evidence.stalls
        if due_ns < end_ns and woke_ns > begin_ns - MARGIN_NS
    )
    if stalled_ns > WAITED_NS:
        return Cause.HOST, f"the witness was late for {stalled_ns / 1e6:.1f} ms"
    shown: list[str] = []
    for role, changes in evidence.processes:
        if role not in roles:
            continue
        times = np.array([change[0] for change in changes])
        low = max(int(np.searchsorted(times, begin_ns - MARGIN_NS)) - 1, 0)
        high = int(np.searchsorted(times, end_ns + MARGIN_NS))
        window = changes[low:high]
        if not window:
            continue
        waited_ns, faults = (window[-1][field] - window[0][field] for field in (1, 2))
        if faults or any(change[3] == "D" for change in window):
            return (
                Cause.DISK,
                f"{role}: {faults} major page faults, states {{{','.join({c[3] for c in window})}}}",
            )
        if role == "guest":
            return Cause.GUEST, f"guest waited {waited_ns / 1e6:.1f} ms, also for its own programs"
        if waited_ns > WAITED_NS:
            return Cause.STARVED, f"{role} waited {waited_ns / 1e6:.1f} ms for a processor"
        shown.append(f"{role} waited {waited_ns / 1e6:.1f} ms")
    return Cause.OTHER, ", ".join(shown)
