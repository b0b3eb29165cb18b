"""One gateway per bus: listen before the first frame is sent, and refuse a bus that another gateway uses."""

from __future__ import annotations

from time import monotonic

from hil.core.errors import LinkError
from hil.core.foreign_frames import OWN_IDENTIFIERS
from hil.links import Link

MAX_FRAMES = 10_000
"""Largest number of frames that are read while listening."""
MARGIN = 1.5
"""The time of listening is this many intervals of the gateway's heartbeat."""


def refuse_other_gateway(link: Link, heartbeat_interval_s: float) -> None:
    """Listen for longer than a heartbeat interval. Raises LinkError if another gateway is heard.

    Nothing is sent, so that a gateway that controls an arm is not disturbed.
    """
    end_s = monotonic() + MARGIN * heartbeat_interval_s
    for _ in range(MAX_FRAMES):
        received = link.receive(max(end_s - monotonic(), 0.0))
        if received is None:
            return
        frame = received.frame
        is_plain = not (frame.is_extended or frame.is_remote or frame.is_error)
        if is_plain and frame.id in OWN_IDENTIFIERS:
            raise LinkError(
                f"{link.spec}: another gateway is on this bus: its {OWN_IDENTIFIERS[frame.id]} frame "
                f"(0x{frame.id:03X}) was heard. Nothing was sent. End the other one first; `hil shutdown` "
                "ends a daemon of this machine"
            )
