"""The lockstep shell: gateway and simulated boards in one process, in simulated time.

Time jumps to the next deadline of either side. Frames arrive at once and in order; ``lockstep_bus`` has a
shell in which they take time. The same setup gives the same calls in every run. A host that stalls serves its
deadlines late: frames wait for it, and it reads them before the deadline that is overdue, as the real-time
shell does.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.shells.run_plan import Ending, StopRequest
from hil.shells.session import Session


class Boards(Protocol):
    """The boards at the other end of the bus:

    a core without I/O, as the gateway is. Times are nanoseconds.
    """

    @property
    def next_deadline_ns(self) -> int:
        """Time at which ``on_deadline`` is to be called next."""

    def start(self, now_ns: int) -> tuple[Frame, ...]:
        """Switch the boards on, and return the frames that they send."""

    def receive(self, frame: Frame, now_ns: int) -> tuple[Frame, ...]:
        """Take a frame from the gateway, and return the frames that the boards send."""

    def on_deadline(self, now_ns: int) -> tuple[Frame, ...]:
        """Serve the boards' deadline, and return the frames that they send."""


class GatewaySide(Protocol):
    """The gateway's end of the bus: the core, and the calls that a shell makes for it."""

    @property
    def gateway(self) -> Gateway:
        """The core."""

    def receive(self, frame: Frame, now_ns: int, stamp_ns: int) -> None:
        """Give the core a frame."""

    def on_deadline(self, now_ns: int) -> None:
        """Serve the core's deadline."""


class Host(Protocol):
    """The computer on which the gateway runs, with its faults."""

    @property
    def asleep_until_ns(self) -> int:
        """Time until which the gateway's process does not run."""

    @property
    def clock_offset_ns(self) -> int:
        """Difference of the wall clock, which stamps received frames, from the simulated time."""


class _PunctualHost:
    """A host without faults."""

    asleep_until_ns = 0
    clock_offset_ns = 0


class Lockstep:
    """A bus without delay, and the common clock of gateway and boards. ``host`` may stall the gateway.

    Frames are stamped with the simulated time plus ``epoch_offset_ns``, as a link stamps with epoch time.
    """

    def __init__(
        self, boards: Boards, start_ns: int, host: Host | None = None, epoch_offset_ns: int = 0
    ) -> None:
        self._boards = boards
        self._epoch_offset_ns = epoch_offset_ns
        self._host: Host = host or _PunctualHost()
        self._now_ns = start_ns
        self._to_boards: deque[Frame] = deque()
        self._waiting: list[tuple[Frame, int]] = []
        """Frames that arrived while the host was stalled, each with its receive stamp."""

    def send(self, frame: Frame) -> bool:
        """Take a frame from the gateway. Return False if the bus refuses it; this one refuses none."""
        self._to_boards.append(frame)
        return True

    def clock_ns(self) -> int:
        """Return the simulated time in nanoseconds."""
        return self._now_ns

    def run(self, session: Session, stop: StopRequest) -> None:
        """Step from deadline to deadline until the session's plan is over."""
        self.begin(session)
        while not session.plan.is_over:
            try:
                is_period = self.step(session)
            except LinkError as error:
                session.end_with_failure(Ending.LINK, str(error))
                return
            if is_period and stop.is_set:
                session.plan.end(Ending.INTERRUPTED)

    def begin(self, gateway_side: GatewaySide) -> None:
        """Switch the boards on."""
        self._deliver(gateway_side, self._boards.start(self._now_ns))

    def step(self, gateway_side: GatewaySide) -> bool:
        """Advance to the next deadline and serve it. Return whether it was one of the gateway."""
        boards, awake_ns = self._boards, self._host.asleep_until_ns
        deadline_ns = max(gateway_side.gateway.next_deadline_ns, awake_ns)
        boards_ns = boards.next_deadline_ns
        if boards_ns < (awake_ns if self._waiting else deadline_ns):
            self._now_ns = boards_ns
            self._deliver(gateway_side, boards.on_deadline(boards_ns))
            return False
        if self._waiting:
            self._now_ns = awake_ns
            self._read_waiting(gateway_side)
            return False
        self._now_ns = deadline_ns
        gateway_side.on_deadline(deadline_ns)
        self._deliver(gateway_side, ())
        return True

    def deliver(self, gateway_side: GatewaySide, frame: Frame) -> None:
        """Put a frame of another node on the bus now. The gateway and the boards receive it."""
        self._to_boards.append(frame)
        self._deliver(gateway_side, (frame,))

    def deliver_from_boards(self, gateway_side: GatewaySide, frames: tuple[Frame, ...]) -> None:
        """Give the gateway frames that the boards send now without having been asked."""
        self._deliver(gateway_side, frames)

    def _read_waiting(self, gateway_side: GatewaySide) -> None:
        """Give the gateway the frames that arrived while its host was stalled."""
        waiting, self._waiting = self._waiting, []
        for frame, stamp_ns in waiting:
            gateway_side.receive(frame, self._now_ns, stamp_ns)
        self._deliver(gateway_side, ())

    def _deliver(self, gateway_side: GatewaySide, to_gateway: tuple[Frame, ...]) -> None:
        """Deliver frames in both directions until none is left."""
        now_ns, to_boards, boards = self._now_ns, self._to_boards, self._boards
        while True:
            if to_gateway:
                self._to_gateway(gateway_side, to_gateway)
            if not to_boards:
                return
            to_gateway = boards.receive(to_boards.popleft(), now_ns)

    def _to_gateway(self, gateway_side: GatewaySide, frames: tuple[Frame, ...]) -> None:
        """Give the gateway frames that arrive now, or keep them for it while its host is stalled."""
        now_ns, host = self._now_ns, self._host
        epoch_ns = now_ns + self._epoch_offset_ns
        for frame in frames:
            stamp_ns = epoch_ns + host.clock_offset_ns
            if now_ns < host.asleep_until_ns or self._waiting:
                self._waiting.append((frame, stamp_ns))
            else:
                gateway_side.receive(frame, now_ns, stamp_ns)
