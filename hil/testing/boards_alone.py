"""The simulated boards without a gateway, in simulated time, for a master of one's own."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_sim.boards.codec import DAC_NODE, NMT_ID, RPDO1_ID, SYNC_ID
from firmware_sim.faults.frame_faults import pdo
from firmware_sim.faulty_rig import FaultyRig
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.frames import Frame
from hil.shells.run_setup import load_rig

if TYPE_CHECKING:
    from firmware_sim.faults.kinds import AnyFault
    from firmware_sim.plants.plant import Plant

_COUNTS_PER_V = (1 << 15) / 10.0
_START = 1


class BoardsAlone:
    """Both boards with the arm behind them. The test is the master: it sends frames and lets time pass.

    >>> boards = BoardsAlone()
    >>> boards.start_nodes()
    []
    >>> [str(frame)[:3] for frame in boards.sync()]
    ['190']
    """

    def __init__(
        self,
        rig: str | os.PathLike[str] | None = None,
        *,
        plant: Plant | None = None,
        faults: Iterable[AnyFault | str] = (),
        seed: int = 0,
    ) -> None:
        """Power the boards of a rig file on, or those of the shipped one.

        ``plant``, ``faults`` and ``seed`` are those of :class:`hil.LockstepRig`. Raises DocumentError.
        """
        from firmware_sim.arm.arm import Arm
        from firmware_sim.arm.arm_file import shipped_arm
        from firmware_sim.arm.wiring import wiring

        self.rig = load_rig(None if rig is None else Path(rig))
        plant = plant or Arm(shipped_arm(), seed=seed, wiring=wiring(self.rig))
        self.boards = SimulatedRig(self.rig, plant)
        self._faulty = FaultyRig(self.rig, self.boards, faults, seed=seed)
        self.now_ns = 0
        """Simulated time in nanoseconds."""
        self._counter = 0
        self.boot_frames = list(self._faulty.start(0))
        """Frames that the boards sent when they were powered on."""

    @property
    def valve_v(self) -> tuple[float, float, float]:
        """Voltages of the three valves now."""
        return self.boards.dac.valve_v

    def send(self, frame: Frame) -> list[Frame]:
        """Send a frame. Returns the frames that the boards send in answer to it."""
        return list(self._faulty.receive(frame, self.now_ns))

    def start_nodes(self) -> list[Frame]:
        """Send the NMT command that starts all nodes."""
        return self.send(Frame(NMT_ID, bytes((_START, 0))))

    def sync(self) -> list[Frame]:
        """Send SYNC. Returns the boards' answers."""
        return self.send(Frame(SYNC_ID))

    def command(self, volts: Sequence[float]) -> list[Frame]:
        """Send a correct valve command with the next counter; voltages are given by channel."""
        first, second, third = (round(value * _COUNTS_PER_V) for value in volts)
        counter = self._counter if self.rig.dac.protected else None
        self._counter = (self._counter + 1) & 0xFF
        return self.send(pdo(RPDO1_ID + DAC_NODE, (first, second, third), counter, self.rig.bus.wire_version))

    def wait(self, duration_s: float) -> list[Frame]:
        """Let time pass. Returns the frames that the boards send meanwhile."""
        end_ns = self.now_ns + round(duration_s * 1e9)
        frames: list[Frame] = []
        while self._faulty.next_deadline_ns <= end_ns:
            self.now_ns = self._faulty.next_deadline_ns
            frames += self._faulty.on_deadline(self.now_ns)
        self.now_ns = end_ns
        return frames

    def inject_fault(self, fault: AnyFault | str) -> list[Frame]:
        """Let a fault begin; its time counts from now. Returns the frames that it causes at once."""
        return list(self._faulty.inject(fault, self.now_ns))
