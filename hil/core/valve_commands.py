"""The last step before the wire: every RPDO1_DAC frame is made here, and nowhere else.

What a controller asks for is limited in magnitude and in rate, rounded to what the frame can carry without
leaving the limits, counted, and protected by a CRC. Centring (5 V) is immediate: it is the safe state and
does not pass the rate limit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from hil.core.frames import Frame
from hil.core.rig import VOLTS_PER_COUNT, Valve
from hil.core.wire import codec
from hil.core.wire.crc8 import crc8_j1850

UNUSED_CHANNEL_V = 5.0


class ValveCommands:
    """The commands of all valves, in the order given, and the frame that carries them."""

    def __init__(self, valves: Sequence[Valve], period_s: float, protected: bool) -> None:
        self._centres = tuple(valve.centre_v for valve in valves)
        self._rates = tuple(valve.max_rate_v_s for valve in valves)
        self._period_s = period_s
        self._paced_s = period_s
        self._lowest = tuple(math.ceil(v.min_v / VOLTS_PER_COUNT) * VOLTS_PER_COUNT for v in valves)
        self._highest = tuple(math.floor(v.max_v / VOLTS_PER_COUNT) * VOLTS_PER_COUNT for v in valves)
        self._channels = tuple(valve.channel - 1 for valve in valves)
        self._protected = protected
        self._counter = 0
        self.volts = list(self._centres)
        """What the valves are commanded to, in volts, after the limits."""

    def centre(self) -> None:
        """Centre every valve, at once."""
        self.volts = list(self._centres)

    def pace(self, elapsed_s: float) -> None:
        """Let the commands that follow change by what their rates allow in ``elapsed_s``, a period at most.

        ``elapsed_s`` is the time since the commands before: a late one gives those after it no more room.
        """
        self._paced_s = min(max(elapsed_s, 0.0), self._period_s)

    def command(self, index: int, offset_v: float) -> float:
        """Ask valve ``index`` for ``offset_v`` volts from its centre; returns the offset that is allowed.

        ``offset_v`` must be finite: the caller faults on anything else before it comes here.
        """
        wanted = self._centres[index] + offset_v
        before, step = self.volts[index], self._rates[index] * self._paced_s
        allowed = min(max(wanted, before - step), before + step)
        allowed = min(max(allowed, self._lowest[index]), self._highest[index])
        self.volts[index] = allowed
        return offset_v if allowed == wanted else allowed - self._centres[index]

    def frame(self) -> Frame:
        """The next RPDO1_DAC frame, with the present commands."""
        channels = [UNUSED_CHANNEL_V] * 3
        for channel, volts in zip(self._channels, self.volts, strict=True):
            channels[channel] = volts
        counter = self._counter
        self._counter = (counter + 1) & 0xFF
        data = codec.encode_rpdo1_dac(channels[0], channels[1], channels[2], counter, 0)
        if self._protected:
            return Frame(codec.RPDO1_DAC, data[:7] + bytes((crc8_j1850(data[:7]),)))
        return Frame(codec.RPDO1_DAC, data[:6])
