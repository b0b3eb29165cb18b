"""What can be broken on a board while it runs, as plain values: set ``board.faults``, or None to mend it.

Counts run down by themselves as the fault shows on the bus; everything else lasts until it is changed.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class BoardFaults:
    """Faults that either board can have."""

    hung: bool = False
    """The processor stands still: no frame is taken or sent, outputs stay as they are."""
    silent_heartbeat: bool = False
    emergency_code: int | None = None
    """An EMCY with this CiA 301 error code goes out at the next SYNC or heartbeat, once."""


@dataclass(slots=True)
class AdcFaults(BoardFaults):
    """Faults of the potentiometer board. Channels count from 1, as in the rig file."""

    frozen_v: dict[int, float] = field(default_factory=dict)
    """Voltage that a channel reads whatever the potentiometer does."""
    samples_to_lose: int = 0
    """TPDO1 that never reach the bus; their counter goes on."""
    crcs_to_corrupt: int = 0
    counters_to_repeat: int = 0


@dataclass(slots=True)
class DacFaults(BoardFaults):
    """Faults of the valve board. Channels count from 1, as in the rig file."""

    frozen_v: dict[int, float] = field(default_factory=dict)
    """Voltage that a channel gives whatever is commanded; shows, and mends, by the next SYNC."""
