"""The CANopen part of both boards (CiA 301): NMT states, boot-up message, heartbeat producer and EMCY.

A slave is a state machine. It is given frames and the time; it returns frames. It reads no clock and does no
I/O. It has no object dictionary: the constructors take the settings that a configuration tool would write
there.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, Generic, TypeAlias, TypeVar

from firmware_sim.boards.codec import EMERGENCY_ID, HEARTBEAT_ID, NMT_ID, SYNC_ID, encode_emergency
from firmware_sim.boards.faults import BoardFaults
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


class CanopenSlave(Generic[Faults]):
    """A slave without an application. A board overrides the ``_on_…`` methods that do nothing here.

    ``faults`` is None for a board that works; a test sets it to break the board.
    """

    __slots__ = (
        "_errors",
        "_heartbeat_due_ns",
        "_heartbeat_ns",
        "faults",
        "next_deadline_ns",
        "node_id",
        "state",
    )

    def __init__(self, node_id: int, heartbeat_ns: int) -> None:
        self.node_id = node_id
        self.state = SlaveState.OFF
        self.faults: Faults | None = None
        self.next_deadline_ns = NEVER
        self._heartbeat_ns = heartbeat_ns
        self._heartbeat_due_ns = NEVER
        self._errors: set[ErrorCode] = set()

    def start(self, now_ns: int) -> Frames:
        """Power the board on, or reset it. Returns the boot-up message; the state is pre-operational."""
        self._errors.clear()
        self.state = SlaveState.PRE_OPERATIONAL
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
        return self._on_frame(frame, now_ns)

    def on_deadline(self, now_ns: int) -> Frames:
        """Handle the timeouts and the heartbeat that are due at ``now_ns``.

        If several heartbeats are overdue, the board sends one and keeps the original schedule.
        """
        if self.faults is not None and self.faults.hung:
            self.next_deadline_ns = now_ns + self._heartbeat_ns
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

    def _on_faulty_heartbeat(self, faults: BoardFaults) -> Frames:
        heartbeat = () if faults.silent_heartbeat else (self._state_frame(self.state),)
        return heartbeat + self._injected_emergency(faults)

    def _injected_emergency(self, faults: BoardFaults) -> Frames:
        code, faults.emergency_code = faults.emergency_code, None
        return () if code is None else self._emergency(code, COMMUNICATION_ERROR)
