"""A bench for the simulated boards: a test moves the clock and sets the potentiometers' voltages."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import msgspec

from firmware_sim.boards.codec import Values, data_identity, decode_values, encode_values
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.frames import Frame
from hil.core.rig import DacSettings, Rig
from support.constants import PERIOD_NS
from support.shipped_rig import SHIPPED_RIG

RIG: Rig = msgspec.structs.replace(
    SHIPPED_RIG,
    dac=DacSettings(
        protected=True, apply="at sync", watchdog_timeout_s=5 * 0.0112, heartbeat_timeout_s=27 * 0.0112
    ),
)
HEARTBEAT_NS = 100_000_000
MS = 1_000_000

SYNC = Frame(0x080)
START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130
ADC_BOOT, DAC_BOOT = Frame(0x710, b"\x00"), Frame(0x720, b"\x00")


class HandPlant:
    """A plant whose potentiometers have the voltages that a test sets; it records each advance."""

    def __init__(self) -> None:
        self.volts: list[float] = [5.0, 5.0, 5.0]
        self.held: list[tuple[int, tuple[float, ...]]] = []

    def advance(self, duration_ns: int, valve_v: Sequence[float]) -> None:
        self.held.append((duration_ns, tuple(valve_v)))

    def potentiometer_v(self) -> Sequence[float]:
        return self.volts


def nmt(command: int, node: int = 0) -> Frame:
    return Frame(0x000, bytes((command, node)))


def command(volts: Sequence[float], counter: int) -> Frame:
    first, second, third = (int(v * 32768 / 10) for v in volts)
    return pdo(0x220, (first, second, third), counter)


def pdo(identifier: int, counts: tuple[int, int, int], counter: int | None, wire_version: int = 2) -> Frame:
    """An analogue PDO as the boards encode it."""
    return Frame(identifier, encode_values(counts, counter, data_identity(identifier, wire_version)))


def decoded(frame: Frame, *, protected: bool = True, wire_version: int = 2) -> Values:
    """An analogue PDO as the boards decode it."""
    return decode_values(frame.data, protected, data_identity(frame.id, wire_version))


def gateway_heartbeat() -> Frame:
    return Frame(0x701, b"\x05")


def emergency(frame: Frame) -> tuple[int, int, int]:
    """Return node, error code and error register of an EMCY."""
    code, register = struct.unpack_from("<HB", frame.data)
    return frame.id - 0x080, code, register


def with_dac(**changes: Any) -> Rig:
    """Return the bench's rig with some settings of the valve board changed."""
    return msgspec.structs.replace(RIG, dac=msgspec.structs.replace(RIG.dac, **changes))


class Bench:
    """A rig that is powered on at 1 s, and a clock that only the test moves."""

    def __init__(self, rig: Rig = RIG, **options: Any) -> None:
        self.plant = HandPlant()
        self.now_ns = 1_000_000_000
        self.rig = SimulatedRig(rig, self.plant, **options)
        self.booted = self.rig.start(self.now_ns)
        self.counter = -1

    @property
    def valve_v(self) -> tuple[float, ...]:
        return self.rig.dac.valve_v

    def give(self, frame: Frame) -> list[Frame]:
        return list(self.rig.receive(frame, self.now_ns))

    def wait(self, duration_ns: int) -> list[Frame]:
        """Let time pass as a shell does, which handles every deadline on time. Returns the boards' frames."""
        end_ns, frames = self.now_ns + duration_ns, []
        while self.rig.next_deadline_ns <= end_ns:
            self.now_ns = self.rig.next_deadline_ns
            frames += self.rig.on_deadline(self.now_ns)
        self.now_ns = end_ns
        return frames

    def started(self) -> Bench:
        self.give(nmt(START))
        return self

    def command(self, *volts: float) -> list[Frame]:
        self.counter += 1
        return self.give(command(volts, self.counter & 0xFF))

    def period(self, *volts: float) -> list[Frame]:
        """Run a period: SYNC, a command, the rest. Returns all frames except heartbeats and TPDO1."""
        frames = self.give(SYNC) + self.command(*volts) + self.wait(PERIOD_NS)
        return [frame for frame in frames if frame.id not in (0x710, 0x720, 0x190)]
