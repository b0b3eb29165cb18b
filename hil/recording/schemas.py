"""Topics and ROS 2 message definitions of a recording, and the byte layout that follows from them.

Every channel is CDR (``ros2msg`` schemas), so that Foxglove, PlotJuggler and ROS 2 tools open the file.
Messages have a fixed size, except those of ``/gateway/operator``, ``/gateway/link_failure`` and
``/gateway/log``: their one string, ``frame_id``, is constant within a channel. Writer and reader compute the
layout from the same definition. CDR: OMG DDS-XTypes 1.3, section 7.4.3.
"""

from __future__ import annotations

import itertools
import re
import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from hil.core.life_cycle import LifeCycleState
from hil.core.phase import Phase

FORMAT_VERSION = 2
"""Version of topics, definitions and metadata, in the metadata entry ``recording.format_version``.

1 (pneumatic-hil 0.1): without ``format_version``; link failures and frames that were not sent were texts in
``/gateway/operator``, and the log was ``/gateway/events``. The reader refuses every version but its own by
name.
"""

MAX_FIELDS = 1000
"""Largest number of fields of a message, inner ones included. A damaged definition may have any number."""

CDR_HEADER = b"\x00\x01\x00\x00"
"""Encapsulation header: plain CDR, little endian. The alignment of fields counts from its end."""

_STATES = "\n".join(f"uint8 {state.name}={state.value}" for state in LifeCycleState)
_PHASES = "\n".join(f"uint8 PHASE_{phase.name}={phase.value}" for phase in Phase)
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
    f"""# The signals of one axis in one period of the loop.
# The channel's metadata has the unit (m or rad) of setpoint, position and error. Voltages are in V.
std_msgs/Header header  # stamp: sampling instant, when the gateway sent SYNC
float64 setpoint
float64 position
float64 error  # setpoint - position
float64 output_v  # output of the control law before the limits, relative to the valve's centre voltage
float64 command_v  # valve voltage after the limits, before quantisation
float64 potentiometer_v
{_PHASES}
uint8 phase  # phase of the experiment on this axis
{_STATES}
uint8 state  # state of the life cycle after the period
bool fresh  # false: no good sample in this period; the signals are those of the last good sample
{_HEADER}""",
)

CYCLE = MessageType(
    "hil_msgs/msg/Cycle",
    f"""# One period of the loop. Instants are in ns on the gateway's monotonic clock.
int64 number
int64 deadline_ns  # when SYNC was due
int64 wake_ns  # when the core was called; SYNC leaves right after
int64 receive_ns  # when the core was given the good sample; 0: the period had none
int64 computed_ns  # when the core had answered
int64 sent_ns  # when the link had taken the last frame of the answer
{_STATES}
uint8 state  # state of the life cycle after the period
bool fresh  # false: no good sample in this period; computed_ns and sent_ns are then of the next deadline
""",
)

DEADLINE = MessageType(
    "hil_msgs/msg/Deadline",
    """# A call of the core at its deadline. Instants are in ns on the gateway's monotonic clock.
int64 deadline_ns
int64 now_ns
""",
)

TEXT = MessageType("std_msgs/msg/String", "string data\n")

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

RECEIVED, SENT, REFUSED, DEADLINES, CYCLES, OPERATOR, LINK_FAILURES, LOG_ENTRIES, FIRST_AXIS = range(1, 10)
"""Channel ids. The axes have the ids from FIRST_AXIS on, in the rig file's order."""

RECEIVED_TOPIC, SENT_TOPIC, REFUSED_TOPIC = "/can/rx", "/can/tx", "/can/refused"
DEADLINE_TOPIC, CYCLE_TOPIC = "/gateway/deadline", "/gateway/cycle"
OPERATOR_TOPIC, LINK_FAILURE_TOPIC = "/gateway/operator", "/gateway/link_failure"
LOG_TOPIC = "/gateway/log"
AXIS_TOPIC = "/axis/"
"""Prefix of an axis' topic; the axis' name follows."""


class Channel(NamedTuple):
    """A channel of the file. Its id is its position in :func:`channels`, counted from 1."""

    topic: str
    type: MessageType
    metadata: dict[str, str]


def channels(axes: Sequence[tuple[str, str]], stamp_origin: str) -> tuple[Channel, ...]:
    """Return all channels of a recording. ``axes``: (name, unit) in the rig file's order."""
    return (
        Channel(RECEIVED_TOPIC, FRAME, {"stamp_origin": stamp_origin}),
        Channel(SENT_TOPIC, FRAME, {"stamp_origin": "time of sending"}),
        Channel(REFUSED_TOPIC, FRAME, {"stamp_origin": "time of the attempt to send"}),
        Channel(DEADLINE_TOPIC, DEADLINE, {}),
        Channel(CYCLE_TOPIC, CYCLE, {}),
        Channel(OPERATOR_TOPIC, TEXT, {}),
        Channel(LINK_FAILURE_TOPIC, TEXT, {}),
        Channel(LOG_TOPIC, LOG, {}),
        *(Channel(AXIS_TOPIC + name, AXIS_SIGNALS, {"unit": unit}) for name, unit in axes),
    )


class Field(NamedTuple):
    """A field of a payload: dotted name, struct code, and offset from the payload's first byte."""

    name: str
    code: str
    offset: int


class Layout(NamedTuple):
    """Places of the fields in a payload of fixed size. ``size`` includes the encapsulation header."""

    fields: tuple[Field, ...]
    size: int

    @property
    def format(self) -> str:
        """Format for struct: the encapsulation header (4s), then the fields and their padding.

        The byte order is little endian; the caller puts ``<`` in front.
        """
        parts, end = ["4s"], len(CDR_HEADER)
        for field in self.fields:
            parts.append(f"{field.offset - end}x{field.code}")
            end = field.offset + struct.calcsize("<" + field.code)
        return "".join(parts)


def cdr_string(text: str) -> bytes:
    """Encode a string in CDR: length including the terminating zero, UTF-8 bytes, zero."""
    encoded = text.encode("utf-8", "replace") + b"\0"
    return struct.pack("<I", len(encoded)) + encoded


def layout_of(definition: str, frame_id: str) -> Layout:
    """Compute the layout of a ``ros2msg`` definition whose only string, if any, is always ``frame_id``.

    Raises ValueError for a definition without a fixed size (one with a sequence).
    """
    types = _types_in(definition)
    fields: list[Field] = []
    end = len(CDR_HEADER)
    for name, kind in _flattened(types, "", "", itertools.count(1)):
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
    """Parse a definition into the fields, (name, type), of each type in it; the outermost type is ''."""
    types: dict[str, list[tuple[str, str]]] = {}
    for section in re.split(r"^={80}\n", definition, flags=re.MULTILINE):
        lines = [line.split("#")[0].split() for line in section.splitlines()]
        lines = [line for line in lines if line]
        name = lines.pop(0)[1] if lines and lines[0][0] == "MSG:" else ""
        types[name] = [(line[1], line[0]) for line in lines if "=" not in "".join(line[1:])]
    return types


def _flattened(
    types: dict[str, list[tuple[str, str]]], name: str, prefix: str, number: Iterator[int]
) -> Iterator[tuple[str, str]]:
    """Yield name and type of each field, those of inner types included; ``number`` counts them."""
    for field, kind in types[name]:
        if next(number) > MAX_FIELDS:
            raise ValueError(f"more than {MAX_FIELDS} fields")
        if kind in types:
            yield from _flattened(types, kind, f"{prefix}{field}.", number)
        else:
            yield prefix + field, kind
