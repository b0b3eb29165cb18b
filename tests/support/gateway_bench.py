"""A rig that a test steps by hand: the gateway core and the simulated boards, explicit frames and times.

No clock, no thread, no bus. ``Bench`` carries frames between the two cores as the lockstep shell does, and
keeps everything that was said; a test may hold frames back, change them, or send its own. ``rig_text``
changes the shipped rig file key by key.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files

from firmware_sim.plants.linear_plant import LinearPlant
from firmware_sim.plants.plant import Plant
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.control_law import ControlLaw
from hil.core.controller_file import Law, PidLaw
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Cycle, LogEntry, Output, Severity
from hil.core.rig import Rig, read_rig
from hil.core.sample_guard import FIRST_ANSWER_PERIODS
from hil.core.setpoints import parse_setpoint
from hil.core.wire import codec
from hil.core.wire.crc8 import crc8_j1850

EXAMPLE_RIG = (files("hil.shipped") / "rig.toml").read_text()

FIXED = {
    "loop.period_s": "0.0112",
    "gateway.heartbeat_interval_s": "0.1",
    "adc.stale_after_periods": "3",
    "adc.heartbeat_timeout_s": "0.3024",
    "dac.watchdog_timeout_s": "0.056",
    "dac.heartbeat_timeout_s": "0.3024",
    "dac.apply": '"at sync"',
    "axes.vertical.valve.max_rate_v_s": "400.0",
    "axes.horizontal.valve.max_rate_v_s": "400.0",
    "axes.rotation.valve.max_rate_v_s": "400.0",
}
"""What tests count on, whatever the shipped file says."""

AXES = ("vertical", "horizontal", "rotation")
START_NS = 1_000_000_000
"""When benches are switched on; the first deadline is one period later."""

ADC_BOOT, DAC_BOOT = Frame(codec.HEARTBEAT_ADC, b"\x00"), Frame(codec.HEARTBEAT_DAC, b"\x00")
ADC_UP, DAC_UP = Frame(codec.HEARTBEAT_ADC, b"\x05"), Frame(codec.HEARTBEAT_DAC, b"\x05")
SYNC = Frame(codec.SYNC)


def rig_text(changes: Mapping[str, str] | None = None, axes: Sequence[str] = AXES) -> str:
    """The shipped rig file with ``FIXED`` and ``changes`` (dotted key to TOML literal), of ``axes`` alone."""
    lines = EXAMPLE_RIG.splitlines()
    stale = (changes or {}).get("adc.stale_after_periods", "0")
    patience = (
        {"dac.watchdog_timeout_s": str((int(stale) + 2) * 0.0112)}
        if stale.isdecimal() and int(stale) > 3
        else {}
    )
    for dotted, literal in (FIXED | patience | dict(changes or {})).items():
        table, _, key = dotted.rpartition(".")
        number = line_of(lines, table, key)
        lines[number] = f"{key} = {literal}"
    head, *tables = re.split(r"(?m)^(?=\[axes\.\w+\]$)", "\n".join(lines) + "\n")
    return head + "".join(t for t in tables if re.match(r"\[axes\.(\w+)\]", t)[1] in axes)  # type: ignore[index]


def line_of(lines: Sequence[str], table: str, key: str) -> int:
    """The number of the line that sets ``key`` of ``table``."""
    here = ""
    for number, line in enumerate(lines):
        if heading := re.match(r"\[(.+?)\]", line):
            here = heading[1]
        elif here == table and re.match(rf"{key}\s*=", line):
            return number
    raise KeyError(f"{table}.{key}")


def make_rig(changes: Mapping[str, str] | None = None, axes: Sequence[str] = AXES) -> Rig:
    """The rig of :func:`rig_text`."""
    return read_rig(rig_text(changes, axes), "rig.toml")


def sample_frame(volts: Sequence[float], counter: int, *, protected: bool = True) -> Frame:
    """TPDO1_ADC as a sound board sends it."""
    first, second, third = (*volts, 5.0, 5.0)[:3]
    data = codec.encode_tpdo1_adc(first, second, third, counter & 0xFF, 0)
    if not protected:
        return Frame(codec.TPDO1_ADC, data[:6])
    return Frame(codec.TPDO1_ADC, data[:7] + bytes((crc8_j1850(data[:7]),)))


def commands_v(frame: Frame) -> tuple[float, float, float]:
    """The valve voltages in an RPDO1_DAC frame."""
    assert frame.id == codec.RPDO1_DAC
    return codec.decode_rpdo1_dac((frame.data + b"\0\0")[:8])[:3]


PROPORTIONAL = PidLaw(kp=20.0, ki=0.0)


def make_gateway(
    rig: Rig,
    laws: Mapping[str, Law] | Law = PROPORTIONAL,
    setpoints: Mapping[str, str] | str = "step:0.05@0",
    first_deadline_ns: int = START_NS,
) -> Gateway:
    """A gateway core; one law or setpoint for every axis, or one each by name."""
    by_axis = laws if isinstance(laws, Mapping) else dict.fromkeys(rig.axes, laws)
    texts = setpoints if isinstance(setpoints, Mapping) else dict.fromkeys(rig.axes, setpoints)
    return Gateway(
        rig,
        {name: ControlLaw(by_axis[name], rig.loop.period_s) for name in rig.axes},
        {name: parse_setpoint(texts[name]) for name in rig.axes},
        first_deadline_ns,
    )


class Told:
    """What a core has said: outputs in their order."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.events: list[LogEntry] = []
        self.cycles: list[Cycle] = []

    def add(self, output: Output) -> Output:
        """Keep ``output``; returns it."""
        self.frames += output.frames
        self.events += output.log
        if output.cycle is not None:
            self.cycles.append(output.cycle)
        return output

    def commands(self) -> list[tuple[float, float, float]]:
        """Voltages of every RPDO1_DAC frame."""
        return commands(Output(tuple(self.frames)))

    def texts(self) -> list[str]:
        """Events as ``source: text``."""
        return texts(Output(log=tuple(self.events)))


class HandGateway:
    """The gateway alone: a test plays the boards. Every frame that it gives is explicit."""

    def __init__(self, rig: Rig, gateway: Gateway | None = None) -> None:
        self.rig = rig
        self.period_ns = rig.loop.period_ns
        self.core = gateway or make_gateway(rig)
        self.told = Told()
        self.now_ns = START_NS
        self.counter = 0
        self.volts: Sequence[float] = (5.0, 5.0, 5.0)

    @property
    def state(self) -> LifeCycleState:
        """The core's state."""
        return self.core.state

    def give(self, *frames: Frame) -> Output:
        """Frames that arrive now; the outputs as one."""
        return self._as_one([self.core.receive(frame, self.now_ns) for frame in frames])

    def deadline(self, late_ns: int = 0) -> Output:
        """Go to the next deadline (plus ``late_ns``) and serve it."""
        self.now_ns = self.core.next_deadline_ns + late_ns
        return self.told.add(self.core.on_deadline(self.now_ns))

    def sample(self, volts: Sequence[float] | None = None, after_ns: int = 1_000_000) -> Output:
        """A sound sample with the next counter arrives ``after_ns`` later."""
        self.now_ns += after_ns
        frame = sample_frame(volts or self.volts, self.counter, protected=self.rig.adc.protected)
        self.counter += 1
        return self.give(frame)

    def lose_sample(self) -> None:
        """The board answers, and its sample does not arrive."""
        self.counter += 1

    def period(self, volts: Sequence[float] | None = None) -> Output:
        """A whole period: deadline, heartbeats of both boards, a sound sample; the sample's output."""
        has_sync = SYNC in self.deadline().frames
        output = self.give(ADC_UP, DAC_UP)
        return self.sample(volts) if has_sync else output

    def periods(self, number: int) -> None:
        """So many whole periods."""
        for _ in range(number):
            self.period()

    def operate(self, trigger: Trigger) -> Output:
        """An operator's trigger, now."""
        return self.told.add(self.core.operate(trigger, self.now_ns))

    def to(self, state: LifeCycleState) -> HandGateway:
        """From offline to ``state`` by the shortest way."""
        if state is LifeCycleState.OFFLINE:
            return self
        if state is LifeCycleState.FAULT:
            self.told.add(self.core.link_failed("test"))
            return self
        for _ in range(FIRST_ANSWER_PERIODS + 1):
            if self.state is LifeCycleState.OFFLINE:
                self.period()
        if state is not LifeCycleState.READY:
            self.operate(Trigger.ARM)
        if state is LifeCycleState.RUNNING:
            self.operate(Trigger.START)
        assert self.state is state
        return self

    def _as_one(self, outputs: Sequence[Output]) -> Output:
        for output in outputs:
            self.told.add(output)
        return Output(
            tuple(frame for output in outputs for frame in output.frames),
            tuple(event for output in outputs for event in output.log),
            outputs[-1].cycle if outputs else None,
        )


class Bench:
    """Gateway core and simulated boards on a bus without wires; ``pass_to_gateway`` may change frames."""

    def __init__(
        self,
        rig: Rig,
        laws: Mapping[str, Law] | Law = PROPORTIONAL,
        setpoints: Mapping[str, str] | str = "step:0.05@0",
        plant: Plant | None = None,
        resolution_bits: int = 12,
    ) -> None:
        self.rig = rig
        self.now_ns = START_NS
        self.boards = SimulatedRig(rig, plant or LinearPlant(rig), resolution_bits=resolution_bits)
        self.gateway = make_gateway(rig, laws, setpoints, START_NS + rig.loop.period_ns)
        self.told = Told()
        self.pass_to_gateway: Callable[[Frame], Sequence[Frame]] = lambda frame: (frame,)
        self._carry((), self.boards.start(self.now_ns))

    def period(self) -> None:
        """Until the next deadline of the gateway has been served and the bus is silent."""
        while self.boards.next_deadline_ns < self.gateway.next_deadline_ns:
            self.now_ns = self.boards.next_deadline_ns
            self._carry((), self.boards.on_deadline(self.now_ns))
        self.now_ns = self.gateway.next_deadline_ns
        self._carry(self.told.add(self.gateway.on_deadline(self.now_ns)).frames, ())

    def periods(self, number: int) -> None:
        """So many periods."""
        for _ in range(number):
            self.period()

    def operate(self, trigger: Trigger) -> Output:
        """An operator's trigger, now."""
        output = self.told.add(self.gateway.operate(trigger, self.now_ns))
        self._carry(output.frames, ())
        return output

    def run(self) -> Bench:
        """Bring the boards up, arm and start; the next sample is controlled."""
        for _ in range(20):
            self.period()
            if self.gateway.state is LifeCycleState.READY:
                break
        self.operate(Trigger.ARM)
        self.operate(Trigger.START)
        assert self.gateway.state is LifeCycleState.RUNNING
        return self

    def _carry(self, to_boards: Sequence[Frame], to_gateway: Sequence[Frame]) -> None:
        outgoing, incoming = list(to_boards), list(to_gateway)
        while outgoing or incoming:
            for sent in incoming:
                for frame in self.pass_to_gateway(sent):
                    outgoing += self.told.add(self.gateway.receive(frame, self.now_ns)).frames
            incoming = list(self.boards.receive(outgoing.pop(0), self.now_ns)) if outgoing else []


def hand(state: LifeCycleState = LifeCycleState.OFFLINE, **changes: str) -> HandGateway:
    """A gateway of the changed rig (``__`` for the dots of a key) in ``state``."""
    return HandGateway(make_rig({key.replace("__", "."): text for key, text in changes.items()})).to(state)


def texts(output: Output) -> list[str]:
    """Events as ``source: text``."""
    return [f"{event.source}: {event.text}" for event in output.log]


def faults(output: Output) -> list[str]:
    """Faults as ``source: text``."""
    return [f"{e.source}: {e.text}" for e in output.log if e.severity is Severity.FATAL]


def commands(output: Output) -> list[tuple[float, float, float]]:
    """Voltages of every RPDO1_DAC frame."""
    return [commands_v(frame) for frame in output.frames if frame.id == codec.RPDO1_DAC]
