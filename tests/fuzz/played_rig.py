"""Give the steps of a sequence to one gateway, and play the boards and the operator.

A step is a list of plain JSON values: its kind and its arguments. What it does depends on what happened
before it, such as the counter of the last sample. The same sequence therefore always gives the same calls,
and a sequence without some of its steps is a sequence too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from fuzz import rigs, wire
from fuzz.checker import Arm, Checker, Jog
from fuzz.rigs import RIGS, RigFacts
from hil.core.control_law import ControlLaw, LawNumbers, law_numbers
from hil.core.controller_change import PreparedController, prepare_controller
from hil.core.controller_file import Law, PidLaw, StateSpaceLaw, TransferFunctionLaw
from hil.core.excitation import Prbs
from hil.core.experiment import Experiment
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.life_cycle import Trigger
from hil.core.output import Output
from hil.core.requests import (
    ArmRequest,
    CheckFailure,
    ControllerRequest,
    JogRequest,
    Request,
    SetpointRequest,
)
from hil.core.rig import Rig, read_rig
from hil.core.setpoints import Setpoint, parse_setpoint

PERIOD_S = rigs.PERIOD_NS / 1e9
START_NS = 1_000_000_000
LAWS: dict[str, Law] = {
    "pid": PidLaw(kp=20.0, ki=50.0, kd=1.0, tau_d=0.02),
    "steep": PidLaw(kp=-1e6, ki=0.0),
    "no number": StateSpaceLaw(A=[[1e9]], B=[[1.0]], C=[[0.0]], D=[[20.0]]),  # 0 times infinity
    "filter": TransferFunctionLaw(num=[1.0, 0.0], den=[1.0, 1.0]),
}
SETPOINTS = ("hold", "ladder:0.1,-0.1@0/0.05", "step:0.05@0", "sine:0.1@0/0.5")
DOCUMENT = """{"format": "hil-controller", "version": 1, "name": "", "description": "", "origin": {},
"sample_time_s": 0.0112, "input_unit": "%s", "output_unit": "V",
"law": {"kind": "pid", "kp": %s, "ki": 5.0}}"""
CONTROLLERS = tuple(
    DOCUMENT % (unit, gain) for unit in ("m", "rad") for gain in ("20.0", "-900.0", "1e5", '"high"')
)
CHECKS = ("memory lock", "controller-vertical")
CENTRED = (wire.CENTRE_COUNTS,) * wire.CHANNELS

Step = list[Any]


class PlayedRig:
    """One gateway with played boards. ``inputs`` is the number of calls of the gateway so far."""

    def __init__(self, rig_name: str, law: str, setpoint: str) -> None:
        self.facts = RIGS[rig_name]
        self._rig = _rig(rig_name)
        self.core = Gateway(
            self._rig,
            {axis.name: ControlLaw.of_numbers(_numbers(law), PERIOD_S) for axis in self.facts.axes},
            dict.fromkeys(self._rig.axes, _setpoint(setpoint)),
            START_NS,
            _experiment(self.facts),
        )
        self.checker = Checker(self.facts, START_NS)
        self.now_ns = START_NS
        self.inputs = 0
        self._counter = self._inputs_counter = self._read_back_counter = 0
        self._volts = CENTRED
        """Counts of the potentiometers in the last sample."""
        self._last_commands: list[Frame] = []
        """Commands of the last call."""
        self._pins = list(CENTRED)
        """Counts of the last command that the bus took."""
        self._steps: dict[str, Callable[..., None]] = {
            "periods": self._periods,
            "deadline": self._deadline,
            "pause": self._pause,
            "sample": self._sample,
            "heartbeat": self._heartbeat,
            "emergency": self._emergency,
            "inputs": self._digital_inputs,
            "read back": self._read_back,
            "frame": self._frame,
            "operate": self._operate,
            "arm": self._arm,
            "setpoint": self._change_setpoint,
            "controller": self._change_controller,
            "jog": self._jog,
            "link failure": self._link_failure,
            "refuse": self._refuse,
            "bring up": self._bring_up,
        }

    @property
    def state(self) -> str:
        """State of the life cycle, as the gateway reports it."""
        return self.checker.follower.state

    def take(self, step: Step) -> None:
        """Take one step. Raises BrokenRule, or what the gateway raises."""
        self._steps[step[0]](*step[1:])

    # Steps. Every argument is an integer, a float, a text or a list of integers.

    def _periods(
        self,
        number: int,
        ways: Sequence[int],
        after_ns: int,
        counter_step: int = 1,
        damage: int = 0,
        left_out: int = 0,
    ) -> None:
        """Let periods pass, in which each axis moves by ``ways`` (counts a period).

        They are good unless ``counter_step`` or ``damage`` spoils their samples. ``left_out`` has a bit for
        each kind of frame that does not arrive; 0: every frame arrives.
        """
        for _ in range(number):
            self._deadline(0)
            for bit, identifier in enumerate((wire.ADC_HEARTBEAT, wire.DAC_HEARTBEAT)):
                if not left_out >> bit & 1:
                    self._heartbeat(identifier, wire.OPERATIONAL)
            if (self.facts.has_stop or self.facts.has_enable) and not left_out & 4:
                self._digital_inputs(rigs.STOP_MASK | rigs.ENABLE_MASK, 1, 0)
            if self.facts.read_back and not left_out & 8:
                self._read_back([0, 0, 0], 1, 0)
            if not left_out & 16:
                self._sample(ways, after_ns, counter_step, damage)

    def _deadline(self, late_ns: int) -> None:
        self.now_ns = max(self.now_ns, self.core.next_deadline_ns + late_ns)
        self.checker.given_deadline(self.now_ns)
        self._returned(self.core.on_deadline(self.now_ns))

    def _pause(self, duration_ns: int) -> None:
        self.now_ns += duration_ns

    def _sample(self, ways: Sequence[int], after_ns: int, counter_step: int, damage: int) -> None:
        """Send a sample that differs by ``ways`` from the last one, unless ``damage`` keeps the old one."""
        self.now_ns += after_ns
        self._counter += counter_step
        moved = [max(-32768, min(count + way, 32767)) for count, way in zip(self._volts, ways, strict=True)]
        first, second, third = self._volts = moved[0], moved[1], moved[2]
        data = wire.analogue((first, second, third))
        if self.facts.adc_protected:
            data = wire.protect(wire.SAMPLE, data, self._counter, self.facts.wire_version)
        self._receive(Frame(wire.SAMPLE, _damaged(data, damage)))
        is_outside = any(not 700 < count < 32000 for count in self._volts)
        if is_outside:
            self._volts = CENTRED

    def _heartbeat(self, identifier: int, state: int) -> None:
        self._receive(Frame(identifier, bytes((state,))))

    def _emergency(self, identifier: int, code: int) -> None:
        self._receive(Frame(identifier, code.to_bytes(2, "little") + bytes((0x11, 0, 0, 0, 0, 0))))

    def _digital_inputs(self, bits: int, counter_step: int, damage: int) -> None:
        self._inputs_counter += counter_step
        data = bytes((bits,))
        if self.facts.inputs_protected:
            data = wire.protect(wire.INPUTS, data, self._inputs_counter, self.facts.wire_version)
        self._receive(Frame(wire.INPUTS, _damaged(data, damage)))

    def _read_back(self, differences: Sequence[int], counter_step: int, damage: int) -> None:
        """Answer with the pins' counts, which differ from the last command by ``differences``."""
        self._read_back_counter += counter_step
        pins = [
            max(0, min(pin + difference, 32767))
            for pin, difference in zip(self._pins, differences, strict=True)
        ]
        data = wire.analogue(pins)
        if self.facts.dac_protected:
            data = wire.protect(wire.READ_BACK, data, self._read_back_counter, self.facts.wire_version)
        self._receive(Frame(wire.READ_BACK, _damaged(data, damage)))

    def _frame(self, identifier: int, data: str, flags: int) -> None:
        is_extended, is_remote, is_error = (bool(flags >> bit & 1) for bit in range(3))
        self._receive(Frame(identifier, bytes.fromhex(data), is_extended, is_remote, is_error))

    def _operate(self, trigger: str) -> None:
        self._request(Trigger(trigger), trigger)

    def _arm(self, failed: int, overridden: int) -> None:
        """Arm with failed and overridden checks, each as bits."""
        failures = tuple(CheckFailure(name, "played") for bit, name in enumerate(CHECKS) if failed >> bit & 1)
        overrides = tuple(name for bit, name in enumerate(CHECKS) if overridden >> bit & 1)
        self._request(ArmRequest(failures, overrides), Arm(not failed & ~overridden))

    def _change_setpoint(self, axis: str, text: str) -> None:
        self._request(SetpointRequest(axis, text), None)

    def _change_controller(self, axis: str, number: int, is_prepared: int) -> None:
        request = ControllerRequest(axis, "new.json", CONTROLLERS[number % len(CONTROLLERS)])
        prepared = None
        if is_prepared and axis in self._rig.axes:
            prepared = _prepared(self.facts.name, request)
        self._request(request, None, prepared)

    def _jog(self, axis: str, offset_v: float, duration_s: float) -> None:
        self._request(JogRequest(axis, offset_v, duration_s), Jog(axis, offset_v, duration_s))

    def _link_failure(self) -> None:
        self.checker.given_link_failure(self.now_ns)
        self._returned(self.core.link_failed("lost"))

    def _refuse(self) -> None:
        """Let the bus refuse the commands of the last call."""
        for frame in reversed(self._last_commands):
            self.inputs += 1
            self.core.command_refused(frame)
            self.checker.refused(frame.data)
        self._last_commands = []

    def _bring_up(self, until: str) -> None:
        """Lead the gateway to state ready, armed or running, or to a jog, as an operator does."""
        self._volts = CENTRED
        for board in (wire.ADC_EMERGENCY, wire.DAC_EMERGENCY):
            self._emergency(board, 0)
        self._operate("reset")
        for _ in range(7):
            self._periods(1, [0, 0, 0], 1_000_000)
            if self.state != "offline":
                break
        if until != "ready":
            self._operate("arm")
        if until == "running":
            self._operate("start")
        elif until == "jogged":
            self._jog(self.facts.axes[-1].name, 0.5, 0.1)

    # Calls of the gateway

    def _receive(self, frame: Frame) -> None:
        self.checker.given_frame(*frame, self.now_ns)
        self._returned(self.core.receive(frame, self.now_ns))

    def _request(
        self, request: Request, observed: object, prepared: PreparedController | None = None
    ) -> None:
        self.checker.given_request(observed, self.now_ns)
        self._returned(self.core.operate(request, self.now_ns, prepared))

    def _returned(self, output: Output) -> None:
        self.inputs += 1
        self._last_commands = [frame for frame in output.frames if frame.id == wire.COMMAND]
        for frame in self._last_commands:
            self._pins = list(wire.counts_of(frame.data))
        self.checker.returned(output, self.now_ns)


def _damaged(data: bytes, damage: int) -> bytes:
    """Return ``data`` intact (0), with one flipped bit (1 to 64), too short (65) or too long (66)."""
    if damage == 0:
        return data
    if damage == 65:
        return data[:-1]
    if damage == 66:
        return (data + b"\0")[:8] if len(data) < 8 else data[:7]
    bit = (damage - 1) % (8 * len(data))
    flipped = bytearray(data)
    flipped[bit // 8] ^= 1 << bit % 8
    return bytes(flipped)


@cache
def _rig(name: str) -> Rig:
    return read_rig(RIGS[name].document(), f"{name}.toml")


@cache
def _numbers(law: str) -> LawNumbers:
    with np.errstate(over="ignore", invalid="ignore"):
        return law_numbers(LAWS[law], PERIOD_S)


@cache
def _setpoint(text: str) -> Setpoint:
    return parse_setpoint(text)


@cache
def _prepared(rig_name: str, request: ControllerRequest) -> PreparedController:
    return prepare_controller(request, _rig(rig_name))


def _experiment(facts: RigFacts) -> Experiment | None:
    if facts.excited is None:
        return None
    signal = Prbs(amplitude=0.5, duration_s=0.5, clock_periods=3)
    return Experiment(
        format="hil-experiment",
        version=1,
        axis=facts.excited,
        mode="controller output",
        signal=signal,
        approach_s=0.1,
        settle_s=0.1,
    )
