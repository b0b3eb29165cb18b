"""Listens to the bus of a run in the serving process, for rates and load. The loop has no part in it."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from time import monotonic_ns

from hil.core.errors import HilError
from hil.core.rig import Rig, read_rig
from hil.links import open_link
from hil.links.opening import DEFAULT_BIT_RATE
from hil.views.bus_watch import BusWatch

INTERVAL_NS = 1_000_000_000
"""Time between two reports."""


def listen(bus: str, rig_text: str, report: Callable[[dict[str, str]], None], ended: threading.Event) -> None:
    """Start a thread that listens to ``bus`` until ``ended``, and reports counts by name once a second.

    A serial adapter serves one program alone and is not opened. A bus that cannot be opened, or fails, is not
    reported.
    """
    if bus.startswith("slcan"):
        return
    try:
        # Not in the thread: msgspec crashes if two threads use a type for the first time at once, and after a
        # restart of the daemon the thread of the former run may not have ended.
        rig = read_rig(rig_text, "rig.toml")
    except HilError:
        return
    threading.Thread(target=_listen, args=(bus, rig, report, ended), daemon=True).start()


def _listen(bus: str, rig: Rig, report: Callable[[dict[str, str]], None], ended: threading.Event) -> None:
    bit_rate = rig.bus.bit_rate or DEFAULT_BIT_RATE
    with contextlib.suppress(HilError, OSError), open_link(bus, bit_rate) as link:
        watch = BusWatch(rig, bit_rate)
        next_ns = monotonic_ns() + INTERVAL_NS
        while not ended.is_set():
            received = link.receive(0.2)
            now_ns = monotonic_ns()
            if received is not None:
                watch.receive(received.frame, now_ns)
            if now_ns >= next_ns:
                next_ns = now_ns + INTERVAL_NS
                status = watch.status(now_ns)
                report(
                    {
                        "bus load": f"{100 * status.bus.load:.1f} % of {bit_rate / 1000:g} kbit/s",
                        "frames on the bus": f"{status.bus.frames_per_s:.0f}/s",
                        "SYNC, samples, commands": f"{status.gateway.sync_per_s:.0f}, "
                        f"{status.samples.per_s:.0f}, {status.gateway.commands_per_s:.0f}/s",
                    }
                )
