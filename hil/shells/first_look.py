"""Measure the positions of the axes with centred valves, before anything may move."""

from __future__ import annotations

from time import monotonic_ns

from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.links import Link

TIMEOUT_S = 3.0
"""Time in which the boards must come up."""


def measured_positions(gateway: Gateway, link: Link, timeout_s: float = TIMEOUT_S) -> list[float] | None:
    """Bring the boards up with a new ``gateway``, and return the position of each axis.

    The gateway stays in state ready or before it, where all valves are centred. Returns None if the boards
    do not come up in time. Raises LinkError.
    """
    end_ns = monotonic_ns() + round(timeout_s * 1e9)
    while (now_ns := monotonic_ns()) < end_ns:
        received = link.receive(max(gateway.next_deadline_ns - now_ns, 0) * 1e-9)
        now_ns = monotonic_ns()
        if received is not None:
            output = gateway.receive(received.frame, now_ns)
        elif now_ns >= gateway.next_deadline_ns:
            output = gateway.on_deadline(now_ns)
        else:
            continue
        for frame in output.frames:
            link.send(frame)
        cycle = output.cycle
        if cycle is not None and cycle.fresh and gateway.state is LifeCycleState.READY:
            return [signals.position for signals in cycle.axes]
    return None
