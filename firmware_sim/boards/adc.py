"""The potentiometer board (node 0x10): it samples all channels at SYNC and answers with TPDO1.

The board is a state machine. It is given frames and the time; it returns frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from firmware_sim.boards.canopen_slave import CanopenSlave, Frames
from firmware_sim.boards.codec import ADC_NODE, TPDO1_ID, Converter, encode_values
from firmware_sim.boards.faults import AdcFaults
from hil.core.frames import Frame
from hil.core.rig import Rig


class AdcBoard(CanopenSlave[AdcFaults]):
    """The potentiometer board.

    ``sample`` returns the voltages (V, by channel) that are on the pins when it is called.
    ``resolution_bits`` is the converter's resolution, ``heartbeat_ns`` the time between two heartbeats.
    """

    __slots__ = ("_converter", "_counter", "_protected", "_sample")

    def __init__(
        self,
        rig: Rig,
        sample: Callable[[], Sequence[float]],
        *,
        resolution_bits: int,
        heartbeat_ns: int,
    ) -> None:
        super().__init__(ADC_NODE, heartbeat_ns)
        self._protected = rig.adc.protected
        self._sample = sample
        self._converter = Converter(resolution_bits)
        self._counter = 0

    def _on_reset(self, now_ns: int) -> None:
        self._counter = 0

    def _on_sync(self, now_ns: int) -> Frames:
        volts = self._sample()
        if self.faults is not None:
            return self._on_faulty_sync(volts, self.faults)
        return (self._sample_frame(volts),)

    def _sample_frame(self, volts: Sequence[float]) -> Frame:
        first, second, third = volts
        counts = self._converter.counts
        counter = self._counter
        self._counter = (counter + 1) & 0xFF
        values = (counts(first), counts(second), counts(third))
        return Frame(TPDO1_ID + ADC_NODE, encode_values(values, counter if self._protected else None))

    def _on_faulty_sync(self, volts: Sequence[float], faults: AdcFaults) -> Frames:
        if faults.counters_to_repeat > 0:
            faults.counters_to_repeat -= 1
            self._counter = (self._counter - 1) & 0xFF
        frame = self._sample_frame([faults.frozen_v.get(channel, v) for channel, v in enumerate(volts, 1)])
        if faults.samples_to_lose > 0:
            faults.samples_to_lose -= 1
            return ()
        if faults.crcs_to_corrupt > 0 and self._protected:
            faults.crcs_to_corrupt -= 1
            frame = Frame(frame.id, frame.data[:7] + bytes((frame.data[7] ^ 0x01,)))
        return (frame,)
