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
    start_prevented_by: int | None = None
    """CiA 301 error code of an error for which the board ignores NMT start. 1001h and 1003h show it."""


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
    emergency_stop_pressed: bool = False
    """The contact of the emergency stop is open, whatever the plant says."""
    enable_released: bool = False
    """The contact of the enable switch is open, whatever the plant says."""
    silent_inputs: bool = False
    """The frames of the digital inputs never reach the bus."""
    input_crcs_to_corrupt: int = 0
    """Number of frames of digital inputs with a wrong CRC."""


@dataclass(slots=True)
class DacFaults(BoardFaults):
    """Faults of the valve board. Channels are counted from 1, as in the rig file."""

    frozen_v: dict[int, float] = field(default_factory=dict)
    """Channel to the voltage on its pin, whatever is commanded. A change acts no later than the next SYNC."""
    silent_read_back: bool = False
    """TPDO1, with the voltages on the pins, never reaches the bus."""
