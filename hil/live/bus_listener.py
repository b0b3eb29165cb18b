"""Listens to the bus of a run in the serving process, for rates and load. The loop has no part in it."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from time import monotonic_ns

from hil.core.errors import HilError
from hil.core.rig import read_rig
from hil.links import open_link
from hil.views.bus_watch import BusWatch

BIT_RATE = 500_000
"""Bit rate of the rig's bus in bit/s, from which the load is computed."""
INTERVAL_NS = 1_000_000_000
"""Time between two reports."""


def listen(bus: str, rig_text: str, report: Callable[[dict[str, str]], None]) -> None:
    """Start a thread that listens to ``bus`` and reports counts by their names, once a second.

    A serial adapter serves one program alone and is not opened. A bus that cannot be opened, or fails, is not
    reported.
    """
    if not bus.startswith("slcan"):
        threading.Thread(target=_listen, args=(bus, rig_text, report), daemon=True).start()


def _listen(bus: str, rig_text: str, report: Callable[[dict[str, str]], None]) -> None:
    with contextlib.suppress(HilError, OSError), open_link(bus) as link:
        watch = BusWatch(read_rig(rig_text, "rig.toml"), BIT_RATE)
        next_ns = monotonic_ns() + INTERVAL_NS
        while True:
            received = link.receive(0.2)
            now_ns = monotonic_ns()
            if received is not None:
                watch.receive(received.frame, now_ns)
            if now_ns >= next_ns:
                next_ns = now_ns + INTERVAL_NS
                status = watch.status(now_ns)
                report(
                    {
                        "bus load": f"{100 * status.bus.load:.1f} % of {BIT_RATE // 1000} kbit/s",
                        "frames on the bus": f"{status.bus.frames_per_s:.0f}/s",
                        "SYNC, samples, commands": f"{status.gateway.sync_per_s:.0f}, "
                        f"{status.samples.per_s:.0f}, {status.gateway.commands_per_s:.0f}/s",
                    }
                )
