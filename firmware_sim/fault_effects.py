"""What faults do to the boards, wires, plant and host of a simulated rig, and to the frames that pass.

When a fault begins and ends is in ``fault_schedule``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from random import Random
from typing import TYPE_CHECKING, Final

from firmware_sim.boards.adc import AdcBoard
from firmware_sim.boards.canopen_slave import Frames, NmtCommand
from firmware_sim.boards.codec import ADC_NODE, DAC_NODE, NMT_ID
from firmware_sim.boards.dac import DacBoard
from firmware_sim.boards.faults import AdcFaults, DacFaults
from firmware_sim.fault_schedule import SAMPLE_ID, Agenda
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
from hil.core.frames import Frame
from hil.core.rig import Rig

if TYPE_CHECKING:
    from hil.links.bus_model.rig_bus import RigBus

BUS_OFF_FRAME: Final = Frame(0x040, bytes(8), is_error=True)
"""Error frame that reports bus-off (``CAN_ERR_BUSOFF`` of ``linux/can/error.h``)."""


class FaultEffects:
    """The faults that act at present, on ``boards`` and on the frames between them and the gateway.

    ``last`` has the last frame on the bus by identifier. ``to_gateway`` passes frames that boards send at a
    time in nanoseconds, and returns those that arrive at the gateway now. What happens later goes on
    ``agenda``. ``bus`` is the modelled bus; None if frames take no time.
    """

    def __init__(
        self,
        rig: Rig,
        boards: SimulatedRig,
        bus: RigBus | None,
        agenda: Agenda,
        last: Mapping[int, Frame],
        to_gateway: Callable[[Frames, int], Frames],
    ) -> None:
        self.host = HostTiming()
        """State of the gateway's host."""
        self.twins: list[tuple[AnyFault, AdcBoard | DacBoard]] = []
        """Second boards, with their faults."""
        self.changers: list[tuple[AnyFault, FrameChanger]] = []
        """Faults that change frames on their way."""
        self.silences: list[AnyFault] = []
        """Faults during which no frame passes."""
        self._hangs: list[Hang] = []
        """Faults that hang a board at present."""
        self._rig = rig
        self._boards = boards
        self._bus = bus
        self._agenda = agenda
        self._last = last
        self._to_gateway = to_gateway
        self._wires = boards.wires = Wires()
        self._destroyers: dict[int, Callable[[str, int], int | None]] = {}
        """Function that destroys frames of the bus, by the identity of its fault."""
        self._ended: set[int] = set()
        self._copied: dict[int, Frame] = {}
        """Frame that a foreign node repeats, by the identity of its fault."""

    # What passes

    def at_boards(self, frame: Frame, now_ns: int) -> Frames:
        """Give the boards a frame that arrives there, and pass on their answers."""
        answers = self._boards.receive(frame, now_ns)
        for _, twin in self.twins:
            answers += twin.receive(frame, now_ns)
        return self._to_gateway(answers, now_ns)

    def passed(self, frame: Frame, now_ns: int, *, to_gateway: bool) -> Frames:
        """Let the active faults change a frame. Returns what arrives now; the rest is on the agenda."""
        if self.silences:
            return ()
        arrivals = [Arrival(frame)]
        for _, changer in self.changers:
            arrivals = [arrival for before in arrivals for arrival in changed_by(changer, before)]
        now: Frames = ()
        for arriving, delay_ns, is_additional in arrivals:
            if is_additional:
                self._agenda.add(now_ns + delay_ns, partial(self._from_stranger, arriving))
            elif delay_ns:
                self._agenda.add(now_ns + delay_ns, partial(self._arrive_late, arriving, to_gateway))
            else:
                now += (arriving,)
        return now

    def _arrive_late(self, frame: Frame, to_gateway: bool, now_ns: int) -> Frames:
        if self.silences:
            return ()
        return (frame,) if to_gateway else self.at_boards(frame, now_ns)

    def _from_stranger(self, frame: Frame, now_ns: int) -> Frames:
        """Put a frame of a node that is no part of the rig on the bus: gateway and boards receive it."""
        if self._bus is not None:
            self._bus.send_foreign(frame, now_ns)
            return ()
        if self.silences:
            return ()
        return (frame, *self.at_boards(frame, now_ns))

    # Begin and end of an effect

    def begin(self, fault: AnyFault, random: Random, now_ns: int) -> Frames:
        """Let a fault act from now on. Returns frames to the gateway."""
        match fault:
            case (
                Foreign(interval_s=interval_s) | Flood(interval_s=interval_s) | Babble(interval_s=interval_s)
            ):
                return self._send_repeatedly(fault, round(interval_s * 1e9), 128, now_ns)
            case BusOff() if self._bus is not None:
                return (self._bus.take_gateway_off(now_ns),)
            case BusOff():
                self.silences.append(fault)
                return (BUS_OFF_FRAME,)
            case Unplug() if self._bus is not None:
                self._bus.unplug(now_ns)
            case Unplug():
                self.silences.append(fault)
            case ErrorFrames():
                assert self._bus is not None, "checked when the fault was armed"
                destroyer = self._destroyers[id(fault)] = FrameDestroyer(fault, random).broken_bit
                self._bus.disturbances.append(destroyer)
            case Reset(board=name):
                board = self._boards.adc if name == "adc" else self._boards.dac
                self._hangs = [hang for hang in self._hangs if hang.board != name]
                self._update_hung(name)
                return self._to_gateway(board.start(now_ns), now_ns)
            case Hang(board=name):
                self._hangs.append(fault)
                self._update_hung(name)
            case Twin(board=name):
                self.twins.append((fault, self._second_board(name, now_ns)))
            case FreezeSensor() | DriftSensor() | NoisySensor() | OffsetSensor():
                channel = self._rig.axes[fault.axis].potentiometer.channel - 1
                self._wires.break_sensor(fault, channel, now_ns, random)
            case StickValve() | SlowValve():
                self._wires.break_valve(fault, self._rig.axes[fault.axis].valve.channel - 1)
            case ArmFault(event=event):
                assert isinstance(self._boards.plant, HasEvents), "checked when the fault was armed"
                self._boards.plant.apply(event)
            case Stall(stall_s=stall_s):
                self.host.stall(now_ns, round(stall_s * 1e9))
            case StepClock(step_s=step_s):
                self.host.step_clock(round(step_s * 1e9))
            case Kill() | Pause() | FillDisk():
                raise AssertionError("refused when it was armed")
            case _:
                self.changers.append((fault, FrameChanger(fault, random, self._rig.bus.wire_version)))
        return ()

    def end(self, fault: AnyFault, now_ns: int) -> Frames:
        """Undo what a fault does."""
        self._ended.add(id(fault))
        self.changers = [entry for entry in self.changers if entry[0] is not fault]
        self.twins = [entry for entry in self.twins if entry[0] is not fault]
        self.silences = [silence for silence in self.silences if silence is not fault]
        match fault:
            case Hang(board=name):
                self._hangs = [hang for hang in self._hangs if hang is not fault]
                self._update_hung(name)
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
        self._agenda.add(
            now_ns + interval_ns,
            partial(self._send_repeatedly, fault, interval_ns, (counter + 1) & 0xFF),
        )
        match fault:
            case Flood(identifier=identifier):
                return self._from_stranger(Frame(identifier, bytes(8)), now_ns)
            case Babble(board=name):
                frame = self._last.get(SAMPLE_ID) if name == "adc" else None
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

    def _update_hung(self, name: str) -> None:
        """Let a board hang while any fault hangs it: the end of one that a reset has ended does nothing."""
        hung = any(hang.board == name for hang in self._hangs)
        if name == "adc":
            self._boards.adc.faults = self._boards.adc.faults or AdcFaults()
            self._boards.adc.faults.hung = hung
        else:
            self._boards.dac.faults = self._boards.dac.faults or DacFaults()
            self._boards.dac.faults.hung = hung

    def _second_board(self, name: str, now_ns: int) -> AdcBoard | DacBoard:
        """Return a second board with the same node id, which is operational already."""
        bits, heartbeat_ns = 12, 100_000_000
        twin: AdcBoard | DacBoard
        if name == "adc":
            sample = self._boards.plant.potentiometer_v
            twin = AdcBoard(self._rig, sample, resolution_bits=bits, heartbeat_ns=heartbeat_ns)
        else:
            twin = DacBoard(
                self._rig, lambda _volts, _now_ns: None, resolution_bits=bits, heartbeat_ns=heartbeat_ns
            )
        twin.start(now_ns)
        node = ADC_NODE if name == "adc" else DAC_NODE
        twin.receive(Frame(NMT_ID, bytes((NmtCommand.START, node))), now_ns)
        return twin
