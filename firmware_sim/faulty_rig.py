"""A simulated rig with faults of its bus, boards, wires and plant, and of the gateway's host.

``FaultyRig`` has the methods of ``SimulatedRig`` and applies faults to what passes through them. It is a
state machine too: it reads no clock, and the same frames, times, faults and seed give the same bytes. So
faults work in simulated time and in real time. The faults of the host need the lockstep shell, which reads
``FaultyRig.host``, and error frames need a modelled bus.

When a fault begins and ends is in ``fault_schedule``, what it does in ``fault_effects``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from random import Random
from typing import TYPE_CHECKING

from firmware_sim.boards.canopen_slave import Frames
from firmware_sim.fault_effects import FaultEffects
from firmware_sim.fault_schedule import COMMAND_ID, SAMPLE_ID, Agenda, FaultSchedule
from firmware_sim.faults.checks import acts_on_arm, check_faults, no_process
from firmware_sim.faults.condition import STATES
from firmware_sim.faults.fault_text import fault_text, parse_fault
from firmware_sim.faults.kinds import AnyFault, ArmFault, ErrorFrames, ProcessFault
from firmware_sim.plants.plant import HasEvents
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.core.rig import Rig

if TYPE_CHECKING:
    from hil.links.bus_model.rig_bus import RigBus


class FaultyRig:
    """The boards and the plant of ``boards``, with faults.

    ``rig`` is the rig file of ``boards``. ``faults`` are armed from the start; :meth:`inject` adds others.
    The randomness of a fault depends on ``seed`` and on the fault's place in the list alone. ``bus`` is the
    modelled bus between gateway and boards, on which the faults of the bus act; None if frames take no time.
    ``is_told_states`` is True if :meth:`gateway_entered` is called.

    Raises DocumentError if a fault names an axis that the rig does not have, or acts on the pneumatic arm
    when another plant is simulated, or destroys frames although there is no modelled bus, or waits for a
    state of which the rig is not told.
    """

    def __init__(
        self,
        rig: Rig,
        boards: SimulatedRig,
        faults: Iterable[AnyFault | str] = (),
        *,
        seed: int = 0,
        bus: RigBus | None = None,
        is_told_states: bool = False,
    ) -> None:
        self.boards = boards
        self.begun: list[tuple[int, str]] = []
        """Time in nanoseconds and text of each fault that has begun."""
        self.on_begin: Callable[[str], None] | None = None
        """Function that is given the text of each fault when it begins; None: nobody is notified."""
        self._rig = rig
        self._has_bus = bus is not None
        self._is_told_states = is_told_states
        self._seed = seed
        self._count = 0
        self._last: dict[int, Frame] = {}
        """Last frame on the bus by identifier."""
        self._agenda = agenda = Agenda()
        self._effects = effects = FaultEffects(rig, boards, bus, agenda, self._last, self._to_gateway)
        self._schedule = FaultSchedule(rig, agenda, self._last, self._begin, effects.end)
        self.host = effects.host
        """State of the gateway's host, which the lockstep shell reads."""
        for fault in faults:
            self._schedule.wait_for_condition(*self._checked(fault))

    def inject(self, fault: AnyFault | str, now_ns: int) -> Frames:
        """Arm a fault whose ``at_s`` counts from now, or from its condition. Returns frames that it causes.

        Raises DocumentError as the constructor does.
        """
        self.plan(fault, now_ns)
        return self._agenda.run(now_ns)

    def plan(self, fault: AnyFault | str, now_ns: int) -> None:
        """Arm a fault as :meth:`inject` does. One that is due begins at the next call of ``on_deadline``."""
        self._schedule.plan(*self._checked(fault), now_ns)

    def gateway_entered(self, state: str, now_ns: int) -> None:
        """Take note of a state of the gateway's life cycle, such as ``armed``.

        A fault that is due begins at the next call of ``on_deadline``.
        """
        self._schedule.gateway_entered(state, now_ns)

    @property
    def next_deadline_ns(self) -> int:
        """Time of the next call of ``on_deadline``."""
        deadline_ns = self.boards.next_deadline_ns
        entries = self._agenda.entries
        if entries and entries[0][0] < deadline_ns:
            deadline_ns = entries[0][0]
        for _, twin in self._effects.twins:
            deadline_ns = min(deadline_ns, twin.next_deadline_ns)
        return deadline_ns

    def start(self, now_ns: int) -> Frames:
        """Power the boards on. Returns their boot-up messages."""
        return self._to_gateway(self.boards.start(now_ns), now_ns)

    def receive(self, frame: Frame, now_ns: int) -> Frames:
        """Handle a frame from the gateway. Returns the frames that arrive at the gateway."""
        last, effects, entries = self._last, self._effects, self._agenda.entries
        last[frame.id] = frame
        if not (self._schedule.waiting or entries or effects.changers or effects.silences or effects.twins):
            answers = self.boards.receive(frame, now_ns)
            for answer in answers:
                last[answer.id] = answer
            return answers
        frames: Frames = ()
        if entries and entries[0][0] < now_ns:
            frames = self._agenda.run(now_ns)
        if frame.id == COMMAND_ID:
            self._schedule.note_command(frame)
            frames += self._schedule.judge_conditions(now_ns)
        for arriving in effects.passed(frame, now_ns, to_gateway=False):
            frames += effects.at_boards(arriving, now_ns)
        return frames

    def on_deadline(self, now_ns: int) -> Frames:
        """Handle what is due at ``now_ns``: faults first, then the boards. Returns frames to the gateway."""
        frames = self._agenda.run(now_ns)
        if now_ns >= self.boards.next_deadline_ns:
            frames += self._to_gateway(self.boards.on_deadline(now_ns), now_ns)
        for _, twin in self._effects.twins:
            if now_ns >= twin.next_deadline_ns:
                frames += self._to_gateway(twin.on_deadline(now_ns), now_ns)
        return frames

    def _to_gateway(self, frames: Frames, now_ns: int) -> Frames:
        """Pass frames that the boards send. Returns those that arrive at the gateway now."""
        arriving: Frames = ()
        effects = self._effects
        for frame in frames:
            self._last[frame.id] = frame
            if frame.id == SAMPLE_ID and self._schedule.waiting:
                arriving += self._schedule.judge_conditions(now_ns)
            if effects.changers or effects.silences:
                arriving += effects.passed(frame, now_ns, to_gateway=True)
            else:
                arriving += (frame,)
        return arriving

    def _checked(self, fault: AnyFault | str) -> tuple[AnyFault, Random]:
        """Return a fault that can be armed, and its randomness. Raises DocumentError."""
        parsed = parse_fault(fault) if isinstance(fault, str) else fault
        check_faults([parsed], self._rig)
        if isinstance(parsed, ArmFault) and not isinstance(self.boards.plant, HasEvents):
            raise DocumentError(f"fault {fault_text(parsed)!r} {acts_on_arm('another plant is simulated')}")
        if parsed.when in STATES and not self._is_told_states:
            raise DocumentError(
                f"fault {fault_text(parsed)!r} waits for the gateway's state {parsed.when!r}, which no "
                "frame on the bus shows: let hil run or hil daemon start the boards (--bus sim), or use "
                "--lockstep, or wait for running, a position or a time"
            )
        if isinstance(parsed, ProcessFault):
            raise DocumentError(no_process(parsed))
        if isinstance(parsed, ErrorFrames) and not self._has_bus:
            raise DocumentError(
                f"fault {fault_text(parsed)!r} needs a modelled bus: write bit_rate = 500000 under [bus] "
                "in the rig file, and run in simulated time (--lockstep)"
            )
        random = Random(f"fault {self._count}, seed {self._seed}")
        self._count += 1
        return parsed, random

    def _begin(self, fault: AnyFault, random: Random, now_ns: int) -> Frames:
        text = fault_text(fault)
        self.begun.append((now_ns, text))
        if self.on_begin is not None:
            self.on_begin(text)
        return self._effects.begin(fault, random, now_ns)
