"""Between the boards' pins and the arm: what a valve makes of a voltage, a potentiometer of a position."""

from __future__ import annotations

import math
from random import Random
from typing import Final

from firmware_sim.arm.parameters import Potentiometer, Valve
from hil.core.errors import SimulationError

FULL_TRAVEL_V: Final = 5.0
"""Offset from the valve's centre at which the spool is at its end."""

_S_PEAK: Final = 6.0 * math.sqrt(3.0)
"""1 over the largest value of s (1 - s) (1 - 2 s) on 0 to 1."""


class ValveInput:
    """The valve's electronics: offset from its true centre, limit, and play (hysteresis)."""

    __slots__ = ("_centre_v", "_engaged_v", "_play_v", "held_v")

    def __init__(self, valve: Valve) -> None:
        self._centre_v = valve.centre_v
        self._play_v = valve.hysteresis_v
        self._engaged_v = 0.0
        self.held_v = math.nan
        """The voltage on the pin."""

    def spool_command(self, volts: float) -> float:
        """Where ``volts`` on the pin send the spool, -1 to 1. Raises SimulationError for NaN and infinity."""
        if not math.isfinite(volts):
            raise SimulationError(f"{volts} V on a valve is no voltage")
        self.held_v = volts
        offset = min(max(volts - self._centre_v, -FULL_TRAVEL_V), FULL_TRAVEL_V)
        self._engaged_v = min(max(self._engaged_v, offset - self._play_v), offset + self._play_v)
        return self._engaged_v / FULL_TRAVEL_V


class PotentiometerOutput:
    """A potentiometer on 10 V: non-linear, noisy, and on a wire that can break."""

    __slots__ = ("_bend", "_noise_v", "_origin", "_random", "_span", "broken")

    def __init__(self, potentiometer: Potentiometer, random: Random) -> None:
        self._origin = potentiometer.y_at_0v
        self._span = potentiometer.y_at_10v - potentiometer.y_at_0v
        self._bend = _S_PEAK * potentiometer.nonlinearity
        self._noise_v = potentiometer.noise_v
        self._random = random
        self.broken = False

    def volts(self, position: float) -> float:
        """A reading at ``position``, 0 to 10 V; draws from the noise even when the wire is broken."""
        s = (position - self._origin) / self._span
        volts = 10.0 * (s + self._bend * s * (1.0 - s) * (1.0 - 2.0 * s)) + self._random.gauss(
            0.0, self._noise_v
        )
        return 0.0 if self.broken else min(max(volts, 0.0), 10.0)
