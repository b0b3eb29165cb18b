"""Valve input (voltage to spool position) and potentiometer output (position to voltage) of an axis."""

from __future__ import annotations

import math
from random import Random
from typing import Final

from firmware_sim.arm.parameters import Potentiometer, Valve
from hil.core.errors import SimulationError

FULL_TRAVEL_V: Final = 5.0
"""Offset from the valve's centre at which the spool is at full travel."""

_S_PEAK: Final = 6.0 * math.sqrt(3.0)
"""Reciprocal of the maximum of s (1 - s) (1 - 2 s) for s from 0 to 1."""


class ValveInput:
    """Electronics of a valve: offset of its true centre, limit of the command, and play (hysteresis)."""

    __slots__ = ("_centre_v", "_engaged_v", "_play_v", "held_v")

    def __init__(self, valve: Valve) -> None:
        self._centre_v = valve.centre_v
        self._play_v = valve.hysteresis_v
        self._engaged_v = 0.0
        self.held_v = math.nan
        """Voltage on the pin; NaN before the first command."""

    def spool_command(self, volts: float) -> float:
        """Return the spool position (-1 to 1) that ``volts`` commands.

        Raises SimulationError if ``volts`` is not finite.
        """
        if not math.isfinite(volts):
            raise SimulationError(f"valve voltage {volts} V is not a finite number")
        self.held_v = volts
        offset = min(max(volts - self._centre_v, -FULL_TRAVEL_V), FULL_TRAVEL_V)
        self._engaged_v = min(max(self._engaged_v, offset - self._play_v), offset + self._play_v)
        return self._engaged_v / FULL_TRAVEL_V


class PotentiometerOutput:
    """A potentiometer on 10 V with non-linearity, noise, and a wire that can break."""

    __slots__ = ("_bend", "_noise_v", "_origin", "_random", "_span", "broken")

    def __init__(self, potentiometer: Potentiometer, random: Random) -> None:
        self._origin = potentiometer.y_at_0v
        self._span = potentiometer.y_at_10v - potentiometer.y_at_0v
        self._bend = _S_PEAK * potentiometer.nonlinearity
        self._noise_v = potentiometer.noise_v
        self._random = random
        self.broken = False

    def volts(self, position: float) -> float:
        """Return a reading at ``position``, 0 to 10 V.

        A broken wire draws from the noise too, so that it does not change the noise of the other axes.
        """
        s = (position - self._origin) / self._span
        volts = 10.0 * (s + self._bend * s * (1.0 - s) * (1.0 - 2.0 * s)) + self._random.gauss(
            0.0, self._noise_v
        )
        return 0.0 if self.broken else min(max(volts, 0.0), 10.0)
