"""The potentiometer board (node 0x10): it samples all channels at SYNC and answers with TPDO1.

After TPDO1 it sends the frames of the digital inputs that the rig file names, TPDO2 for example. The board is
a state machine. It is given frames and the time; it returns frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from firmware_sim.boards.canopen_slave import CanopenSlave, Frames, Identity
from firmware_sim.boards.codec import (
    ADC_NODE,
    TPDO1_ID,
    TPDO2_ID,
    Converter,
    data_identity,
    encode_values,
)
from firmware_sim.boards.faults import AdcFaults
from firmware_sim.boards.input_frames import Contacts, InputFrames
from firmware_sim.boards.object_dictionary import (
    NOT_USED,
    WIRE_VERSION_INDEX,
    DataType,
    Dictionary,
    Entry,
    communication,
    constant,
    mapping,
    record,
)
from hil.core.frames import Frame
from hil.core.rig import Rig

IDENTITY = Identity(device_type=0x0005_0191, name="Simulated potentiometer board", product_code=ADC_NODE)
"""CiA 401 with analogue and digital inputs."""


class AdcBoard(CanopenSlave[AdcFaults]):
    """The potentiometer board.

    ``sample`` returns the voltages (V, by channel) that are on the pins when it is called, and ``contacts``
    the state of the contacts at the digital inputs.
    ``resolution_bits`` is the converter's resolution, ``heartbeat_ns`` the time between two heartbeats.
    """

    __slots__ = (
        "_contacts",
        "_converter",
        "_counter",
        "_inputs",
        "_protected",
        "_sample",
        "_sample_identity",
        "_values",
        "_wire_version",
    )

    def __init__(
        self,
        rig: Rig,
        sample: Callable[[], Sequence[float]],
        *,
        resolution_bits: int,
        heartbeat_ns: int,
        contacts: Callable[[], Contacts] = Contacts,
    ) -> None:
        super().__init__(ADC_NODE, heartbeat_ns, IDENTITY)
        self._protected = rig.adc.protected
        self._wire_version = rig.bus.wire_version
        self._sample_identity = data_identity(TPDO1_ID + ADC_NODE, rig.bus.wire_version)
        self._sample = sample
        self._converter = Converter(resolution_bits)
        self._counter = 0
        self._values = (0, 0, 0)
        """Counts of the last sample."""
        self._contacts = contacts
        self._inputs = InputFrames(rig, self._present_contacts)

    def _on_reset(self, now_ns: int) -> None:
        self._counter = 0
        self._inputs.reset()

    def _on_sync(self, now_ns: int) -> Frames:
        volts = self._sample()
        if self.faults is not None:
            return self._on_faulty_sync(volts, self.faults) + self._faulty_inputs(self.faults)
        sample = (self._sample_frame(volts),)
        return sample + self._inputs.frames() if self._inputs.is_used else sample

    def _present_contacts(self) -> Contacts:
        contacts, faults = self._contacts(), self.faults
        if faults is None:
            return contacts
        return Contacts(
            contacts.emergency_stop and not faults.emergency_stop_pressed,
            contacts.enable and not faults.enable_released,
        )

    def _faulty_inputs(self, faults: AdcFaults) -> Frames:
        frames = self._inputs.frames()
        if faults.silent_inputs:
            return ()
        if frames and faults.input_crcs_to_corrupt > 0:
            faults.input_crcs_to_corrupt -= 1
            return tuple(
                frame._replace(data=frame.data[:-1] + bytes((frame.data[-1] ^ 0x01,))) for frame in frames
            )
        return frames

    def _value(self, place: int) -> int:
        return self._values[place]

    def _application_objects(self) -> Dictionary:
        i16, u8 = DataType.INTEGER16, DataType.UNSIGNED8
        values = [(0x6401, channel, 16) for channel in (1, 2, 3)]
        protection = [(0x2000, 1, 8), (0x2000, 2, 8)] if self._protected else []
        inputs_id = TPDO2_ID + ADC_NODE
        if inputs_id not in self._inputs.identifiers:
            inputs_id |= NOT_USED
        return {
            **communication(0x1800, TPDO1_ID + ADC_NODE, 1),
            **communication(0x1801, inputs_id, 1),
            **mapping(0x1A00, *values, *protection),
            **mapping(0x1A01, (0x6000, 1, 8), (0x2001, 1, 8), (0x2001, 2, 8)),
            **record(0x2000, Entry(u8, lambda: (self._counter - 1) & 0xFF), Entry(u8, lambda: 0)),
            **record(0x2001, Entry(u8, lambda: self._inputs.last_counter), Entry(u8, lambda: 0)),
            **record(0x6000, Entry(u8, self._inputs.first_byte)),
            (WIRE_VERSION_INDEX, 0): constant(u8, self._wire_version),
            **record(0x6401, *(Entry(i16, partial(self._value, place)) for place in range(3))),
        }

    def _sample_frame(self, volts: Sequence[float]) -> Frame:
        first, second, third = volts
        counts = self._converter.counts
        counter = self._counter
        self._counter = (counter + 1) & 0xFF
        values = self._values = (counts(first), counts(second), counts(third))
        protection = counter if self._protected else None
        return Frame(TPDO1_ID + ADC_NODE, encode_values(values, protection, self._sample_identity))

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
