"""Faults that a test can put on a board while it runs.

Assign an instance to ``board.faults``; assign None to repair the board. A field that counts
(``samples_to_lose``) decreases by one each time the fault shows on the bus. Every other field stays as it is
set.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class BoardFaults:
    """Faults that both boards can have."""

    hung: bool = False
    """The processor has stopped: the board takes no frame, sends no frame and keeps its outputs."""
    silent_heartbeat: bool = False
    """The board sends no heartbeat."""
    emergency_code: int | None = None
    """CiA 301 error code of an EMCY that the board sends once, at the next SYNC or heartbeat."""


@dataclass(slots=True)
class AdcFaults(BoardFaults):
    """Faults of the potentiometer board. Channels are counted from 1, as in the rig file."""

    frozen_v: dict[int, float] = field(default_factory=dict)
    """Channel to the voltage that it reads, whatever voltage is on the pin."""
    samples_to_lose: int = 0
    """Number of TPDO1 frames that never reach the bus. The sample counter still advances."""
    crcs_to_corrupt: int = 0
    """Number of TPDO1 frames with a wrong CRC."""
    counters_to_repeat: int = 0
    """Number of TPDO1 frames that repeat the counter of the frame before."""


@dataclass(slots=True)
class DacFaults(BoardFaults):
    """Faults of the valve board. Channels are counted from 1, as in the rig file."""

    frozen_v: dict[int, float] = field(default_factory=dict)
    """Channel to the voltage on its pin, whatever is commanded. A change acts no later than the next SYNC."""
