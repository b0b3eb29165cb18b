"""Supervision of one board after CiA 301: boot-up, NMT state, heartbeat time-out."""

from __future__ import annotations

from enum import IntEnum

from hil.frames import Frame
from hil.wire import codec

NMT_START = 1


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

    @property
    def is_up(self) -> bool:
        """Whether its last heartbeat says operational and is not overdue."""
        return self.nmt_state == NmtState.OPERATIONAL

    def heartbeat(self, nmt_state: int, now_ns: int) -> Frame | None:
        """Take a heartbeat; returns the NMT command that starts the board where it is not operational."""
        self._last_ns = now_ns
        self.nmt_state = nmt_state
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
            return NmtState(self.nmt_state).name.lower().replace("_", "-")
        except ValueError:
            return f"in unknown NMT state {self.nmt_state}"
