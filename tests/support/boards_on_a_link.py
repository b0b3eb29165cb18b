"""Simulated boards behind a link, on a simulated clock, for programs that listen to a bus."""

from __future__ import annotations

from collections import deque

from firmware_sim.plants.linear_plant import LinearPlant
from firmware_sim.plants.plant import Plant
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.frames import Frame
from hil.links import Received
from support.shipped_rig import SHIPPED_RIG


class BoardsOnALink:
    """Simulated boards, whose clock goes on when the monitor waits for a frame."""

    spec = "test"
    unreadable = 0

    def __init__(self, plant: Plant | None = None) -> None:
        self.now_ns = 0
        self.sent: list[tuple[int, Frame]] = []
        self.takes_frames = True
        self._boards = SimulatedRig(SHIPPED_RIG, plant or LinearPlant(SHIPPED_RIG))
        self._waiting = deque(self._boards.start(0))
        self.foreign: deque[tuple[int, Frame]] = deque()
        """Frames of another gateway, with the times at which they arrive."""

    def clock_ns(self) -> int:
        return self.now_ns

    def send(self, frame: Frame) -> bool:
        if self.takes_frames:
            self.sent.append((self.now_ns, frame))
            self._waiting.extend(self._boards.receive(frame, self.now_ns))
        return self.takes_frames

    def receive(self, timeout_s: float) -> Received | None:
        end_ns = self.now_ns + round(timeout_s * 1e9)
        while not self._waiting:
            next_ns = min(
                self._boards.next_deadline_ns, self.foreign[0][0] if self.foreign else end_ns, end_ns
            )
            if next_ns >= end_ns:
                self.now_ns = max(end_ns, self.now_ns)
                return None
            self.now_ns = max(next_ns, self.now_ns)
            if self.foreign and self.foreign[0][0] <= self.now_ns:
                self._waiting.append(self.foreign.popleft()[1])
            else:
                self._waiting.extend(self._boards.on_deadline(self.now_ns))
        return Received(self._waiting.popleft(), self.now_ns, "kernel")

    def dropped(self) -> int:
        return 0
