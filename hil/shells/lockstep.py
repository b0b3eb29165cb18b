"""The lockstep shell: gateway and simulated boards in one process, in simulated time.

Time jumps to the next deadline of either side. Frames arrive at once and in order. The same setup gives the
same calls in every run.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

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


class Lockstep:
    """A bus without delay, and the common clock of gateway and boards."""

    def __init__(self, boards: Boards, start_ns: int) -> None:
        self._boards = boards
        self._now_ns = start_ns
        self._to_boards: deque[Frame] = deque()

    def send(self, frame: Frame) -> bool:
        """Take a frame from the gateway. Return True, because this bus refuses none."""
        self._to_boards.append(frame)
        return True

    def clock_ns(self) -> int:
        """Return the simulated time in nanoseconds."""
        return self._now_ns

    def run(self, session: Session, stop: StopRequest) -> None:
        """Step from deadline to deadline until the session's plan is over."""
        self.begin(session)
        while not session.plan.is_over:
            if self.step(session) and stop.is_set:
                session.plan.end(Ending.INTERRUPTED)

    def begin(self, gateway_side: GatewaySide) -> None:
        """Switch the boards on."""
        self._deliver(gateway_side, self._boards.start(self._now_ns))

    def step(self, gateway_side: GatewaySide) -> bool:
        """Advance to the next deadline and serve it. Return whether it was one of the gateway."""
        boards, gateway = self._boards, gateway_side.gateway
        if boards.next_deadline_ns < gateway.next_deadline_ns:
            self._now_ns = boards.next_deadline_ns
            self._deliver(gateway_side, boards.on_deadline(self._now_ns))
            return False
        self._now_ns = gateway.next_deadline_ns
        gateway_side.on_deadline(self._now_ns)
        self._deliver(gateway_side, ())
        return True

    def deliver(self, gateway_side: GatewaySide, frame: Frame) -> None:
        """Put a frame of another node on the bus now. The gateway and the boards receive it."""
        self._to_boards.append(frame)
        self._deliver(gateway_side, (frame,))

    def _deliver(self, gateway_side: GatewaySide, to_gateway: tuple[Frame, ...]) -> None:
        """Deliver frames in both directions until none is left."""
        now_ns, waiting, boards = self._now_ns, self._to_boards, self._boards
        while True:
            for frame in to_gateway:
                gateway_side.receive(frame, now_ns, now_ns)
            if not waiting:
                return
            to_gateway = boards.receive(waiting.popleft(), now_ns)
