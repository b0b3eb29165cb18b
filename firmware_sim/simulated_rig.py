"""Both simulated boards and the plant between them, as one state machine.

The rig is given frames and the time; it returns frames. It reads no clock and does no I/O, so the lockstep
shell and a process on a real bus run the same code.

The rig advances the plant at every SYNC and before every change of a valve voltage. The plant's time starts
at the first sample, or at the first change of a valve voltage if that is earlier, however long the boards
waited for their gateway. The times of the arm's events count from there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from firmware_sim.boards.adc import AdcBoard
from firmware_sim.boards.canopen_slave import NEVER, Frames, SlaveState
from firmware_sim.boards.codec import SYNC_ID
from firmware_sim.boards.dac import DacBoard, Volts
from firmware_sim.boards.input_frames import Contacts
from firmware_sim.faults.wires import Wires
from firmware_sim.plants.plant import EMERGENCY_STOP, ENABLE_SWITCH, HasContacts, HasPlannedEvents, Plant
from hil.core.frames import Frame
from hil.core.rig import Rig


class SimulatedRig:
    """The boards that a rig file describes, with a plant on their pins.

    ``plant`` is any object with the methods of ``firmware_sim.plants.plant.Plant``. ``resolution_bits`` is
    the resolution of both converters, ``heartbeat_ns`` the time between two heartbeats of a board. To break a
    board, set ``adc.faults`` or ``dac.faults`` (``firmware_sim.boards.faults``).

    Every method raises the HilError of a plant that fails. After that the rig must not be called again.
    """

    def __init__(
        self, rig: Rig, plant: Plant, *, resolution_bits: int = 12, heartbeat_ns: int = 100_000_000
    ) -> None:
        self.plant = plant
        self.adc = AdcBoard(
            rig,
            self._potentiometer_v,
            resolution_bits=resolution_bits,
            heartbeat_ns=heartbeat_ns,
            contacts=self._contacts,
        )
        self.dac = DacBoard(rig, self._drive, resolution_bits=resolution_bits, heartbeat_ns=heartbeat_ns)
        self._held_v: Sequence[float] = self.dac.valve_v
        self.wires: Wires | None = None
        """Faulty wires between pins and plant; None for good ones."""
        self.on_event: Callable[[Any, int], None] | None = None
        """Function that is given each planned event of the plant, and its instant in nanoseconds.

        It is called when the plant has been advanced over that instant: at most a period later while SYNC
        arrives. None: nobody is notified.
        """
        if isinstance(plant, HasPlannedEvents):
            plant.on_event = self._event_happened
        self._plant_ns = NEVER
        self._max_advance_ns = heartbeat_ns

    @property
    def next_deadline_ns(self) -> int:
        """Time of the next call of ``on_deadline``."""
        return min(self.adc.next_deadline_ns, self.dac.next_deadline_ns)

    def start(self, now_ns: int) -> Frames:
        """Power the boards on. Returns their boot-up messages."""
        return self.adc.start(now_ns) + self.dac.start(now_ns)

    def receive(self, frame: Frame, now_ns: int) -> Frames:
        """Handle a frame that was on the bus at ``now_ns``. Returns the frames that the boards send.

        Deadlines before ``now_ns`` are handled first.
        """
        adc, dac = self.adc, self.dac
        overdue: Frames = ()
        if now_ns > adc.next_deadline_ns or now_ns > dac.next_deadline_ns:
            overdue = self.on_deadline(now_ns)
        if frame.is_extended or frame.is_remote or frame.is_error:
            return overdue
        if frame.id == SYNC_ID:
            if self.adc.state is SlaveState.OPERATIONAL:
                self._plant_ns = min(self._plant_ns, now_ns)
            self._advance(now_ns)
        return overdue + adc.receive(frame, now_ns) + dac.receive(frame, now_ns)

    def on_deadline(self, now_ns: int) -> Frames:
        """Handle the heartbeats and timeouts that are due at ``now_ns``. Returns the boards' frames."""
        frames: Frames = ()
        if now_ns >= self.adc.next_deadline_ns:
            frames += self.adc.on_deadline(now_ns)
        if now_ns >= self.dac.next_deadline_ns:
            frames += self.dac.on_deadline(now_ns)
        if now_ns - self._plant_ns >= self._max_advance_ns:
            # No SYNC arrives. Advance the plant now; else the next SYNC would have to simulate hours at once.
            self._advance(now_ns)
        return frames

    def _contacts(self) -> Contacts:
        plant = self.plant
        opened = plant.open_contacts if isinstance(plant, HasContacts) else ()
        return Contacts(EMERGENCY_STOP not in opened, ENABLE_SWITCH not in opened)

    def _event_happened(self, event: Any, before_end_ns: int) -> None:
        if self.on_event is not None:
            self.on_event(event, self._plant_ns - before_end_ns)

    def _drive(self, valve_v: Volts, now_ns: int) -> None:
        self._plant_ns = min(self._plant_ns, now_ns)
        self._advance(now_ns)
        self._held_v = valve_v

    def _potentiometer_v(self) -> Sequence[float]:
        volts = self.plant.potentiometer_v()
        return volts if self.wires is None else self.wires.sensed_v(volts, self._plant_ns)

    def _advance(self, now_ns: int) -> None:
        duration_ns = now_ns - self._plant_ns
        if duration_ns > 0:
            self._plant_ns = now_ns
            held_v = self._held_v if self.wires is None else self.wires.driven_v(self._held_v, duration_ns)
            self.plant.advance(duration_ns, held_v)
