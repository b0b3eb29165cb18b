"""The CANopen part of both boards (CiA 301): NMT, boot-up message, heartbeat, EMCY and object dictionary.

A slave is a state machine. It is given frames and the time; it returns frames. It reads no clock and does no
I/O. A configuration tool can read the object dictionary, and write the heartbeat's interval (1017h) and clear
the list of errors (1003h). Everything else is set by the constructors.
"""

from __future__ import annotations

from enum import IntEnum
from functools import partial
from typing import Final, Generic, NamedTuple, TypeAlias, TypeVar

from firmware_sim.boards.codec import (
    EMERGENCY_ID,
    HEARTBEAT_ID,
    NMT_ID,
    SDO_ANSWER_ID,
    SDO_REQUEST_ID,
    SYNC_ID,
    encode_emergency,
)
from firmware_sim.boards.faults import BoardFaults
from firmware_sim.boards.object_dictionary import (
    AbortCode,
    DataType,
    Dictionary,
    Entry,
    Value,
    constant,
    record,
)
from firmware_sim.boards.sdo_server import SdoServer
from hil.core.frames import Frame

NEVER: Final = 2**63 - 1
"""Time of a deadline that is not set, in nanoseconds."""

Frames: TypeAlias = tuple[Frame, ...]
Faults = TypeVar("Faults", bound=BoardFaults)


class SlaveState(IntEnum):
    """NMT state of a slave, with the value that its heartbeat carries. ``OFF`` is a board without power."""

    OFF = -1
    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """Command specifier of an NMT frame (CiA 301)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


class ErrorCode(IntEnum):
    """EMCY error code (CiA 301) of an error that a board detects by itself."""

    NONE = 0x0000
    HEARTBEAT = 0x8130
    PROTOCOL = 0x8200
    PDO_LENGTH = 0x8210
    SYNC_LENGTH = 0x8240
    RPDO_TIMEOUT = 0x8250


COMMUNICATION_ERROR: Final = 0x11
"""Value of the error register in an EMCY: bit 0 (any error) and bit 4 (communication error)."""
_REGISTER_BITS: Final = {0x2: 0x02, 0x3: 0x04, 0x4: 0x08, 0x8: 0x10, 0xF: 0x80}
"""Bit of the error register besides bit 0, by the first digit of an error code."""
KEPT_ERRORS: Final = 4
"""Number of errors that 1003h keeps."""
MS_NS: Final = 1_000_000


class Identity(NamedTuple):
    """What a board says of itself: objects 1000h, 1008h and 1018h."""

    device_type: int
    """CiA 301: the profile (401: I/O modules) and its kinds of channels."""
    name: str
    product_code: int
    vendor_id: int = 0
    """0, because the simulated boards have no vendor."""
    revision: int = 0x0001_0000
    serial_number: int = 1


class CanopenSlave(Generic[Faults]):
    """A slave without an application. A board overrides the ``_on_…`` methods that do nothing here.

    ``faults`` is None for a board that works; a test sets it to break the board.
    """

    __slots__ = (
        "_default_heartbeat_ns",
        "_dictionary",
        "_error_history",
        "_errors",
        "_heartbeat_due_ns",
        "_heartbeat_ns",
        "_identity",
        "_now_ns",
        "_sdo",
        "_sdo_request_id",
        "faults",
        "next_deadline_ns",
        "node_id",
        "state",
    )

    def __init__(self, node_id: int, heartbeat_ns: int, identity: Identity) -> None:
        self.node_id = node_id
        self._identity = identity
        self.state = SlaveState.OFF
        self.faults: Faults | None = None
        self.next_deadline_ns = NEVER
        self._default_heartbeat_ns = self._heartbeat_ns = heartbeat_ns
        self._heartbeat_due_ns = NEVER
        self._errors: set[ErrorCode] = set()
        self._error_history: list[int] = []
        """Error codes, the last one first."""
        self._now_ns = 0
        """Time of the SDO request that is being handled."""
        self._dictionary: Dictionary | None = None
        self._sdo_request_id = SDO_REQUEST_ID + node_id
        self._sdo = SdoServer(self._object_dictionary)

    def start(self, now_ns: int) -> Frames:
        """Power the board on, or reset it. Returns the boot-up message; the state is pre-operational."""
        self._errors.clear()
        self._error_history.clear()
        self._sdo.reset()
        self.state = SlaveState.PRE_OPERATIONAL
        self._heartbeat_ns = self._default_heartbeat_ns
        self._heartbeat_due_ns = now_ns + self._heartbeat_ns
        self._on_reset(now_ns)
        self._schedule()
        return (self._state_frame(SlaveState.BOOT_UP),)

    def receive(self, frame: Frame, now_ns: int) -> Frames:
        """Handle a data frame with an 11 bit identifier. Returns the frames that the board sends."""
        if self.state is SlaveState.OFF or (self.faults is not None and self.faults.hung):
            return ()
        if frame.id == SYNC_ID:
            return self._on_sync_frame(frame.data, now_ns)
        if frame.id == NMT_ID:
            return self._on_nmt(frame.data, now_ns)
        if frame.id == self._sdo_request_id:
            return self._on_sdo(frame.data, now_ns)
        return self._on_frame(frame, now_ns)

    def on_deadline(self, now_ns: int) -> Frames:
        """Handle the timeouts and the heartbeat that are due at ``now_ns``.

        If several heartbeats are overdue, the board sends one and keeps the original schedule.
        """
        if self.faults is not None and self.faults.hung:
            self.next_deadline_ns = now_ns + self._default_heartbeat_ns
            return ()
        frames = self._on_time(now_ns)
        if now_ns >= self._heartbeat_due_ns:
            missed = (now_ns - self._heartbeat_due_ns) // self._heartbeat_ns
            self._heartbeat_due_ns += (missed + 1) * self._heartbeat_ns
            if self.faults is None:
                frames += (self._state_frame(self.state),)
            else:
                frames += self._on_faulty_heartbeat(self.faults)
        self._schedule()
        return frames

    def _on_reset(self, now_ns: int) -> None:
        """Put the application into its initial state."""

    def _on_state(self, now_ns: int) -> None:
        """Handle a change of ``state`` by an NMT command."""

    def _on_sync(self, now_ns: int) -> Frames:
        """Handle SYNC in the state operational."""
        return ()

    def _on_frame(self, frame: Frame, now_ns: int) -> Frames:
        """Handle a frame that is neither SYNC nor NMT."""
        return ()

    def _on_time(self, now_ns: int) -> Frames:
        """Handle the application's own timeouts."""
        return ()

    def _schedule(self) -> None:
        """Set ``next_deadline_ns`` to the earliest of all deadlines."""
        self.next_deadline_ns = self._heartbeat_due_ns

    def _application_objects(self) -> Dictionary:
        """Return the entries of the board's application."""
        return {}

    def _report(self, code: ErrorCode, vendor_code: int = 0, vendor_value: int = 0) -> Frames:
        """Return the EMCY for an error that begins; no frame while the error lasts or in state stopped."""
        if code in self._errors:
            return ()
        self._errors.add(code)
        return self._emergency(code, COMMUNICATION_ERROR, vendor_code, vendor_value)

    def _recover(self, *codes: ErrorCode) -> Frames:
        """End these errors. Returns EMCY "no error" if no other error is left."""
        if self._errors.isdisjoint(codes):
            return ()
        self._errors.difference_update(codes)
        return () if self._errors else self._emergency(ErrorCode.NONE, 0)

    def _emergency(self, code: int, register: int, vendor_code: int = 0, vendor_value: int = 0) -> Frames:
        if code != ErrorCode.NONE:
            self._error_history = [code, *self._error_history][:KEPT_ERRORS]
        if self.state is SlaveState.STOPPED:
            return ()
        return (
            Frame(EMERGENCY_ID + self.node_id, encode_emergency(code, register, vendor_code, vendor_value)),
        )

    def _state_frame(self, state: SlaveState) -> Frame:
        return Frame(HEARTBEAT_ID + self.node_id, bytes((state,)))

    def _on_sync_frame(self, data: bytes, now_ns: int) -> Frames:
        if self.state is SlaveState.STOPPED:
            return ()
        if data:
            return self._report(ErrorCode.SYNC_LENGTH, vendor_value=len(data))
        frames = self._on_sync(now_ns) if self.state is SlaveState.OPERATIONAL else ()
        if self._errors:
            frames += self._recover(ErrorCode.SYNC_LENGTH)
        if self.faults is not None:
            frames += self._injected_emergency(self.faults)
        return frames

    def _on_nmt(self, data: bytes, now_ns: int) -> Frames:
        if len(data) != 2 or data[1] not in (0, self.node_id):
            return ()
        match data[0]:
            case NmtCommand.START:
                if self.faults is not None and self.faults.start_prevented_by is not None:
                    return ()
                self.state = SlaveState.OPERATIONAL
            case NmtCommand.STOP:
                self.state = SlaveState.STOPPED
            case NmtCommand.ENTER_PRE_OPERATIONAL:
                self.state = SlaveState.PRE_OPERATIONAL
            case NmtCommand.RESET_NODE | NmtCommand.RESET_COMMUNICATION:
                return self.start(now_ns)
            case _:
                return ()
        self._on_state(now_ns)
        self._schedule()
        return ()

    def _on_sdo(self, data: bytes, now_ns: int) -> Frames:
        if self.state is SlaveState.STOPPED:
            return ()
        self._now_ns = now_ns
        answer = self._sdo.answer(data)
        return () if answer is None else (Frame(SDO_ANSWER_ID + self.node_id, answer),)

    def _object_dictionary(self) -> Dictionary:
        """Return the whole dictionary. It is made when it is first used."""
        if self._dictionary is None:
            self._dictionary = self._communication_objects() | self._application_objects()
        return self._dictionary

    def _communication_objects(self) -> Dictionary:
        identity = self._identity
        u8, u16, u32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
        return {
            (0x1000, 0): constant(u32, identity.device_type),
            (0x1001, 0): Entry(u8, self._error_register),
            (0x1003, 0): Entry(u8, lambda: len(self._errors_kept()), self._clear_errors),
            **{
                (0x1003, number): Entry(u32, partial(self._kept_error, number))
                for number in range(1, KEPT_ERRORS + 1)
            },
            (0x1005, 0): constant(u32, SYNC_ID),
            (0x1008, 0): constant(DataType.VISIBLE_STRING, identity.name),
            (0x1014, 0): constant(u32, EMERGENCY_ID + self.node_id),
            (0x1017, 0): Entry(u16, lambda: self._heartbeat_ns // MS_NS, self._set_heartbeat),
            **record(
                0x1018,
                *(
                    constant(u32, value)
                    for value in (
                        identity.vendor_id,
                        identity.product_code,
                        identity.revision,
                        identity.serial_number,
                    )
                ),
            ),
        }

    def _preventing_error(self) -> int | None:
        return None if self.faults is None else self.faults.start_prevented_by

    def _error_register(self) -> int:
        register = COMMUNICATION_ERROR if self._errors else 0
        code = self._preventing_error()
        return register if code is None else register | 0x01 | _REGISTER_BITS.get(code >> 12, 0)

    def _errors_kept(self) -> list[int]:
        """Return the error codes of 1003h, the last one first."""
        code = self._preventing_error()
        return self._error_history if code is None else [code, *self._error_history][:KEPT_ERRORS]

    def _kept_error(self, number: int) -> Value:
        kept = self._errors_kept()
        return kept[number - 1] if number <= len(kept) else AbortCode.NO_DATA

    def _clear_errors(self, value: int) -> AbortCode | None:
        if value != 0:
            return AbortCode.VALUE
        self._error_history.clear()
        return None

    def _set_heartbeat(self, value: int) -> AbortCode | None:
        """Set the interval in ms until the next reset. 0 ends the heartbeat."""
        self._heartbeat_ns = value * MS_NS
        self._heartbeat_due_ns = self._now_ns + self._heartbeat_ns if value else NEVER
        self._schedule()
        return None

    def _on_faulty_heartbeat(self, faults: BoardFaults) -> Frames:
        heartbeat = () if faults.silent_heartbeat else (self._state_frame(self.state),)
        return heartbeat + self._injected_emergency(faults)

    def _injected_emergency(self, faults: BoardFaults) -> Frames:
        code, faults.emergency_code = faults.emergency_code, None
        return () if code is None else self._emergency(code, COMMUNICATION_ERROR)
