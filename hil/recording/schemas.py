"""What a recording holds: topics, ROS 2 message definitions, and the byte layout that follows from them.

Every channel is CDR (``ros2msg`` schemas), so that Foxglove, PlotJuggler and ROS 2 readers open the file.
All but text messages are of fixed size: their one string, ``frame_id``, is constant within a channel. The
layout is computed from the definition, so writer and reader cannot disagree. CDR: OMG DDS-XTypes 7.4.3.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from hil.core.life_cycle import LifeCycleState

CDR_HEADER = b"\x00\x01\x00\x00"
"""Encapsulation: plain CDR, little endian. Alignment counts from its end."""

_STATES = "\n".join(f"uint8 {state.name}={state.value}" for state in LifeCycleState)
_SEPARATOR = "=" * 80
_TIME = f"""{_SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_HEADER = f"""{_SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_TIME}"""


class MessageType(NamedTuple):
    """A ROS 2 message type and its definition with all dependencies."""

    name: str
    definition: str


FRAME = MessageType(
    "can_msgs/msg/Frame",
    f"""std_msgs/Header header
uint32 id
bool is_rtr
bool is_extended
bool is_error
uint8 dlc
uint8[8] data
{_HEADER}""",
)

AXIS_SIGNALS = MessageType(
    "hil_msgs/msg/AxisSignals",
    f"""# One axis in one period. Positions in the channel's unit (metadata), voltages in volts.
std_msgs/Header header  # stamp: the sampling instant, when SYNC left
float64 setpoint
float64 position
float64 error
float64 output_v  # the control law's output before the limits, offset from the valve's centre
float64 command_v  # the valve voltage that left, before quantisation
float64 potentiometer_v
{_STATES}
uint8 state
bool fresh  # false: no good sample in this period, the last signals are held
{_HEADER}""",
)

CYCLE = MessageType(
    "hil_msgs/msg/Cycle",
    f"""# One period of the loop. Instants in ns of the monotonic clock.
int64 number
int64 deadline  # when SYNC was due
int64 wake  # when the core was called for it; SYNC left right after
int64 receive  # when the core was given the sample; 0: none came
int64 computed  # when the core had answered
int64 sent  # when the command had been handed to the link
{_STATES}
uint8 state
bool fresh  # false: no good sample in this period; computed and sent are then of the call that closed it
""",
)

DEADLINE = MessageType(
    "hil_msgs/msg/Deadline",
    """# One call of the core because its deadline had passed. ns of the monotonic clock.
int64 deadline
int64 now
""",
)

OPERATOR = MessageType("std_msgs/msg/String", "string data\n")

LOG = MessageType(
    "rcl_interfaces/msg/Log",
    f"""byte DEBUG=10
byte INFO=20
byte WARN=30
byte ERROR=40
byte FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
{_TIME}""",
)

RECEIVED, SENT, DEADLINES, CYCLES, OPERATED, EVENTS, FIRST_AXIS = range(1, 8)
"""Channel ids. Axes follow from FIRST_AXIS on, in the rig file's order."""

AXIS_TOPIC = "/axis/"


class Channel(NamedTuple):
    """A channel of the file; its id is its place in :func:`channels`, counted from 1."""

    topic: str
    type: MessageType
    metadata: dict[str, str]


def channels(axes: Sequence[tuple[str, str]], stamp_origin: str) -> tuple[Channel, ...]:
    """All channels of a recording. ``axes``: (name, unit) in the rig file's order."""
    return (
        Channel("/can/rx", FRAME, {"stamp_origin": stamp_origin}),
        Channel("/can/tx", FRAME, {"stamp_origin": "time of sending"}),
        Channel("/gateway/deadline", DEADLINE, {}),
        Channel("/gateway/cycle", CYCLE, {}),
        Channel("/gateway/operator", OPERATOR, {}),
        Channel("/gateway/log", LOG, {}),
        *(Channel(AXIS_TOPIC + name, AXIS_SIGNALS, {"unit": unit}) for name, unit in axes),
    )


class Field(NamedTuple):
    """A value in a payload: dotted name, struct code, and offset from the payload's first byte."""

    name: str
    code: str
    offset: int


class Layout(NamedTuple):
    """Where the fields of a fixed-size payload are. ``size`` counts the encapsulation header too."""

    fields: tuple[Field, ...]
    size: int

    @property
    def format(self) -> str:
        """For struct, little endian: the encapsulation header (4s), then the fields and their padding."""
        parts, end = ["4s"], len(CDR_HEADER)
        for field in self.fields:
            parts.append(f"{field.offset - end}x{field.code}")
            end = field.offset + struct.calcsize("<" + field.code)
        return "".join(parts)


def cdr_string(text: str) -> bytes:
    """A string in CDR: length with the terminating zero, bytes, zero."""
    encoded = text.encode("utf-8", "replace") + b"\0"
    return struct.pack("<I", len(encoded)) + encoded


def layout_of(definition: str, frame_id: str) -> Layout:
    """The layout of a ``ros2msg`` definition whose only string, if any, is always ``frame_id``.

    Raises ValueError for a definition that is not of fixed size (sequences).
    """
    types = _types_in(definition)
    fields: list[Field] = []
    end = len(CDR_HEADER)
    for name, kind in _flattened(types, "", ""):
        code, alignment = _code_of(kind, frame_id)
        offset = end + (len(CDR_HEADER) - end) % alignment
        fields.append(Field(name, code, offset))
        end = offset + struct.calcsize("<" + code)
    return Layout(tuple(fields), end)


_CODES = {
    "bool": "?", "byte": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float32": "f", "float64": "d",
}  # fmt: skip


def _code_of(kind: str, frame_id: str) -> tuple[str, int]:
    if kind == "string":
        return f"{len(cdr_string(frame_id))}s", 4
    if array := re.fullmatch(r"(?:uint8|byte)\[(\d+)\]", kind):
        return f"{array[1]}s", 1
    if kind in _CODES:
        return _CODES[kind], struct.calcsize("<" + _CODES[kind])
    raise ValueError(f"a field of type {kind} has no fixed size")


def _types_in(definition: str) -> dict[str, list[tuple[str, str]]]:
    """Each type's fields as (name, type); the outermost type is ''."""
    types: dict[str, list[tuple[str, str]]] = {}
    for section in re.split(r"^={80}\n", definition, flags=re.MULTILINE):
        lines = [line.split("#")[0].split() for line in section.splitlines()]
        lines = [line for line in lines if line]
        name = lines.pop(0)[1] if lines and lines[0][0] == "MSG:" else ""
        types[name] = [(line[1], line[0]) for line in lines if "=" not in "".join(line[1:])]
    return types


def _flattened(types: dict[str, list[tuple[str, str]]], name: str, prefix: str) -> Iterator[tuple[str, str]]:
    for field, kind in types[name]:
        if kind in types:
            yield from _flattened(types, kind, f"{prefix}{field}.")
        else:
            yield prefix + field, kind
