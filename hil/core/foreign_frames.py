"""Classify the frames on the bus that the boards do not send to the gateway.

A frame that only the gateway may send, or that could move a valve or change a board, comes from a second
master: an intrusion. Any other unknown frame is harmless. It is reported once.
"""

from __future__ import annotations

from typing import NamedTuple

from hil.core.board_watch import ADC_NODE, DAC_NODE
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState
from hil.core.wire import codec

OWN_IDENTIFIERS = {
    codec.RPDO1_DAC: "RPDO1_DAC",
    codec.SYNC: "SYNC",
    codec.NMT: "NMT",
    codec.HEARTBEAT_GATEWAY: "HEARTBEAT_GATEWAY",
}
"""Identifiers that only the gateway sends. A received frame with one of them comes from a second master."""

COMMANDS_TO_BOARDS = {
    0x320: "RPDO2 to the DAC board",
    0x420: "RPDO3 to the DAC board",
    0x520: "RPDO4 to the DAC board",
    0x600 + DAC_NODE: "SDO to the DAC board",
    0x600 + ADC_NODE: "SDO to the ADC board",
}
"""Identifiers that can move a valve or change a board. Nobody may send them while the gateway is armed."""

UNUSED_FRAMES = {
    codec.TPDO1_DAC: "TPDO1_DAC, which this rig does not use (rig: dac.read_back)",
    codec.TPDO2_ADC: "TPDO2_ADC, which this rig does not use (rig: emergency_stop.frame, enable.frame)",
}
"""Frames in ``arm.dbc`` that are used only if the rig file says so."""

MAX_REPORTED_IDENTIFIERS = 64
"""Number of unknown identifiers that are reported, so that a babbling node does not fill the recording."""

SECOND_MASTER = "another master is on this bus; disconnect it"


class Intrusion(NamedTuple):
    """A frame of a second master. It is a fault."""

    reason: str


class UnknownFrame(NamedTuple):
    """A frame that the rig does not use and that has not been reported before."""

    text: str


class ForeignFrames:
    """Classifier of foreign frames, which remembers what it has reported."""

    def __init__(self) -> None:
        self._reported: set[Frame] = set()
        """Reported frames, without their data."""

    def check(self, frame: Frame, state: LifeCycleState) -> Intrusion | UnknownFrame | None:
        """Classify a frame in ``state`` of the gateway; None if it is ignored.

        ``frame`` is not an error frame.
        """
        kind = frame._replace(data=b"")
        is_standard = not (frame.is_extended or frame.is_remote)
        if is_standard and frame.id in OWN_IDENTIFIERS:
            if state is LifeCycleState.FAULT and kind in self._reported:
                return None
            self._reported.add(kind)
            return Intrusion(f"foreign {OWN_IDENTIFIERS[frame.id]} frame {frame}: {SECOND_MASTER}")
        is_armed = state in (LifeCycleState.ARMED, LifeCycleState.RUNNING)
        if is_standard and is_armed and frame.id in COMMANDS_TO_BOARDS:
            return Intrusion(f"{COMMANDS_TO_BOARDS[frame.id]}, frame {frame}: {SECOND_MASTER}")
        if kind in self._reported or len(self._reported) >= MAX_REPORTED_IDENTIFIERS:
            return None
        self._reported.add(kind)
        what = UNUSED_FRAMES.get(frame.id, "not in arm.dbc") if is_standard else "not in arm.dbc"
        return UnknownFrame(f"frame {frame} is {what}; further frames with its identifier are not reported")
