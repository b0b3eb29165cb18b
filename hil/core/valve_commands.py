"""The last step before the bus: every RPDO1_DAC frame is made here, and only here.

A control law's output is limited in magnitude and in rate, and rounded to a value that the frame can carry
without leaving the limits. The frame gets a counter and a CRC. Centring the valves (5 V) is immediate: it
is the safe state, so the rate limit does not apply to it.

The rate limit starts from the last command that the bus took. A command counts as taken until ``refused`` is
called with its frame.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from hil.core.frames import Frame
from hil.core.rig import VOLTS_PER_COUNT, Rig, Valve
from hil.core.wire import codec
from hil.core.wire.frame_crc import FrameCrc, frame_crc

UNUSED_CHANNEL_V = 5.0
"""Voltage of a channel without an axis, in volts."""
KEPT_COMMANDS = 4
"""Number of commands that are kept until they may have been refused. One call to the gateway returns at most
two commands, and their refusals are reported before the next call."""


def command_crc(rig: Rig) -> FrameCrc | None:
    """Return what makes the CRC of a rig's command frames; None if its valve board has none."""
    return frame_crc(codec.RPDO1_DAC, rig.bus.wire_version, protected=rig.dac.protected)


class ValveCommands:
    """The commands of all valves, in the order given, and the frame that carries them."""

    def __init__(self, valves: Sequence[Valve], period_s: float, crc: FrameCrc | None) -> None:
        """``crc`` makes the frame's CRC. None: the frame has neither counter nor CRC."""
        self._centres_v = tuple(valve.centre_v for valve in valves)
        self._rates_v_s = tuple(valve.max_rate_v_s for valve in valves)
        self._period_s = period_s
        self._change_time_s = period_s
        self._min_v = tuple(math.ceil(v.min_v / VOLTS_PER_COUNT) * VOLTS_PER_COUNT for v in valves)
        self._max_v = tuple(math.floor(v.max_v / VOLTS_PER_COUNT) * VOLTS_PER_COUNT for v in valves)
        self._channels = tuple(valve.channel - 1 for valve in valves)
        self._crc = crc
        self._counter = 0
        self.volts = list(self._centres_v)
        """Commanded valve voltages in volts, after the limits. The rate limits start from them."""
        self._kept: deque[tuple[Frame, list[float]]] = deque(maxlen=KEPT_COMMANDS)
        """The last commands that were not refused, with their voltages."""

    def offset_v(self, index: int) -> float:
        """Return the present command of valve ``index`` relative to its centre voltage, in volts."""
        return self.volts[index] - self._centres_v[index]

    @property
    def are_centred(self) -> bool:
        """True if the last command that the bus took centres every valve."""
        return tuple(self.volts) == self._centres_v

    def centre(self) -> None:
        """Set every command to its valve's centre voltage, at once."""
        self.volts = list(self._centres_v)

    def centre_others(self, index: int) -> None:
        """Set every command but that of valve ``index`` to its valve's centre voltage, at once."""
        self.volts = [
            v if i == index else centre
            for i, (v, centre) in enumerate(zip(self.volts, self._centres_v, strict=True))
        ]

    def set_change_time(self, elapsed_s: float) -> None:
        """Set the time for which the rate limits allow the next commands to change.

        ``elapsed_s`` is the time since the commands before, in seconds. More than one period counts as one: a
        late command does not allow a larger step.
        """
        self._change_time_s = min(max(elapsed_s, 0.0), self._period_s)

    def command(self, index: int, offset_v: float) -> float:
        """Command valve ``index`` to an offset from its centre voltage, and return the limited offset.

        ``offset_v`` is in volts and must be finite. The caller checks that, and faults otherwise.
        """
        centre = self._centres_v[index]
        before, step = self.volts[index], self._rates_v_s[index] * self._change_time_s
        wanted = allowed = centre + offset_v
        # Comparisons, because this is the hot path: min() and max() would take three times as long.
        if allowed > before + step:
            allowed = before + step
        elif allowed < before - step:
            allowed = before - step
        if allowed > self._max_v[index]:
            allowed = self._max_v[index]
        elif allowed < self._min_v[index]:
            allowed = self._min_v[index]
        self.volts[index] = allowed
        return offset_v if allowed == wanted else allowed - centre

    def frame(self) -> Frame:
        """Return the next RPDO1_DAC frame with the present commands. It counts as taken by the bus."""
        channels_v = [UNUSED_CHANNEL_V] * 3
        for channel, volts in zip(self._channels, self.volts, strict=True):
            channels_v[channel] = volts
        counter = self._counter
        self._counter = (counter + 1) & 0xFF
        data = codec.encode_rpdo1_dac(channels_v[0], channels_v[1], channels_v[2], counter, 0)
        if self._crc is None:
            frame = Frame(codec.RPDO1_DAC, data[:6])
        else:
            frame = Frame(codec.RPDO1_DAC, self._crc.append(data[:7]))
        self._kept.append((frame, self.volts.copy()))
        return frame

    def refused(self, frame: Frame) -> None:
        """Take back a command that the bus refused. ``volts`` are then those of the last one that it took."""
        for index in reversed(range(len(self._kept))):
            if self._kept[index][0] == frame:
                del self._kept[index]
                break
        self.volts = list(self._kept[-1][1] if self._kept else self._centres_v)
