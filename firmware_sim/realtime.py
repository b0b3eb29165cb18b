"""The simulated boards in real time: a rig on a bus, driven by CLOCK_MONOTONIC."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic_ns, time_ns
from typing import TYPE_CHECKING, Protocol

from firmware_sim.faulty_rig import FaultyRig
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.frames import Frame

if TYPE_CHECKING:
    from hil.links import Received

_MAX_CLOCK_DELAY_NS = 50_000
"""Two clocks count as read simultaneously if this takes at most so much longer than on a quiet machine."""
_CLOCK_READINGS = 10
"""Number of attempts to read both clocks simultaneously."""


class Bus(Protocol):
    """The bus of the boards: a ``hil.links.Link`` or a ``SerialDevice``."""

    def send(self, frame: Frame) -> object: ...  # noqa: D102
    def receive(self, timeout_s: float) -> Received | None: ...  # noqa: D102
    def close(self) -> None: ...  # noqa: D102


class Watch(Protocol):
    """A display of the plant, called again and again; it must not block."""

    def update(self, now_ns: int) -> None: ...  # noqa: D102


def simulate(
    rig: SimulatedRig | FaultyRig,
    bus: Bus,
    watch: Watch | None = None,
    is_over: Callable[[], bool] = lambda: False,
) -> None:
    """Power the boards on and run them until ``is_over`` returns True or an exception is raised.

    A frame is handled at the instant of its arrival, and before any deadline after that instant. This process
    may have been delayed when a real board would not: then no watchdog acts because of commands that arrived
    in time. The kernel may also deliver a frame after a later deadline was handled; such a frame still counts
    as arrived before it.

    Raises LinkError if the bus fails, and the HilError of a plant that fails. The boards are silent after
    that.
    """
    clock = _ArrivalClock()
    now_ns = frame_ns = monotonic_ns()
    frames = rig.start(now_ns)
    while not is_over():
        for frame in frames:
            bus.send(frame)
        if watch is not None:
            watch.update(now_ns)
        asked_ns = monotonic_ns()
        received = bus.receive(max(rig.next_deadline_ns - asked_ns, 0) * 1e-9)
        if received is None:
            # No frame arrived before the deadline. A frame that arrives while this process is delayed is not
            # late.
            now_ns = max(rig.next_deadline_ns, asked_ns)
            frames = rig.on_deadline(now_ns)
        else:
            now_ns = frame_ns = max(clock.arrival_ns(received.stamp_ns), frame_ns)
            frames = rig.receive(received.frame, now_ns)


class _ArrivalClock:
    """Converts the stamps of frames (wall clock) to CLOCK_MONOTONIC.

    The conversion uses a frame's age, because the wall clock may be set while the program runs. Both clocks
    are read again if this process was delayed between them. How long the readings take without a delay is
    measured at the start: 0.1 us each on most machines, 35 us each in user-mode Linux.
    """

    def __init__(self) -> None:
        readings = (self._read() for _ in range(_CLOCK_READINGS))
        self._max_gap_ns = min(after - before for before, _, after in readings) + _MAX_CLOCK_DELAY_NS

    def arrival_ns(self, stamp_ns: int) -> int:
        """Return the monotonic time at which a frame with this stamp arrived."""
        for _ in range(_CLOCK_READINGS):
            before_ns, wall_ns, after_ns = self._read()
            if after_ns - before_ns < self._max_gap_ns:
                break  # otherwise this process was delayed between the two clocks
        return before_ns - max(wall_ns - stamp_ns, 0)

    def _read(self) -> tuple[int, int, int]:
        return monotonic_ns(), time_ns(), monotonic_ns()
