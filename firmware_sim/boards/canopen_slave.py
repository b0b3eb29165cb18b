"""What both boards share as CANopen slaves (CiA 301): NMT states, boot-up, heartbeat producer, EMCY.

Frames and the time in, frames out; no clock, no I/O. There is no object dictionary: what a configuration
tool would write there, the constructors take.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, Generic, TypeVar

from firmware_sim.boards.codec import EMERGENCY_ID, HEARTBEAT_ID, NMT_ID, SYNC_ID, encode_emergency
from firmware_sim.boards.faults import BoardFaults
from hil.core.frames import Frame

NEVER: Final = 2**63 - 1
"""A deadline that does not come, in nanoseconds."""

Frames = tuple[Frame, ...]
Faults = TypeVar("Faults", bound=BoardFaults)


class State(IntEnum):
    """NMT states as heartbeats carry them; ``OFF`` is a board without power."""

    OFF = -1
    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """Command specifiers of the NMT object."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


class ErrorCode(IntEnum):
    """EMCY error codes of CiA 301 that the boards send of their own accord."""

    NONE = 0x0000
    HEARTBEAT = 0x8130
    PROTOCOL = 0x8200
    PDO_LENGTH = 0x8210
    SYNC_LENGTH = 0x8240
    RPDO_TIMEOUT = 0x8250


COMMUNICATION_ERROR: Final = 0x11
"""Error register: bit 0 any error, bit 4 communication."""


class CanopenSlave(Generic[Faults]):
    """A slave without an application; a board adds its own in the methods that do nothing here."""

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
        self.state = State.OFF
        self.faults: Faults | None = None
        self.next_deadline_ns = NEVER
        self._heartbeat_ns = heartbeat_ns
        self._heartbeat_due_ns = NEVER
        self._errors: set[ErrorCode] = set()

    def start(self, now_ns: int) -> Frames:
        """Power on, or reset: boot-up message, then pre-operational."""
        self._errors.clear()
        self.state = State.PRE_OPERATIONAL
        self._heartbeat_due_ns = now_ns + self._heartbeat_ns
        self._on_reset(now_ns)
        self._schedule()
        return (self._state_frame(State.BOOT_UP),)

    def receive(self, frame: Frame, now_ns: int) -> Frames:
        """A data frame with an 11 bit identifier was on the bus; gives back what the board sends."""
        if self.state is State.OFF or (self.faults is not None and self.faults.hung):
            return ()
        if frame.id == SYNC_ID:
            return self._on_sync_frame(frame.data, now_ns)
        if frame.id == NMT_ID:
            return self._on_nmt(frame.data, now_ns)
        return self._on_frame(frame, now_ns)

    def on_deadline(self, now_ns: int) -> Frames:
        """``next_deadline_ns`` has come: heartbeats and time-outs. Missed heartbeats are not caught up."""
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
        """The application starts afresh."""

    def _on_state(self, now_ns: int) -> None:
        """``state`` has changed by an NMT command."""

    def _on_sync(self, now_ns: int) -> Frames:
        """SYNC in the state operational."""
        return ()

    def _on_frame(self, frame: Frame, now_ns: int) -> Frames:
        """Neither SYNC nor NMT."""
        return ()

    def _on_time(self, now_ns: int) -> Frames:
        """The application's own time-outs."""
        return ()

    def _schedule(self) -> None:
        """Set ``next_deadline_ns`` to the earliest deadline there is."""
        self.next_deadline_ns = self._heartbeat_due_ns

    def _report(self, code: ErrorCode, vendor_code: int = 0, vendor_value: int = 0) -> Frames:
        """EMCY when an error begins; while it lasts, and in the state stopped, nothing is sent."""
        if code in self._errors:
            return ()
        self._errors.add(code)
        return self._emergency(code, COMMUNICATION_ERROR, vendor_code, vendor_value)

    def _recover(self, *codes: ErrorCode) -> Frames:
        """EMCY "no error" when the last error has ended."""
        if self._errors.isdisjoint(codes):
            return ()
        self._errors.difference_update(codes)
        return () if self._errors else self._emergency(ErrorCode.NONE, 0)

    def _emergency(self, code: int, register: int, vendor_code: int = 0, vendor_value: int = 0) -> Frames:
        if self.state is State.STOPPED:
            return ()
        return (
            Frame(EMERGENCY_ID + self.node_id, encode_emergency(code, register, vendor_code, vendor_value)),
        )

    def _state_frame(self, state: State) -> Frame:
        return Frame(HEARTBEAT_ID + self.node_id, bytes((state,)))

    def _on_sync_frame(self, data: bytes, now_ns: int) -> Frames:
        if self.state is State.STOPPED:
            return ()
        if data:
            return self._report(ErrorCode.SYNC_LENGTH, vendor_value=len(data))
        frames = self._on_sync(now_ns) if self.state is State.OPERATIONAL else ()
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
                self.state = State.OPERATIONAL
            case NmtCommand.STOP:
                self.state = State.STOPPED
            case NmtCommand.ENTER_PRE_OPERATIONAL:
                self.state = State.PRE_OPERATIONAL
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
