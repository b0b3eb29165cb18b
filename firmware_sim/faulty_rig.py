"""A simulated rig with faults of its bus, boards, wires and plant, and of the gateway's host.

``FaultyRig`` has the methods of ``SimulatedRig`` and applies faults to what passes through them. It is a
state machine too: it reads no clock, and the same frames, times, faults and seed give the same bytes. So
faults work in simulated time and in real time. The faults of the host need the lockstep shell, which reads
``FaultyRig.host``, and error frames need a modelled bus.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from heapq import heappop, heappush
from random import Random
from typing import TYPE_CHECKING, Final

from firmware_sim.boards.adc import AdcBoard
from firmware_sim.boards.canopen_slave import Frames, NmtCommand
from firmware_sim.boards.codec import ADC_NODE, DAC_NODE, NMT_ID
from firmware_sim.boards.dac import DacBoard
from firmware_sim.boards.faults import AdcFaults, DacFaults
from firmware_sim.faults.condition import STATES, Condition, Observation, parse_condition
from firmware_sim.faults.fault_text import fault_text, parse_fault
from firmware_sim.faults.frame_faults import (
    Arrival,
    FrameChanger,
    FrameDestroyer,
    changed_by,
    counter_of,
    counts_of,
    pdo,
)
from firmware_sim.faults.host import HostTiming
from firmware_sim.faults.kinds import (
    FRAME_IDS,
    AnyFault,
    ArmFault,
    Babble,
    BusOff,
    DriftSensor,
    ErrorFrames,
    FillDisk,
    Flood,
    Foreign,
    FreezeSensor,
    Hang,
    Kill,
    NoisySensor,
    OffsetSensor,
    Pause,
    ProcessFault,
    Reset,
    SlowValve,
    Stall,
    StepClock,
    StickValve,
    Twin,
    Unplug,
)
from firmware_sim.faults.wires import Wires
from firmware_sim.plants.plant import HasEvents
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.core.rig import Rig

if TYPE_CHECKING:
    from hil.links.bus_model.rig_bus import RigBus

BUS_OFF_FRAME: Final = Frame(0x040, bytes(8), is_error=True)
"""Error frame that reports bus-off (``CAN_ERR_BUSOFF`` of ``linux/can/error.h``)."""
_SAMPLE_ID: Final = FRAME_IDS["sample"]
_COMMAND_ID: Final = FRAME_IDS["command"]
_COUNTS_PER_V: Final = (1 << 15) / 10.0


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
        self.host = HostTiming()
        """State of the gateway's host, which the lockstep shell reads."""
        self.begun: list[tuple[int, str]] = []
        """Time in nanoseconds and text of each fault that has begun."""
        self.on_begin: Callable[[str], None] | None = None
        """Function that is given the text of each fault when it begins; None: nobody is notified."""
        self._rig = rig
        self._bus = bus
        self._destroyers: dict[int, Callable[[str, int], int | None]] = {}
        """Function that destroys frames of the bus, by the identity of its fault."""
        self._seed = seed
        self._count = 0
        self._wires = boards.wires = Wires()
        self._waiting: list[tuple[Condition, AnyFault, Random]] = []
        self._agenda: list[tuple[int, int, Callable[[int], Frames]]] = []
        self._scheduled = 0
        self._changers: list[tuple[AnyFault, FrameChanger]] = []
        self._silences: list[AnyFault] = []
        """Faults during which no frame passes."""
        self._twins: list[tuple[AnyFault, AdcBoard | DacBoard]] = []
        self._ended: set[int] = set()
        self._last: dict[int, Frame] = {}
        """Last frame on the bus by identifier."""
        self._copied: dict[int, Frame] = {}
        """Frame that a foreign node repeats, by the identity of its fault."""
        self._is_running = False
        self._is_told_states = is_told_states
        self._state = ""
        """State that the gateway has entered last."""
        centre_v = [5.0, 5.0, 5.0]
        for axis in rig.axes.values():
            centre_v[axis.valve.channel - 1] = axis.valve.centre_v
        self._centre_counts = [round(volts * _COUNTS_PER_V) for volts in centre_v]
        for fault in faults:
            self._wait_for_condition(*self._checked(fault))

    def inject(self, fault: AnyFault | str, now_ns: int) -> Frames:
        """Arm a fault whose ``at_s`` counts from now, or from its condition. Returns frames that it causes.

        Raises DocumentError as the constructor does.
        """
        self.plan(fault, now_ns)
        return self._run_agenda(now_ns)

    def plan(self, fault: AnyFault | str, now_ns: int) -> None:
        """Arm a fault as :meth:`inject` does. One that is due begins at the next call of ``on_deadline``."""
        parsed, random = self._checked(fault)
        if _COMMAND_ID in self._last:
            self._note_command(self._last[_COMMAND_ID])
        if parsed.when:
            self._wait_for_condition(parsed, random)
        else:
            self._schedule(now_ns + round(parsed.at_s * 1e9), partial(self._begin, parsed, random))

    def gateway_entered(self, state: str, now_ns: int) -> None:
        """Take note of a state of the gateway's life cycle, such as ``armed``.

        A fault that is due begins at the next call of ``on_deadline``.
        """
        self._state = state
        self._schedule_met(now_ns)

    @property
    def next_deadline_ns(self) -> int:
        """Time of the next call of ``on_deadline``."""
        deadline_ns = self.boards.next_deadline_ns
        if self._agenda and self._agenda[0][0] < deadline_ns:
            deadline_ns = self._agenda[0][0]
        for _, twin in self._twins:
            deadline_ns = min(deadline_ns, twin.next_deadline_ns)
        return deadline_ns

    def start(self, now_ns: int) -> Frames:
        """Power the boards on. Returns their boot-up messages."""
        return self._to_gateway(self.boards.start(now_ns), now_ns)

    def receive(self, frame: Frame, now_ns: int) -> Frames:
        """Handle a frame from the gateway. Returns the frames that arrive at the gateway."""
        last = self._last
        last[frame.id] = frame
        if not (self._waiting or self._agenda or self._changers or self._silences or self._twins):
            answers = self.boards.receive(frame, now_ns)
            for answer in answers:
                last[answer.id] = answer
            return answers
        frames: Frames = ()
        if self._agenda and self._agenda[0][0] < now_ns:
            frames = self._run_agenda(now_ns)
        if frame.id == _COMMAND_ID:
            self._note_command(frame)
            frames += self._judge_conditions(now_ns)
        for arriving in self._pass(frame, now_ns, to_gateway=False):
            frames += self._at_boards(arriving, now_ns)
        return frames

    def on_deadline(self, now_ns: int) -> Frames:
        """Handle what is due at ``now_ns``: faults first, then the boards. Returns frames to the gateway."""
        frames = self._run_agenda(now_ns) if self._agenda and self._agenda[0][0] <= now_ns else ()
        if now_ns >= self.boards.next_deadline_ns:
            frames += self._to_gateway(self.boards.on_deadline(now_ns), now_ns)
        for _, twin in self._twins:
            if now_ns >= twin.next_deadline_ns:
                frames += self._to_gateway(twin.on_deadline(now_ns), now_ns)
        return frames

    # What passes

    def _at_boards(self, frame: Frame, now_ns: int) -> Frames:
        """Give the boards a frame that arrives there, and pass on their answers."""
        answers = self.boards.receive(frame, now_ns)
        for _, twin in self._twins:
            answers += twin.receive(frame, now_ns)
        return self._to_gateway(answers, now_ns)

    def _to_gateway(self, frames: Frames, now_ns: int) -> Frames:
        """Pass frames that the boards send. Returns those that arrive at the gateway now."""
        arriving: Frames = ()
        for frame in frames:
            self._last[frame.id] = frame
            if frame.id == _SAMPLE_ID and self._waiting:
                arriving += self._judge_conditions(now_ns)
            if self._changers or self._silences:
                arriving += self._pass(frame, now_ns, to_gateway=True)
            else:
                arriving += (frame,)
        return arriving

    def _pass(self, frame: Frame, now_ns: int, *, to_gateway: bool) -> Frames:
        """Let the active faults change a frame. Returns what arrives now; the rest is on the agenda."""
        if self._silences:
            return ()
        arrivals = [Arrival(frame)]
        for _, changer in self._changers:
            arrivals = [arrival for before in arrivals for arrival in changed_by(changer, before)]
        now: Frames = ()
        for arriving, delay_ns, is_additional in arrivals:
            if is_additional:
                self._schedule(now_ns + delay_ns, partial(self._from_stranger, arriving))
            elif delay_ns:
                self._schedule(now_ns + delay_ns, partial(self._arrive_late, arriving, to_gateway))
            else:
                now += (arriving,)
        return now

    def _arrive_late(self, frame: Frame, to_gateway: bool, now_ns: int) -> Frames:
        if self._silences:
            return ()
        return (frame,) if to_gateway else self._at_boards(frame, now_ns)

    def _from_stranger(self, frame: Frame, now_ns: int) -> Frames:
        """Put a frame of a node that is no part of the rig on the bus: gateway and boards receive it."""
        if self._bus is not None:
            self._bus.send_foreign(frame, now_ns)
            return ()
        if self._silences:
            return ()
        return (frame, *self._at_boards(frame, now_ns))

    # Conditions

    def _note_command(self, frame: Frame) -> None:
        if frame.id == _COMMAND_ID and not self._is_running:
            offsets = zip(counts_of(frame), self._centre_counts, strict=True)
            self._is_running = any(abs(counts - centre) > 1 for counts, centre in offsets)

    def _judge_conditions(self, now_ns: int) -> Frames:
        """Schedule the faults whose condition is met by the last frames, and begin those that are due."""
        return self._run_agenda(now_ns) if self._schedule_met(now_ns) else ()

    def _schedule_met(self, now_ns: int) -> bool:
        """Schedule the faults whose condition is met. Return whether there are any."""
        seen = Observation(_SAMPLE_ID in self._last, self._is_running, self._positions(), self._state)
        met = [entry for entry in self._waiting if entry[0].is_met(seen)]
        if not met:
            return False
        self._waiting = [entry for entry in self._waiting if entry not in met]
        for _, fault, random in met:
            self._schedule(now_ns + round(fault.at_s * 1e9), partial(self._begin, fault, random))
        return True

    def _positions(self) -> dict[str, float]:
        sample = self._last.get(_SAMPLE_ID)
        if sample is None or not any(condition.axis for condition, _, _ in self._waiting):
            return {}
        counts = counts_of(sample)
        return {
            name: axis.potentiometer.position(counts[axis.potentiometer.channel - 1] / _COUNTS_PER_V)
            for name, axis in self._rig.axes.items()
        }

    def _wait_for_condition(self, fault: AnyFault, random: Random) -> None:
        condition = parse_condition(fault.when, list(self._rig.axes), f"fault {fault_text(fault)!r}")
        self._waiting.append((condition, fault, random))

    def _checked(self, fault: AnyFault | str) -> tuple[AnyFault, Random]:
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
        if isinstance(parsed, ErrorFrames) and self._bus is None:
            raise DocumentError(
                f"fault {fault_text(parsed)!r} needs a modelled bus: write bit_rate = 500000 under [bus] "
                "in the rig file, and run in simulated time (--lockstep)"
            )
        random = Random(f"fault {self._count}, seed {self._seed}")
        self._count += 1
        return parsed, random

    # The agenda

    def _schedule(self, due_ns: int, action: Callable[[int], Frames]) -> None:
        self._scheduled += 1  # keeps the order of actions that are due at the same instant
        heappush(self._agenda, (due_ns, self._scheduled, action))

    def _run_agenda(self, now_ns: int) -> Frames:
        frames: Frames = ()
        while self._agenda and self._agenda[0][0] <= now_ns:
            due_ns, _, action = heappop(self._agenda)
            frames += action(due_ns)
        return frames

    # Begin and end of a fault

    def _begin(self, fault: AnyFault, random: Random, now_ns: int) -> Frames:
        text = fault_text(fault)
        self.begun.append((now_ns, text))
        if self.on_begin is not None:
            self.on_begin(text)
        frames = self._effect(fault, random, now_ns)
        if fault.for_s is not None:
            self._schedule(now_ns + round(fault.for_s * 1e9), partial(self._end, fault))
        return frames

    def _effect(self, fault: AnyFault, random: Random, now_ns: int) -> Frames:
        match fault:
            case (
                Foreign(interval_s=interval_s) | Flood(interval_s=interval_s) | Babble(interval_s=interval_s)
            ):
                return self._send_repeatedly(fault, round(interval_s * 1e9), 128, now_ns)
            case BusOff() if self._bus is not None:
                return (self._bus.take_gateway_off(now_ns),)
            case BusOff():
                self._silences.append(fault)
                return (BUS_OFF_FRAME,)
            case Unplug() if self._bus is not None:
                self._bus.unplug(now_ns)
            case Unplug():
                self._silences.append(fault)
            case ErrorFrames():
                assert self._bus is not None, "checked when the fault was armed"
                destroyer = self._destroyers[id(fault)] = FrameDestroyer(fault, random).broken_bit
                self._bus.disturbances.append(destroyer)
            case Reset(board=name):
                board = self.boards.adc if name == "adc" else self.boards.dac
                return self._to_gateway(board.start(now_ns), now_ns)
            case Hang(board=name):
                self._set_hung(name, True)
            case Twin(board=name):
                self._twins.append((fault, self._second_board(name, now_ns)))
            case FreezeSensor() | DriftSensor() | NoisySensor() | OffsetSensor():
                channel = self._rig.axes[fault.axis].potentiometer.channel - 1
                self._wires.break_sensor(fault, channel, now_ns, random)
            case StickValve() | SlowValve():
                self._wires.break_valve(fault, self._rig.axes[fault.axis].valve.channel - 1)
            case ArmFault(event=event):
                assert isinstance(self.boards.plant, HasEvents), "checked when the fault was armed"
                self.boards.plant.apply(event)
            case Stall(stall_s=stall_s):
                self.host.stall(now_ns, round(stall_s * 1e9))
            case StepClock(step_s=step_s):
                self.host.step_clock(round(step_s * 1e9))
            case Kill() | Pause() | FillDisk():
                raise AssertionError("refused when it was armed")
            case _:
                self._changers.append((fault, FrameChanger(fault, random, self._rig.bus.wire_version)))
        return ()

    def _end(self, fault: AnyFault, now_ns: int) -> Frames:
        self._ended.add(id(fault))
        self._changers = [entry for entry in self._changers if entry[0] is not fault]
        self._twins = [entry for entry in self._twins if entry[0] is not fault]
        self._silences = [silence for silence in self._silences if silence is not fault]
        match fault:
            case Hang(board=name):
                self._set_hung(name, False)
            case FreezeSensor() | DriftSensor() | NoisySensor() | OffsetSensor() | StickValve() | SlowValve():
                self._wires.repair(fault)
            case StepClock(step_s=step_s):
                self.host.step_clock(-round(step_s * 1e9))
            case BusOff() if self._bus is not None:
                self._bus.restart(now_ns)
            case Unplug() if self._bus is not None:
                self._bus.plug(now_ns)
            case ErrorFrames() if self._bus is not None:
                self._bus.disturbances.remove(self._destroyers.pop(id(fault)))
            case _:
                pass
        return ()

    def _send_repeatedly(
        self, fault: Foreign | Flood | Babble, interval_ns: int, counter: int, now_ns: int
    ) -> Frames:
        """Send one frame of a node that sends without being asked, and schedule the next one."""
        if id(fault) in self._ended:
            return ()
        self._schedule(
            now_ns + interval_ns,
            partial(self._send_repeatedly, fault, interval_ns, (counter + 1) & 0xFF),
        )
        match fault:
            case Flood(identifier=identifier):
                return self._from_stranger(Frame(identifier, bytes(8)), now_ns)
            case Babble(board=name):
                frame = self._last.get(_SAMPLE_ID) if name == "adc" else None
                frame = frame or self._last.get(FRAME_IDS[f"{name}-heartbeat"])
                return () if frame is None else self._to_gateway((frame,), now_ns)
            case Foreign(frame=name):
                identifier = FRAME_IDS[name]
                if identifier not in self._last:
                    return ()
                copied = self._copied.setdefault(id(fault), self._last[identifier])
                if name in ("sample", "command") and counter_of(copied) is not None:
                    copied = pdo(copied.id, counts_of(copied), counter, self._rig.bus.wire_version)
                return self._from_stranger(copied, now_ns)

    def _set_hung(self, name: str, hung: bool) -> None:
        if name == "adc":
            self.boards.adc.faults = self.boards.adc.faults or AdcFaults()
            self.boards.adc.faults.hung = hung
        else:
            self.boards.dac.faults = self.boards.dac.faults or DacFaults()
            self.boards.dac.faults.hung = hung

    def _second_board(self, name: str, now_ns: int) -> AdcBoard | DacBoard:
        """Return a second board with the same node id, which is operational already."""
        bits, heartbeat_ns = 12, 100_000_000
        twin: AdcBoard | DacBoard
        if name == "adc":
            sample = self.boards.plant.potentiometer_v
            twin = AdcBoard(self._rig, sample, resolution_bits=bits, heartbeat_ns=heartbeat_ns)
        else:
            twin = DacBoard(
                self._rig, lambda _volts, _now_ns: None, resolution_bits=bits, heartbeat_ns=heartbeat_ns
            )
        twin.start(now_ns)
        node = ADC_NODE if name == "adc" else DAC_NODE
        twin.receive(Frame(NMT_ID, bytes((NmtCommand.START, node))), now_ns)
        return twin


def no_process(fault: ProcessFault) -> str:
    """Return why a fault of a process cannot begin in a simulated rig, and what to use in its place."""
    return (
        f"fault {fault_text(fault)!r} acts on a process of the gateway, and a simulated rig has none: use "
        "VcanGateway.inject_fault of hil.testing. In simulated time, unplug is what the boards see of a "
        "killed gateway, and stall:S of a paused one; nothing is written before the end of the run"
    )


def acts_on_arm(simulated: str) -> str:
    """Return why an event of the arm cannot happen, given what is simulated, and what to use in its place."""
    return (
        f"acts on the pneumatic arm, but {simulated}: simulate the arm, or use a fault between board and "
        "plant, which every plant has: offset-sensor:AXIS,-10 for a broken wire, stick-valve:AXIS, "
        "slow-valve:AXIS,LAG_S"
    )


def check_faults(faults: Iterable[AnyFault], rig: Rig) -> None:
    """Check that ``rig`` has every axis that the faults name. Raises DocumentError."""
    for fault in faults:
        axis = getattr(fault, "axis", None)
        if axis is not None and axis not in rig.axes:
            raise DocumentError(
                f"fault {fault_text(fault)!r}: no axis {axis!r}; the rig has {', '.join(rig.axes)}"
            )
        parse_condition(fault.when, list(rig.axes), f"fault {fault_text(fault)!r}")
