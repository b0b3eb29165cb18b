"""Counts the frames on the bus of a run in the serving process. The loop has no part in it."""

from __future__ import annotations

from time import monotonic_ns, time_ns

from hil.core.errors import HilError
from hil.core.rig import read_rig
from hil.links import Link, open_link
from hil.links.opening import DEFAULT_BIT_RATE
from hil.views.bus_watch import BusWatch

INTERVAL_NS = 1_000_000_000
"""Time between two reports."""
MAX_FRAMES = 2000
"""Largest number of frames that are taken at once. A bus of 1 Mbit/s has 700 in one update."""


class BusListener:
    """Listens to a bus. It takes the frames that wait when it is asked, and is not woken by them.

    A process that wakes with each frame would take the processor, or half of its core, just when loop and
    boards answer each other. The kernel keeps the frames, with the instants of their arrival.
    """

    def __init__(self, bus: str, rig_text: str) -> None:
        """Begin to listen. A bus that cannot be opened is not reported.

        A serial adapter serves one program alone and is not opened.
        """
        self._link: Link | None = None
        if bus.startswith("slcan"):
            return
        try:
            rig = read_rig(rig_text, "rig.toml")
            self._bit_rate = rig.bus.bit_rate or DEFAULT_BIT_RATE
            self._link = open_link(bus, self._bit_rate)
        except (HilError, OSError):
            return
        self._watch = BusWatch(rig, self._bit_rate)
        self._next_ns = monotonic_ns() + INTERVAL_NS

    def take(self) -> dict[str, str] | None:
        """Take the frames that wait. Return counts by their names once a second, otherwise None."""
        if self._link is None:
            return None
        try:
            epoch_offset_ns = time_ns() - monotonic_ns()
            for _ in range(MAX_FRAMES):
                received = self._link.receive(0.0)
                if received is None:
                    break
                # A frame that came before the clock was set back has a stamp in the future.
                arrived_ns = min(received.stamp_ns - epoch_offset_ns, monotonic_ns())
                self._watch.receive(received.frame, arrived_ns)
        except (HilError, OSError):
            self.close()
            return None
        now_ns = monotonic_ns()
        if now_ns < self._next_ns:
            return None
        self._next_ns = now_ns + INTERVAL_NS
        status = self._watch.status(now_ns)
        return {
            "bus load": f"{100 * status.bus.load:.1f} % of {self._bit_rate / 1000:g} kbit/s",
            "frames on the bus": f"{status.bus.frames_per_s:.0f}/s",
            "SYNC, samples, commands": f"{status.gateway.sync_per_s:.0f}, "
            f"{status.samples.per_s:.0f}, {status.gateway.commands_per_s:.0f}/s",
        }

    def close(self) -> None:
        """Listen no more."""
        if self._link is not None:
            self._link.close()
            self._link = None
