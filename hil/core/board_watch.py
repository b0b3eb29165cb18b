"""State of one board after CiA 301: boot-up, NMT state, heartbeat timeout, and emergencies in words."""

from __future__ import annotations

from enum import IntEnum

from hil.core.frames import Frame
from hil.core.nmt_starts import NmtStarts
from hil.core.wire import codec

ADC_NODE = 0x10
"""CANopen node id of the potentiometer board."""
DAC_NODE = 0x20
"""CANopen node id of the valve board."""

NMT_START = 1
"""NMT command that makes a node operational."""

EMERGENCIES = {
    0x1000: "generic error",
    0x2000: "current",
    0x2100: "current at the device's input",
    0x2200: "current inside the device",
    0x2300: "current at the device's output",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3200: "voltage inside the device",
    0x3300: "output voltage",
    0x4000: "temperature",
    0x4100: "ambient temperature",
    0x4200: "device temperature",
    0x5000: "device hardware",
    0x6000: "device software",
    0x6100: "internal software",
    0x6200: "user software",
    0x6300: "data set",
    0x7000: "additional modules",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8110: "CAN overrun, frames lost",
    0x8120: "CAN in error passive mode",
    0x8130: "heartbeat or life guard error",
    0x8140: "recovered from bus-off",
    0x8150: "collision of identifiers",
    0x8200: "protocol error",
    0x8210: "PDO not processed: too short",
    0x8220: "PDO too long",
    0x8230: "multiplexed PDO not processed",
    0x8240: "SYNC of unexpected length",
    0x8250: "RPDO did not come in time",
    0x9000: "external error",
    0xF000: "additional functions",
    0xFF00: "device specific",
}
"""Meaning of an emergency error code (CiA 301).

A code of which only the leading digits are listed is more specific.
"""


def describe_error_code(error_code: int) -> str:
    """Return an error code of CiA 301 as a number with its meaning in words."""
    masks = (0xFFF0, 0xFF00, 0xF000)  # No listed code has a last digit other than 0.
    known = (EMERGENCIES[error_code & mask] for mask in masks if error_code & mask in EMERGENCIES)
    return f"0x{error_code:04X} ({next(known, 'unknown error')})"


def describe_emergency(error_code: int, error_register: int, vendor: bytes) -> str:
    """Return an emergency message in words. ``vendor`` are its last five bytes; zeros are left out."""
    text = f"EMCY {describe_error_code(error_code)}, error register 0x{error_register:02X}"
    return f"{text}, vendor bytes {vendor.hex(' ').upper()}" if any(vendor) else text


class NmtState(IntEnum):
    """NMT state of a node, as its heartbeat carries it."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class BoardWatch:
    """State of one board, from its heartbeats and emergency messages. Times are monotonic nanoseconds."""

    def __init__(self, name: str, node_id: int, timeout_ns: int, timeout_key: str) -> None:
        """``timeout_key`` is the rig file's key that sets the timeout, for messages."""
        self.name = name
        self.node_id = node_id
        self._timeout_ns = timeout_ns
        self._timeout_key = timeout_key
        self._last_heartbeat_ns: int | None = None
        self.nmt_state: int | None = None
        """NMT state in the last heartbeat; None before the first one and after a timeout."""
        self.error: str | None = None
        """Last emergency in words; None if the board has reported that no error is left, or has restarted."""
        self.starts = NmtStarts()

    @property
    def is_up(self) -> bool:
        """True if the last heartbeat says operational and has not timed out."""
        return self.nmt_state == NmtState.OPERATIONAL

    @property
    def is_fit(self) -> bool:
        """True if the board is up, has no error, and is settled if it needed many starts."""
        return self.is_up and self.error is None and not self.starts.are_excessive

    def heartbeat(self, nmt_state: int, now_ns: int) -> Frame | None:
        """Take a heartbeat. Return the NMT command that starts the board, or None if it is operational."""
        self._last_heartbeat_ns = now_ns
        self.nmt_state = nmt_state
        if nmt_state == NmtState.BOOT_UP:
            self.error = None
        if nmt_state == NmtState.OPERATIONAL:
            self.starts.operational(now_ns)
            return None
        return Frame(codec.NMT, codec.encode_nmt(NMT_START, self.node_id))

    def check_timeout(self, now_ns: int) -> str | None:
        """Return the reason why the board counts as lost if its heartbeat has timed out, else None.

        A board that has timed out is reported once, and is watched again after its next heartbeat.
        """
        if self._last_heartbeat_ns is None or now_ns - self._last_heartbeat_ns <= self._timeout_ns:
            return None
        silent_ms = (now_ns - self._last_heartbeat_ns) / 1e6
        self._last_heartbeat_ns = None
        self.nmt_state = None
        self.starts.silent()
        return (
            f"no heartbeat for {silent_ms:.0f} ms, limit {self._timeout_ns / 1e6:.0f} ms "
            f"(rig: {self._timeout_key})"
        )

    def describe(self) -> str:
        """Return the board's state in words."""
        if self.nmt_state is None:
            return "silent"
        try:
            state = NmtState(self.nmt_state).name.lower().replace("_", "-")
        except ValueError:
            state = f"in unknown NMT state {self.nmt_state}"
        if self.starts.are_excessive and self.is_up:
            state = f"{state}, but not settled after {self.starts.sent} NMT starts"
        elif self.starts.are_ignored and not self.is_up:
            state = f"{state} after {self.starts.sent} NMT starts"
        return state if self.error is None else f"{state}, in error: {self.error}"
