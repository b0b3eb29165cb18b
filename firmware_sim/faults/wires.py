"""Faults between the boards' pins and the plant: sensors and valves.

Channels are counted from 0 here. Several faults on one channel act in the order in which they began.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from random import Random

from firmware_sim.faults.kinds import (
    DriftSensor,
    FreezeSensor,
    NoisySensor,
    OffsetSensor,
    SensorFault,
    SlowValve,
    StickValve,
    ValveFault,
)

MAX_V = 10.0
"""Largest voltage on a pin."""


class _Sensor:
    """A faulty potentiometer."""

    def __init__(self, fault: SensorFault, channel: int, began_ns: int, random: Random) -> None:
        self.fault = fault
        self.channel = channel
        self._began_ns = began_ns
        self._random = random
        self._frozen_v: float | None = None

    def sensed_v(self, volts: float, now_ns: int) -> float:
        match self.fault:
            case FreezeSensor():
                if self._frozen_v is None:
                    self._frozen_v = volts
                return self._frozen_v
            case DriftSensor(v_per_s=v_per_s):
                return volts + v_per_s * (now_ns - self._began_ns) * 1e-9
            case NoisySensor(rms_v=rms_v):
                return volts + self._random.gauss(0.0, rms_v)
            case OffsetSensor(offset_v=offset_v):
                return volts + offset_v


class _Valve:
    """A faulty valve input."""

    def __init__(self, fault: ValveFault, channel: int, held_v: float) -> None:
        self.fault = fault
        self.channel = channel
        self._volts = held_v

    def driven_v(self, commanded_v: float, duration_ns: int) -> float:
        match self.fault:
            case StickValve():
                return self._volts
            case SlowValve(lag_s=lag_s):
                self._volts += (commanded_v - self._volts) * -math.expm1(-duration_ns * 1e-9 / lag_s)
                return self._volts


class Wires:
    """All wires of a rig. Without a fault, voltages pass unchanged."""

    def __init__(self) -> None:
        self._sensors: list[_Sensor] = []
        self._valves: list[_Valve] = []
        self._held_v: Sequence[float] = (5.0, 5.0, 5.0)

    def break_sensor(self, fault: SensorFault, channel: int, now_ns: int, random: Random) -> None:
        """Let a sensor fault begin now. ``random`` is the source of its noise."""
        self._sensors.append(_Sensor(fault, channel, now_ns, random))

    def break_valve(self, fault: ValveFault, channel: int) -> None:
        """Let a valve fault begin now."""
        self._valves.append(_Valve(fault, channel, self._held_v[channel]))

    def repair(self, fault: SensorFault | ValveFault) -> None:
        """End a fault."""
        self._sensors = [sensor for sensor in self._sensors if sensor.fault is not fault]
        self._valves = [valve for valve in self._valves if valve.fault is not fault]

    def sensed_v(self, volts: Sequence[float], now_ns: int) -> Sequence[float]:
        """Return the voltages (V, by channel) that the board reads for those of the potentiometers."""
        if not self._sensors:
            return volts
        read = list(volts)
        for sensor in self._sensors:
            read[sensor.channel] = min(max(sensor.sensed_v(read[sensor.channel], now_ns), 0.0), MAX_V)
        return read

    def driven_v(self, valve_v: Sequence[float], duration_ns: int) -> Sequence[float]:
        """Return the voltages at the valves during the next ``duration_ns`` for those on the board's pins."""
        if self._valves:
            at_valve = list(valve_v)
            for valve in self._valves:
                at_valve[valve.channel] = valve.driven_v(at_valve[valve.channel], duration_ns)
            valve_v = at_valve
        self._held_v = valve_v
        return valve_v
