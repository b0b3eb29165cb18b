"""A rig that a test steps: the gateway core and the simulated boards, with explicit frames and times.

There is no clock, thread or bus. :class:`SteppedGateway` is the gateway alone, and the test plays the boards.
:class:`RigBench` carries frames between gateway and simulated boards as the lockstep shell does. A test may
hold frames back, change them, or send its own. Both keep everything that the gateway returned. ``rig_text``
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
from hil.core.output import Cycle, LogEntry, Output, Severity, combine
from hil.core.requests import Request
from hil.core.rig import Rig, read_rig
from hil.core.setpoints import parse_setpoint
from hil.core.sync_matching import ANSWER_TIMEOUT_PERIODS
from hil.core.wire import codec
from support.constants import PERIOD_S
from support.wire import protected as protected_frame

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
"""Values of the rig file that tests depend on, whatever the shipped file says."""

TIMEOUT_PERIODS = 27
"""Heartbeat timeout of both boards in ``FIXED``."""

PATIENT = {"adc__stale_after_periods": "5"}
"""Change of the rig file that tolerates more periods without a good sample."""

AXES = ("vertical", "horizontal", "rotation")
MAX_ERROR = {"vertical": 0.15, "horizontal": 0.15, "rotation": 1.5}
"""Largest tracking error by axis, in its unit: tests begin with a setpoint that is not the position."""
START_NS = 1_000_000_000
"""Time at which benches are switched on. The first deadline is one period later."""

ADC_BOOT, DAC_BOOT = Frame(codec.HEARTBEAT_ADC, b"\x00"), Frame(codec.HEARTBEAT_DAC, b"\x00")
ADC_UP, DAC_UP = Frame(codec.HEARTBEAT_ADC, b"\x05"), Frame(codec.HEARTBEAT_DAC, b"\x05")
SYNC = Frame(codec.SYNC)
GATEWAY_HEARTBEAT = Frame(codec.HEARTBEAT_GATEWAY, b"\x05")

LIVE_STATES = [state for state in LifeCycleState if state is not LifeCycleState.FAULT]

PROPORTIONAL = PidLaw(kp=20.0, ki=0.0)


def rig_text(changes: Mapping[str, str] | None = None, axes: Sequence[str] = AXES, envelope: str = "") -> str:
    """The shipped rig file with ``FIXED`` and ``changes`` (dotted key to TOML literal), for ``axes`` only.

    ``envelope`` is TOML for the envelope of every axis.
    """
    lines = EXAMPLE_RIG.splitlines()
    stale = (changes or {}).get("adc.stale_after_periods", "0")
    is_long = stale.isdecimal() and int(stale) > 3
    watchdog = {"dac.watchdog_timeout_s": str((int(stale) + 2) * PERIOD_S)} if is_long else {}
    for dotted, literal in (FIXED | watchdog | dict(changes or {})).items():
        table, _, key = dotted.rpartition(".")
        number = line_of(lines, table, key)
        lines[number] = f"{key} = {literal}"
    head, *tables = re.split(r"(?m)^(?=\[axes\.\w+\]$)", "\n".join(lines) + "\n")
    named = [(re.match(r"\[axes\.(\w+)\]", table)[1], table) for table in tables]  # type: ignore[index]
    return head + "".join(
        f"{table}[axes.{name}.envelope]\n{envelope or f'max_error = {MAX_ERROR[name]}'}\n"
        for name, table in named
        if name in axes
    )


def line_of(lines: Sequence[str], table: str, key: str) -> int:
    """The number of the line that sets ``key`` of ``table``."""
    here = ""
    for number, line in enumerate(lines):
        if heading := re.match(r"\[(.+?)\]", line):
            here = heading[1]
        elif here == table and re.match(rf"{key}\s*=", line):
            return number
    raise KeyError(f"{table}.{key}")


def make_rig(changes: Mapping[str, str] | None = None, axes: Sequence[str] = AXES, envelope: str = "") -> Rig:
    """The rig of :func:`rig_text`."""
    return read_rig(rig_text(changes, axes, envelope), "rig.toml")


def make_gateway(
    rig: Rig,
    laws: Mapping[str, Law] | Law = PROPORTIONAL,
    setpoints: Mapping[str, str] | str = "step:0.05@0",
    first_deadline_ns: int = START_NS,
) -> Gateway:
    """A gateway core. A single law or setpoint is used for every axis."""
    by_axis = laws if isinstance(laws, Mapping) else dict.fromkeys(rig.axes, laws)
    texts = setpoints if isinstance(setpoints, Mapping) else dict.fromkeys(rig.axes, setpoints)
    return Gateway(
        rig,
        {name: ControlLaw(by_axis[name], rig.loop.period_s) for name in rig.axes},
        {name: parse_setpoint(texts[name]) for name in rig.axes},
        first_deadline_ns,
    )


def sample_frame(volts: Sequence[float], counter: int, *, protected: bool = True) -> Frame:
    """A correct TPDO1_ADC frame."""
    first, second, third = (*volts, 5.0, 5.0)[:3]
    data = codec.encode_tpdo1_adc(first, second, third, counter & 0xFF, 0)
    if not protected:
        return Frame(codec.TPDO1_ADC, data[:6])
    return protected_frame(codec.TPDO1_ADC, data[:7])


def emergency(identifier: int, code: int, register: int = 0x11) -> Frame:
    """An emergency message without vendor bytes."""
    return Frame(identifier, codec.encode_emcy_adc(code, register, 0, 0))


def error_frame(error_class: int) -> Frame:
    """An error frame of the bus."""
    return Frame(error_class, bytes(8), is_error=True)


class Transcript:
    """Everything that a core has returned, in order."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.log: list[LogEntry] = []
        self.cycles: list[Cycle] = []

    def add(self, output: Output) -> Output:
        """Keep ``output`` and return it."""
        self.frames += output.frames
        self.log += output.log
        if output.cycle is not None:
            self.cycles.append(output.cycle)
        return output

    def commands(self) -> list[tuple[float, float, float]]:
        """Voltages of every RPDO1_DAC frame."""
        return commands(Output(tuple(self.frames)))

    def texts(self) -> list[str]:
        """Log entries as ``source: text``."""
        return texts(Output(log=tuple(self.log)))


class SteppedGateway:
    """The gateway alone. The test plays the boards, so every frame that arrives is explicit."""

    def __init__(self, rig: Rig, gateway: Gateway | None = None) -> None:
        self.rig = rig
        self.period_ns = rig.loop.period_ns
        self.core = gateway or make_gateway(rig)
        self.transcript = Transcript()
        self.now_ns = START_NS
        self.counter = 0
        self.volts: Sequence[float] = (5.0, 5.0, 5.0)

    @property
    def state(self) -> LifeCycleState:
        """The core's state."""
        return self.core.state

    def receive(self, *frames: Frame) -> Output:
        """Give the core frames that arrive now; the outputs as one."""
        return combine(*[self.transcript.add(self.core.receive(frame, self.now_ns)) for frame in frames])

    def deadline(self, late_ns: int = 0) -> Output:
        """Go to the next deadline (plus ``late_ns``) and serve it."""
        self.now_ns = self.core.next_deadline_ns + late_ns
        return self.transcript.add(self.core.on_deadline(self.now_ns))

    def sample(self, volts: Sequence[float] | None = None, after_ns: int = 1_000_000) -> Output:
        """A correct sample with the next counter arrives ``after_ns`` later."""
        self.now_ns += after_ns
        frame = sample_frame(volts or self.volts, self.counter, protected=self.rig.adc.protected)
        self.counter += 1
        return self.receive(frame)

    def lose_sample(self) -> None:
        """The board answers, and its sample does not arrive."""
        self.counter += 1

    def period(self, volts: Sequence[float] | None = None) -> Output:
        """A whole period: deadline, heartbeats of both boards, a good sample. Returns the sample's output."""
        has_sync = SYNC in self.deadline().frames
        output = self.receive(ADC_UP, DAC_UP)
        return self.sample(volts) if has_sync else output

    def periods(self, number: int) -> None:
        """``number`` whole periods."""
        for _ in range(number):
            self.period()

    def operate(self, request: Request) -> Output:
        """Give an operator's request now."""
        return self.transcript.add(self.core.operate(request, self.now_ns))

    def bring_to(self, state: LifeCycleState) -> SteppedGateway:
        """Go from offline to ``state`` by the shortest way."""
        if state is LifeCycleState.OFFLINE:
            return self
        if state is LifeCycleState.FAULT:
            self.transcript.add(self.core.link_failed("test"))
            return self
        for _ in range(ANSWER_TIMEOUT_PERIODS + 1):
            if self.state is LifeCycleState.OFFLINE:
                self.period()
        if state is not LifeCycleState.READY:
            self.operate(Trigger.ARM)
        if state is LifeCycleState.RUNNING:
            self.operate(Trigger.START)
        assert self.state is state
        return self


def make_stepped(state: LifeCycleState = LifeCycleState.OFFLINE, **changes: str) -> SteppedGateway:
    """A stepped gateway in ``state``; ``changes`` of the rig file have ``__`` for the dots of a key."""
    rig = make_rig({key.replace("__", "."): text for key, text in changes.items()})
    return SteppedGateway(rig).bring_to(state)


def make_running(
    rig: Rig, laws: Mapping[str, Law] | Law = PROPORTIONAL, setpoints: Mapping[str, str] | str = "step:0.05@0"
) -> SteppedGateway:
    """A stepped gateway of ``rig`` in state running."""
    return SteppedGateway(rig, make_gateway(rig, laws, setpoints)).bring_to(LifeCycleState.RUNNING)


class RigBench:
    """Gateway core and simulated boards on a bus without delay.

    ``pass_to_gateway`` maps a frame that a board sends to the frames that arrive at the gateway.
    """

    def __init__(
        self,
        rig: Rig,
        laws: Mapping[str, Law] | Law = PROPORTIONAL,
        setpoints: Mapping[str, str] | str = "step:0.05@0",
        plant: Plant | None = None,
        resolution_bits: int = 12,
        boards_rig: Rig | None = None,
    ) -> None:
        """``boards_rig`` is the rig file of the boards, if it is not the gateway's."""
        self.rig = rig
        self.now_ns = START_NS
        self.boards = SimulatedRig(
            boards_rig or rig, plant or LinearPlant(rig), resolution_bits=resolution_bits
        )
        self.gateway = make_gateway(rig, laws, setpoints, START_NS + rig.loop.period_ns)
        self.transcript = Transcript()
        self.pass_to_gateway: Callable[[Frame], Sequence[Frame]] = lambda frame: (frame,)
        self._carry((), self.boards.start(self.now_ns))

    def period(self) -> None:
        """Step until the gateway's next deadline has been served and no frame is left on the bus."""
        while self.boards.next_deadline_ns < self.gateway.next_deadline_ns:
            self.now_ns = self.boards.next_deadline_ns
            self._carry((), self.boards.on_deadline(self.now_ns))
        self.now_ns = self.gateway.next_deadline_ns
        self._carry(self.transcript.add(self.gateway.on_deadline(self.now_ns)).frames, ())

    def periods(self, number: int) -> None:
        """``number`` periods."""
        for _ in range(number):
            self.period()

    def operate(self, request: Request) -> Output:
        """Give an operator's request now."""
        output = self.transcript.add(self.gateway.operate(request, self.now_ns))
        self._carry(output.frames, ())
        return output

    def run(self) -> RigBench:
        """Bring the boards up, arm and start. The next sample is controlled."""
        for _ in range(20):
            self.period()
            if self.gateway.state is LifeCycleState.READY:
                break
        self.operate(Trigger.ARM)
        self.operate(Trigger.START)
        assert self.gateway.state is LifeCycleState.RUNNING
        return self

    def restart_board(self, board: str) -> None:
        """Switch one board (``adc`` or ``dac``) off and on."""
        self._carry((), getattr(self.boards, board).start(self.now_ns))

    def _carry(self, to_boards: Sequence[Frame], to_gateway: Sequence[Frame]) -> None:
        outgoing, incoming = list(to_boards), list(to_gateway)
        while outgoing or incoming:
            for sent in incoming:
                for frame in self.pass_to_gateway(sent):
                    outgoing += self.transcript.add(self.gateway.receive(frame, self.now_ns)).frames
            incoming = list(self.boards.receive(outgoing.pop(0), self.now_ns)) if outgoing else []


def texts(output: Output) -> list[str]:
    """Log entries as ``source: text``."""
    return [f"{entry.source}: {entry.text}" for entry in output.log]


def faults(output: Output) -> list[str]:
    """Fatal log entries as ``source: text``."""
    return [f"{entry.source}: {entry.text}" for entry in output.log if entry.severity is Severity.FATAL]


def commands(output: Output) -> list[tuple[float, float, float]]:
    """Voltages of every RPDO1_DAC frame."""
    return [commands_v(frame) for frame in output.frames if frame.id == codec.RPDO1_DAC]


def commands_v(frame: Frame) -> tuple[float, float, float]:
    """The valve voltages in an RPDO1_DAC frame."""
    assert frame.id == codec.RPDO1_DAC
    return codec.decode_rpdo1_dac((frame.data + b"\0\0")[:8])[:3]
