"""The valve board (node 0x20): it takes commands in RPDO1 and holds the valves' voltages.

The board is a state machine. It is given frames and the time; it returns frames and reports each change of a
valve voltage to a callback. It checks every command, and it ignores a command that fails a check.

The board centres all valves

1. when it leaves the NMT state operational,
2. when no good command has arrived for the watchdog time,
3. when the gateway's heartbeat, once it has been seen, is absent for its timeout.

If the rig file has ``dac.read_back``, the board answers each SYNC with TPDO1: the voltages on its pins, after
the command of that SYNC was applied.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from functools import partial
from typing import Final, NamedTuple, TypeAlias

from firmware_sim.boards.canopen_slave import (
    MS_NS,
    NEVER,
    CanopenSlave,
    ErrorCode,
    Frames,
    Identity,
    SlaveState,
)
from firmware_sim.boards.codec import (
    DAC_NODE,
    GATEWAY_NODE,
    HEARTBEAT_ID,
    RPDO1_ID,
    TPDO1_ID,
    Converter,
    RejectedPdoError,
    data_identity,
    decode_values,
    encode_values,
)
from firmware_sim.boards.faults import DacFaults
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
from hil.core.rig import Rig, nanoseconds

Volts: TypeAlias = tuple[float, float, float]
"""Voltages of the board's three channels."""

IDENTITY: Final = Identity(device_type=0x0008_0191, name="Simulated valve board", product_code=DAC_NODE)
"""CiA 401 with analogue outputs."""
MAX_COUNTER_STEP: Final = 127
"""Largest forward difference of the command counter that is accepted. Beyond it the counter went back."""


class VendorCode(IntEnum):
    """Vendor-specific code of EMCY 0x8200: why the board rejected a command."""

    NONE = 0
    CRC = 1
    COUNTER = 2
    RANGE = 3
    WIRE_VERSION = 4
    """The command's CRC is right in the other wire version, which is the vendor's value."""


class Accepted(NamedTuple):
    """A command that passed all checks."""

    counts: tuple[int, int, int]
    counter: int | None
    """Rolling counter of the frame; None for a frame without one."""


class Rejected(NamedTuple):
    """A command that failed a check, and the fields of the EMCY that reports it."""

    error_code: ErrorCode
    vendor_code: VendorCode = VendorCode.NONE
    vendor_value: int = 0


class DacBoard(CanopenSlave[DacFaults]):
    """The valve board.

    ``drive(volts, now_ns)`` is called whenever the voltages on the pins change.
    ``resolution_bits`` is the converter's resolution, ``heartbeat_ns`` the time between two heartbeats.
    """

    __slots__ = (
        "_applies_at_once",
        "_centre_v",
        "_command_due_ns",
        "_command_identity",
        "_commanded_v",
        "_converter",
        "_counter",
        "_drive",
        "_gateway_due_ns",
        "_gateway_timeout_ns",
        "_pending_v",
        "_protected",
        "_read_back_counter",
        "_read_back_identity",
        "_reads_back",
        "_watchdog_ns",
        "_wire_version",
        "valve_v",
    )

    def __init__(
        self, rig: Rig, drive: Callable[[Volts, int], None], *, resolution_bits: int, heartbeat_ns: int
    ) -> None:
        super().__init__(DAC_NODE, heartbeat_ns, IDENTITY)
        self._protected = rig.dac.protected
        self._wire_version = rig.bus.wire_version
        self._command_identity = data_identity(RPDO1_ID + DAC_NODE, rig.bus.wire_version)
        self._read_back_identity = data_identity(TPDO1_ID + DAC_NODE, rig.bus.wire_version)
        self._applies_at_once = rig.dac.apply == "at once"
        self._watchdog_ns = nanoseconds(rig.dac.watchdog_timeout_s)
        self._gateway_timeout_ns = nanoseconds(rig.dac.heartbeat_timeout_s)
        self._drive = drive
        self._converter = Converter(resolution_bits)
        centre_v = [5.0, 5.0, 5.0]
        for axis in rig.axes.values():
            centre_v[axis.valve.channel - 1] = axis.valve.centre_v
        self._centre_v: Volts = (centre_v[0], centre_v[1], centre_v[2])
        self._commanded_v = self._centre_v
        self.valve_v = self._centre_v
        """Voltages on the valves' pins now."""
        self._pending_v: Volts | None = None
        self._counter: int | None = None
        self._reads_back = rig.dac.read_back
        self._read_back_counter = 0
        self._command_due_ns = NEVER
        self._gateway_due_ns = NEVER

    def _on_reset(self, now_ns: int) -> None:
        self._gateway_due_ns = NEVER
        self._read_back_counter = 0
        self._centre(now_ns)

    def _on_state(self, now_ns: int) -> None:
        if self.state is not SlaveState.OPERATIONAL:
            self._centre(now_ns)

    def _on_frame(self, frame: Frame, now_ns: int) -> Frames:
        if frame.id == RPDO1_ID + DAC_NODE:
            return self._on_command(frame.data, now_ns) if self.state is SlaveState.OPERATIONAL else ()
        if frame.id == HEARTBEAT_ID + GATEWAY_NODE and len(frame.data) == 1:
            self._gateway_due_ns = now_ns + self._gateway_timeout_ns
            self._schedule()
            return self._recover(ErrorCode.HEARTBEAT) if self._errors else ()
        return ()

    def _on_command(self, data: bytes, now_ns: int) -> Frames:
        verdict = self._check(data)
        if isinstance(verdict, Rejected):
            return self._report(verdict.error_code, verdict.vendor_code, verdict.vendor_value)
        self._counter = verdict.counter
        frames: Frames = ()
        if self._errors:
            frames = self._recover(ErrorCode.PROTOCOL, ErrorCode.PDO_LENGTH, ErrorCode.RPDO_TIMEOUT)
        if self._pending_v is None:
            # If SYNC has stopped, the pending command is never applied. Commands that only replace it must
            # not restart the watchdog.
            self._command_due_ns = now_ns + self._watchdog_ns
            self._schedule()
        if ErrorCode.HEARTBEAT not in self._errors:
            self._accept(verdict.counts, now_ns)
        return frames

    def _check(self, data: bytes) -> Accepted | Rejected:
        try:
            counts, counter = decode_values(data, self._protected, self._command_identity)
        except RejectedPdoError as error:
            if error.reason == RejectedPdoError.LENGTH:
                return Rejected(ErrorCode.PDO_LENGTH, vendor_value=len(data))
            return self._wrong_crc(data)
        if counter is not None and self._counter is not None:
            step = (counter - self._counter) & 0xFF
            if step == 0 or step > MAX_COUNTER_STEP:
                return Rejected(ErrorCode.PROTOCOL, VendorCode.COUNTER, counter)
        if min(counts) < 0:
            return Rejected(ErrorCode.PROTOCOL, VendorCode.RANGE)
        return Accepted(counts, counter)

    def _wrong_crc(self, data: bytes) -> Rejected:
        """Return why a command with a wrong CRC is rejected: it is damaged, or of the other wire version."""
        other = 3 - self._wire_version
        try:
            decode_values(data, True, data_identity(RPDO1_ID + DAC_NODE, other))
        except RejectedPdoError:
            return Rejected(ErrorCode.PROTOCOL, VendorCode.CRC, data[7])
        return Rejected(ErrorCode.PROTOCOL, VendorCode.WIRE_VERSION, other)

    def _accept(self, counts: tuple[int, int, int], now_ns: int) -> None:
        convert = self._converter.volts
        first, second, third = counts
        volts = (convert(first), convert(second), convert(third))
        if self._applies_at_once:
            self._set(volts, now_ns)
        else:
            self._pending_v = volts

    def _on_sync(self, now_ns: int) -> Frames:
        pending_v, self._pending_v = self._pending_v, None
        self._set(self._commanded_v if pending_v is None else pending_v, now_ns)
        return self._read_back() if self._reads_back else ()

    def _read_back(self) -> Frames:
        """Return TPDO1 with the voltages on the pins."""
        counter, self._read_back_counter = self._read_back_counter, (self._read_back_counter + 1) & 0xFF
        if self.faults is not None and self.faults.silent_read_back:
            return ()
        counts = (self._pin_count(1), self._pin_count(2), self._pin_count(3))
        data = encode_values(counts, counter if self._protected else None, self._read_back_identity)
        return (Frame(TPDO1_ID + DAC_NODE, data),)

    def _pin_count(self, channel: int) -> int:
        return self._converter.counts(self.valve_v[channel - 1])

    def _commanded_count(self, channel: int) -> int:
        return self._converter.counts(self._commanded_v[channel - 1])

    def _application_objects(self) -> Dictionary:
        i16, i32, u8 = DataType.INTEGER16, DataType.INTEGER32, DataType.UNSIGNED8
        commanded, applied = 0x6411, 0x2002
        channels, protected = (1, 2, 3), self._protected
        counts = self._converter.counts
        read_back_id = TPDO1_ID + DAC_NODE | (0 if self._reads_back else NOT_USED)
        consumed = GATEWAY_NODE << 16 | self._gateway_timeout_ns // MS_NS
        return {
            **record(0x1016, constant(DataType.UNSIGNED32, consumed)),
            **communication(0x1400, RPDO1_ID + DAC_NODE, 255 if self._applies_at_once else 1),
            **mapping(0x1600, *_mapped(commanded, 0x2000, protected)),
            **communication(0x1800, read_back_id, 1),
            **mapping(0x1A00, *_mapped(applied, 0x2001, protected)),
            **record(0x2000, Entry(u8, lambda: self._counter or 0), Entry(u8, lambda: 0)),
            **record(0x2001, Entry(u8, lambda: (self._read_back_counter - 1) & 0xFF), Entry(u8, lambda: 0)),
            **record(applied, *(Entry(i16, partial(self._pin_count, c)) for c in channels)),
            **record(commanded, *(Entry(i16, partial(self._commanded_count, c)) for c in channels)),
            (WIRE_VERSION_INDEX, 0): constant(u8, self._wire_version),
            **record(0x6443, *(constant(u8, 1) for _ in channels)),
            **record(0x6444, *(constant(i32, counts(self._centre_v[c - 1])) for c in channels)),
        }

    def _on_time(self, now_ns: int) -> Frames:
        frames: Frames = ()
        if now_ns >= self._command_due_ns:
            self._centre(now_ns)
            frames += self._report(ErrorCode.RPDO_TIMEOUT)
        if now_ns >= self._gateway_due_ns:
            self._gateway_due_ns = NEVER
            self._centre(now_ns)
            frames += self._report(ErrorCode.HEARTBEAT, vendor_value=GATEWAY_NODE)
        return frames

    def _schedule(self) -> None:
        self.next_deadline_ns = min(self._heartbeat_due_ns, self._command_due_ns, self._gateway_due_ns)

    def _centre(self, now_ns: int) -> None:
        """Centre the valves, stop the watchdog, and accept any counter in the next command."""
        self._pending_v = None
        self._counter = None
        self._command_due_ns = NEVER
        self._set(self._centre_v, now_ns)

    def _set(self, volts: Volts, now_ns: int) -> None:
        self._commanded_v = volts
        if self.faults is not None and (frozen_v := self.faults.frozen_v):
            first, second, third = volts
            volts = (frozen_v.get(1, first), frozen_v.get(2, second), frozen_v.get(3, third))
        if volts != self.valve_v:
            self.valve_v = volts
            self._drive(volts, now_ns)


def _mapped(values: int, protection: int, is_protected: bool) -> list[tuple[int, int, int]]:
    """Return the mapping of three channels, with counter and CRC if the PDO is protected."""
    mapped = [(values, channel, 16) for channel in (1, 2, 3)]
    return [*mapped, (protection, 1, 8), (protection, 2, 8)] if is_protected else mapped
