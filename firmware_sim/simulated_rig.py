"""Both boards and the plant between them behind one interface, the gateway core's mirror image.

Frames and the time in, frames out; no clock, no I/O, so that the lockstep shell and a process on a real bus
run the same code. The plant is brought up to date at every SYNC and before every change of a valve voltage.
It rests until its first sample: its time, and that of what will happen to it, counts from there, however long
the boards waited for their gateway.
"""

from __future__ import annotations

from collections.abc import Sequence

from firmware_sim.boards.boards import AdcBoard, DacBoard, Volts
from firmware_sim.boards.canopen_slave import NEVER, Frames, State
from firmware_sim.boards.codec import SYNC_ID
from firmware_sim.plants.plant import Plant
from hil.core.frames import Frame
from hil.core.rig import Rig


class SimulatedRig:
    """The boards of ``rig`` with ``plant`` on their pins.

    ``resolution_bits`` of both converters, ``heartbeat_ns`` between the boards' heartbeats. Faults are set
    on ``adc.faults`` and ``dac.faults``. A plant that fails raises its HilError out of any method; after
    that the rig must not be called again.
    """

    def __init__(
        self, rig: Rig, plant: Plant, *, resolution_bits: int = 12, heartbeat_ns: int = 100_000_000
    ) -> None:
        self.plant = plant
        self.adc = AdcBoard(
            rig, plant.potentiometer_v, resolution_bits=resolution_bits, heartbeat_ns=heartbeat_ns
        )
        self.dac = DacBoard(rig, self._drive, resolution_bits=resolution_bits, heartbeat_ns=heartbeat_ns)
        self._held_v: Sequence[float] = self.dac.valve_v
        self._plant_ns = NEVER
        self._longest_advance_ns = heartbeat_ns

    @property
    def next_deadline_ns(self) -> int:
        """When ``on_deadline`` is to be called."""
        return min(self.adc.next_deadline_ns, self.dac.next_deadline_ns)

    def start(self, now_ns: int) -> Frames:
        """Power on: the boards' boot-up messages."""
        return self.adc.start(now_ns) + self.dac.start(now_ns)

    def receive(self, frame: Frame, now_ns: int) -> Frames:
        """A frame was on the bus at ``now_ns``; deadlines that passed before it are met first."""
        adc, dac = self.adc, self.dac
        overdue: Frames = ()
        if now_ns > adc.next_deadline_ns or now_ns > dac.next_deadline_ns:
            overdue = self.on_deadline(now_ns)
        if frame.is_extended or frame.is_remote or frame.is_error:
            return overdue
        if frame.id == SYNC_ID:
            if self.adc.state is State.OPERATIONAL:
                self._plant_ns = min(self._plant_ns, now_ns)
            self._advance(now_ns)
        return overdue + adc.receive(frame, now_ns) + dac.receive(frame, now_ns)

    def on_deadline(self, now_ns: int) -> Frames:
        """Heartbeats and time-outs of the boards whose deadline has come."""
        frames: Frames = ()
        if now_ns >= self.adc.next_deadline_ns:
            frames += self.adc.on_deadline(now_ns)
        if now_ns >= self.dac.next_deadline_ns:
            frames += self.dac.on_deadline(now_ns)
        if now_ns - self._plant_ns >= self._longest_advance_ns:
            # Nobody sends SYNC: keep up, so that the first one has not hours to simulate.
            self._advance(now_ns)
        return frames

    def _drive(self, valve_v: Volts, now_ns: int) -> None:
        self._plant_ns = min(self._plant_ns, now_ns)
        self._advance(now_ns)
        self._held_v = valve_v

    def _advance(self, now_ns: int) -> None:
        duration_ns = now_ns - self._plant_ns
        if duration_ns > 0:
            self._plant_ns = now_ns
            self.plant.advance(duration_ns, self._held_v)
