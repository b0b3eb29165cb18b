"""Supervision of one board after CiA 301: boot-up, NMT state, heartbeat time-out, EMCY in words."""

from __future__ import annotations

from enum import IntEnum

from hil.core.frames import Frame
from hil.core.wire import codec

NMT_START = 1

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
"""CiA 301, table of emergency error codes; the last two digits, or three, may say more."""


def describe_emergency(error_code: int, error_register: int, vendor: bytes) -> str:
    """An EMCY object in words. ``vendor`` are its last five bytes, told where they say anything."""
    known = next(
        (
            EMERGENCIES[error_code & mask]
            for mask in (0xFFFF, 0xFFF0, 0xFF00, 0xF000)
            if error_code & mask in EMERGENCIES
        ),
        "unknown error",
    )
    text = f"EMCY 0x{error_code:04X} ({known}), error register 0x{error_register:02X}"
    return f"{text}, vendor bytes {vendor.hex(' ').upper()}" if any(vendor) else text


class NmtState(IntEnum):
    """States of a node in its heartbeat."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class BoardWatch:
    """What the gateway knows of one board from its heartbeats."""

    def __init__(self, name: str, node_id: int, timeout_ns: int, timeout_key: str) -> None:
        self.name = name
        self.node_id = node_id
        self._timeout_ns = timeout_ns
        self._timeout_key = timeout_key
        self._last_ns: int | None = None
        self.nmt_state: int | None = None
        self.error: str | None = None
        """The last EMCY in words, until the board says that no error is left, or starts anew."""

    @property
    def is_up(self) -> bool:
        """Whether its last heartbeat says operational and is not overdue."""
        return self.nmt_state == NmtState.OPERATIONAL

    @property
    def is_fit(self) -> bool:
        """Whether it is up and has no error left."""
        return self.is_up and self.error is None

    def heartbeat(self, nmt_state: int, now_ns: int) -> Frame | None:
        """Take a heartbeat; returns the NMT command that starts the board where it is not operational."""
        self._last_ns = now_ns
        self.nmt_state = nmt_state
        if nmt_state == NmtState.BOOT_UP:
            self.error = None
        if nmt_state == NmtState.OPERATIONAL:
            return None
        return Frame(codec.NMT, codec.encode_nmt(NMT_START, self.node_id))

    def overdue(self, now_ns: int) -> str | None:
        """Why the board counts as lost, once: its heartbeat stopped. None while all is well."""
        if self._last_ns is None or now_ns - self._last_ns <= self._timeout_ns:
            return None
        silent_ms = (now_ns - self._last_ns) / 1e6
        self._last_ns = None
        self.nmt_state = None
        return (
            f"no heartbeat for {silent_ms:.0f} ms, limit {self._timeout_ns / 1e6:.0f} ms "
            f"(rig: {self._timeout_key})"
        )

    def describe(self) -> str:
        """The board's state in words."""
        if self.nmt_state is None:
            return "silent"
        try:
            state = NmtState(self.nmt_state).name.lower().replace("_", "-")
        except ValueError:
            state = f"in unknown NMT state {self.nmt_state}"
        return state if self.error is None else f"{state}, in error: {self.error}"
