"""Faults as typed documents.

A fault begins ``at_s`` seconds after its condition ``when`` is met, and lasts ``for_s`` seconds:

    [[faults]]
    fault = "lose"
    frame = "sample"
    amount = 5
    when = "vertical>0.05"

The same fault as a text is ``lose:sample,5@vertical>0.05`` (see ``firmware_sim.faults.fault_text``).
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

import msgspec

from firmware_sim.arm.events import AnyEvent
from firmware_sim.boards.codec import (
    ADC_NODE,
    DAC_NODE,
    EMERGENCY_ID,
    GATEWAY_NODE,
    HEARTBEAT_ID,
    NMT_ID,
    RPDO1_ID,
    SYNC_ID,
    TPDO1_ID,
    TPDO2_ID,
)
from hil.core.documents import Document

FRAME_IDS: Final = {
    "sample": TPDO1_ID + ADC_NODE,
    "command": RPDO1_ID + DAC_NODE,
    "inputs": TPDO2_ID + ADC_NODE,
    "read-back": TPDO1_ID + DAC_NODE,
    "sync": SYNC_ID,
    "nmt": NMT_ID,
    "adc-heartbeat": HEARTBEAT_ID + ADC_NODE,
    "dac-heartbeat": HEARTBEAT_ID + DAC_NODE,
    "gateway-heartbeat": HEARTBEAT_ID + GATEWAY_NODE,
    "adc-emergency": EMERGENCY_ID + ADC_NODE,
    "dac-emergency": EMERGENCY_ID + DAC_NODE,
}
"""CAN identifier of each frame that a fault can name.

``inputs`` are the digital inputs of the ADC board, ``read-back`` the voltages that the DAC board reports.
"""

FrameName = Literal[
    "sample",
    "command",
    "inputs",
    "read-back",
    "sync",
    "nmt",
    "adc-heartbeat",
    "dac-heartbeat",
    "gateway-heartbeat",
    "adc-emergency",
    "dac-emergency",
]
PdoName = Literal["sample", "command"]
BoardName = Literal["adc", "dac"]
ProcessName = Literal["gateway", "recorder"]
SenderName = Literal["any", "gateway", "adc", "dac", "foreign"]
AxisName = Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
Share = Annotated[str, msgspec.Meta(pattern=r"^\d+(\.\d+)?%$")]
Amount = Annotated[int, msgspec.Meta(ge=1, le=10**9)] | Share
"""A number of frames (``5``: the next five), or a share (``"10%"``: each one with this probability)."""
Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]
Interval = Annotated[float, msgspec.Meta(ge=1e-4, le=1e3)]
"""Time in seconds between two frames of a node that sends without being asked."""
ALL: Final = "100%"


class Fault(Document, frozen=True, kw_only=True, tag_field="fault"):
    """Base of every fault. In a file, the key ``fault`` says what kind of fault it is."""

    at_s: Seconds = 0.0
    """Time from the moment at which the condition is met until the fault begins, in seconds."""
    when: str = ""
    """Condition that must be met once.

    - Empty: the boards' first sample.
    - ``running``: the first valve command that is not the centre, of the controllers or of a jog.
    - ``offline``, ``ready``, ``armed``, ``fault``: the gateway enters this state, or is in it. No frame on
      the bus shows these states. So the gateway must run in simulated time, or must have started the boards.
    - ``AXIS>POSITION``, ``AXIS<POSITION``: a position that the board has sampled.
    """
    for_s: Annotated[float, msgspec.Meta(gt=0.0, le=1e6)] | None = None
    """Duration in seconds. None: until the run ends, or until ``amount`` frames are affected."""


class FrameFault(Fault, frozen=True):
    """Base of the faults that affect frames with one identifier on their way."""

    frame: FrameName


class Lose(FrameFault, frozen=True, tag="lose"):
    """Frames do not arrive."""

    amount: Amount = ALL


class Late(FrameFault, frozen=True, tag="late"):
    """Frames arrive ``delay_s`` later. Frames with other identifiers overtake them."""

    delay_s: Annotated[float, msgspec.Meta(gt=0.0, le=1e3)]
    amount: Amount = ALL


class Repeat(FrameFault, frozen=True, tag="repeat"):
    """Frames arrive twice in a row."""

    amount: Amount = ALL


class Reorder(FrameFault, frozen=True, tag="reorder"):
    """A frame arrives after the next frame with the same identifier."""

    amount: Amount = ALL


class Corrupt(FrameFault, frozen=True, tag="corrupt"):
    """One bit of a frame is inverted, chosen at random. The frame's CRC-8 is not changed with it."""

    amount: Amount = ALL


class Alter(FrameFault, frozen=True, tag="alter"):
    """One bit of an analogue value is inverted, chosen at random, and the frame's CRC-8 fits again."""

    frame: PdoName
    amount: Amount = ALL


class Miscount(FrameFault, frozen=True, tag="miscount"):
    """The rolling counter of frames differs by ``step``, and the CRC-8 fits. -1 repeats a counter."""

    frame: PdoName
    step: Annotated[int, msgspec.Meta(ge=-128, le=127)]
    amount: Amount = ALL


class Mislabel(FrameFault, frozen=True, tag="mislabel"):
    """A copy of frames is on the bus under the identifier of another frame, ``label``, with the same data."""

    label: FrameName
    amount: Amount = ALL


class Foreign(FrameFault, frozen=True, tag="foreign"):
    """A node that is no part of the rig sends this frame every ``interval_s`` seconds.

    It is a copy of the last one on the bus when the fault begins. An analogue PDO has its own counter and a
    correct CRC.
    """

    interval_s: Interval


class Flood(Fault, frozen=True, tag="flood"):
    """A node sends 8 zero bytes under ``identifier`` every ``interval_s`` seconds.

    With a bus model (rig: ``bus.bit_rate``), frames of lower priority wait. Without one, no frame is delayed.
    """

    identifier: Annotated[int, msgspec.Meta(ge=0, le=0x7FF)]
    interval_s: Interval


class BusOff(Fault, frozen=True, tag="bus off"):
    """The gateway's controller reports bus-off by an error frame. No frame passes while the fault lasts.

    With a bus model (rig: ``bus.bit_rate``), the controller refuses the gateway's frames. When the fault
    ends, it is restarted, and is back after 128 sequences of 11 recessive bits.
    """


class Unplug(Fault, frozen=True, tag="unplug"):
    """The cable between gateway and boards is unplugged. No frame passes while the fault lasts.

    With a bus model (rig: ``bus.bit_rate``), the gateway's frames wait in its queue, and pass afterwards.
    """


class ErrorFrames(Fault, frozen=True, tag="error frames"):
    """Frames on the bus are destroyed at a bit chosen at random, and sent again. Error counters rise.

    The share counts for each attempt to send a frame. For simulated time with a bus model only
    (rig: ``bus.bit_rate``).
    """

    amount: Amount = ALL
    sender: SenderName = "any"
    """Node whose frames are destroyed."""


class Reset(Fault, frozen=True, tag="reset"):
    """A board restarts, as after a brown-out. A hang of this board ends."""

    board: BoardName


class Hang(Fault, frozen=True, tag="hang"):
    """A board's processor stops: it takes no frame, sends no frame, and keeps its outputs.

    A reset of the board ends it.
    """

    board: BoardName


class Babble(Fault, frozen=True, tag="babble"):
    """A board repeats its last frame every ``interval_s`` seconds: its sample, or else its heartbeat."""

    board: BoardName
    interval_s: Interval


class Twin(Fault, frozen=True, tag="twin"):
    """A second board with the same node id is on the bus, operational, and answers as the first one does."""

    board: BoardName


class FreezeSensor(Fault, frozen=True, tag="freeze sensor"):
    """The potentiometer keeps its present voltage."""

    axis: AxisName


class DriftSensor(Fault, frozen=True, tag="drift sensor"):
    """The potentiometer's voltage moves away from the true one at ``v_per_s``."""

    axis: AxisName
    v_per_s: Annotated[float, msgspec.Meta(ge=-100.0, le=100.0)]


class NoisySensor(Fault, frozen=True, tag="noisy sensor"):
    """White noise with the standard deviation ``rms_v`` is added to the potentiometer's voltage."""

    axis: AxisName
    rms_v: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)]


class OffsetSensor(Fault, frozen=True, tag="offset sensor"):
    """The potentiometer's voltage jumps by ``offset_v``."""

    axis: AxisName
    offset_v: Annotated[float, msgspec.Meta(ge=-10.0, le=10.0)]


class StickValve(Fault, frozen=True, tag="stick valve"):
    """The voltage at the valve stays at its present value, whatever the board commands."""

    axis: AxisName


class SlowValve(Fault, frozen=True, tag="slow valve"):
    """The voltage at the valve follows the board as a first-order lag with the time constant ``lag_s``."""

    axis: AxisName
    lag_s: Annotated[float, msgspec.Meta(gt=0.0, le=100.0)]


class ArmFault(Fault, frozen=True, tag="arm"):
    """An event happens to the pneumatic arm. The event's own ``at_s`` is not used.

    In a text, the event's name stands in place of the fault's: ``leak:vertical,1,1e-8@running+1``.
    """

    event: AnyEvent


class Stall(Fault, frozen=True, tag="stall"):
    """The gateway's process does not run for ``stall_s`` seconds. For simulated time only."""

    stall_s: Annotated[float, msgspec.Meta(gt=0.0, le=1e3)]


class StepClock(Fault, frozen=True, tag="step clock"):
    """The host's wall clock is set forward by ``step_s`` seconds. For simulated time only."""

    step_s: Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]


class Kill(Fault, frozen=True, tag="kill"):
    """A process of the gateway is killed (SIGKILL). For rigs of real processes only."""

    process: ProcessName


class Pause(Fault, frozen=True, tag="pause"):
    """A process of the gateway does not run (SIGSTOP) for the duration. For rigs of real processes only."""

    process: ProcessName


class FillDisk(Fault, frozen=True, tag="fill disk"):
    """The recorder can write no further byte. For rigs of real processes only."""


FrameChange = Lose | Late | Repeat | Reorder | Corrupt | Alter | Miscount | Mislabel
"""A fault that changes frames on their way."""
SensorFault = FreezeSensor | DriftSensor | NoisySensor | OffsetSensor
ValveFault = StickValve | SlowValve
HostFault = Stall | StepClock
ProcessFault = Kill | Pause | FillDisk
"""A fault of the gateway's processes, of which simulated time has none."""
AnyFault = (
    Lose
    | Late
    | Repeat
    | Reorder
    | Corrupt
    | Alter
    | Miscount
    | Mislabel
    | Foreign
    | Flood
    | BusOff
    | Unplug
    | ErrorFrames
    | Reset
    | Hang
    | Babble
    | Twin
    | FreezeSensor
    | DriftSensor
    | NoisySensor
    | OffsetSensor
    | StickValve
    | SlowValve
    | ArmFault
    | Stall
    | StepClock
    | Kill
    | Pause
    | FillDisk
)
"""A fault of any kind."""
