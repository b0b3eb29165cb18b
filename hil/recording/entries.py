"""The entries of a recording, one for each message: calls of the core, the core's answers, and log entries.

Replay repeats the calls and compares the answers. ``now_ns`` and all other ``_ns`` are on the gateway's
monotonic clock, unless stated otherwise.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, NamedTuple

from hil.core.frames import Frame
from hil.core.output import AxisSignals, LogEntry, Severity
from hil.core.requests import Request
from hil.recording import schemas
from hil.recording.request_texts import read_request
from hil.recording.schemas import AXIS_TOPIC, CDR_HEADER, layout_of

_SECOND_NS = 1_000_000_000


class FrameReceived(NamedTuple):
    """Call: the core was given ``frame``, which the link had stamped ``stamp_ns`` (epoch)."""

    now_ns: int
    frame: Frame
    stamp_ns: int


class DeadlineCalled(NamedTuple):
    """Call: the core's ``on_deadline`` was called for ``deadline_ns``."""

    now_ns: int
    deadline_ns: int


class Operated(NamedTuple):
    """Call: the core was given an operator's request."""

    now_ns: int
    request: Request
    asked_by: str = ""
    """Who asked, as the shell knew it; empty for a trigger of the run's own plan."""


class LinkFailed(NamedTuple):
    """Call: the core was given the failure of the link, or of the program."""

    now_ns: int
    reason: str


class FrameSent(NamedTuple):
    """Answer: the core returned ``frame``, and the link took it at ``now_ns``."""

    now_ns: int
    frame: Frame


class FrameRefused(NamedTuple):
    """Answer: the core returned ``frame``, and the link did not send it.

    If it is a valve command, this is also a call: the core was given ``command_refused``.
    """

    now_ns: int
    frame: Frame


class Logged(NamedTuple):
    """A log entry: an answer of the core, or of the shell between two calls."""

    now_ns: int
    entry: LogEntry


class AxisRecorded(NamedTuple):
    """Answer: the signals of an axis in a period. ``wake_ns`` is the sampling instant, when SYNC left."""

    now_ns: int
    axis: str
    wake_ns: int
    signals: AxisSignals
    state: int
    fresh: bool


class CycleRecorded(NamedTuple):
    """Answer: a period, with the instants of :class:`hil.recording.tables.TimingTable`."""

    now_ns: int
    number: int
    deadline_ns: int
    wake_ns: int
    receive_ns: int
    computed_ns: int
    sent_ns: int
    state: int
    fresh: bool


Call = FrameReceived | DeadlineCalled | Operated | LinkFailed
Answer = FrameSent | FrameRefused | Logged | AxisRecorded | CycleRecorded
Entry = Call | Answer


class Message(NamedTuple):
    """A message of the file that has not been decoded yet."""

    channel: int
    sequence: int
    now_ns: int
    """Log time, converted to the gateway's monotonic clock."""
    stamp_ns: int
    """Publish time in epoch ns."""
    payload: bytes


Decoder = Callable[[Message], Entry]
"""Makes an entry of a message. Raises ValueError or struct.error if it cannot."""


def decoder_of(topic: str, definition: str, bus: str, epoch_offset_ns: int) -> Decoder | None:
    """Return the decoder of the messages of ``topic``, or None if the gateway does not write that topic.

    ``definition`` is the topic's ``ros2msg`` definition, ``bus`` the ``frame_id`` of all frames.
    """
    match topic:
        case schemas.RECEIVED_TOPIC:
            frame = _unpacker(definition, bus)
            return lambda m: FrameReceived(m.now_ns, _frame(frame(m.payload)), m.stamp_ns)
        case schemas.SENT_TOPIC:
            frame = _unpacker(definition, bus)
            return lambda m: FrameSent(m.now_ns, _frame(frame(m.payload)))
        case schemas.REFUSED_TOPIC:
            frame = _unpacker(definition, bus)
            return lambda m: FrameRefused(m.now_ns, _frame(frame(m.payload)))
        case schemas.DEADLINE_TOPIC:
            deadline = _unpacker(definition)
            return lambda m: DeadlineCalled(*deadline(m.payload)[:0:-1])
        case schemas.CYCLE_TOPIC:
            cycle = _unpacker(definition)
            return lambda m: CycleRecorded(m.now_ns, *cycle(m.payload)[1:])
        case schemas.OPERATOR_TOPIC:
            return lambda m: Operated(m.now_ns, *read_request(_text(m.payload)))
        case schemas.LINK_FAILURE_TOPIC:
            return lambda m: LinkFailed(m.now_ns, _text(m.payload))
        case schemas.LOG_TOPIC:
            return log_entry_of
    if topic.startswith(AXIS_TOPIC):
        return _axis_decoder(topic.removeprefix(AXIS_TOPIC), definition, epoch_offset_ns)
    return None


def log_entry_of(message: Message) -> Logged:
    """Decode a message of ``/gateway/log``: a ``rcl_interfaces/msg/Log``.

    Its payload is the stamp, the level, then name and text, each aligned to 4 bytes, then fields that are
    unused.
    """
    source, end = _string(message.payload, 16)
    text, _ = _string(message.payload, end + -end % 4)
    return Logged(message.now_ns, LogEntry(Severity(message.payload[12]), source, text))


def _axis_decoder(name: str, definition: str, epoch_offset_ns: int) -> Decoder:
    axis = _unpacker(definition)

    def decode(message: Message) -> AxisRecorded:
        values = axis(message.payload)
        wake_ns = values[1] * _SECOND_NS + values[2] - epoch_offset_ns
        signals = AxisSignals._make(values[4:-2])
        return AxisRecorded(message.now_ns, name, wake_ns, signals, values[-2], values[-1])

    return decode


def _unpacker(definition: str, frame_id: str = "") -> Callable[[bytes], tuple[Any, ...]]:
    """Return the function that unpacks a payload of fixed size; its first value is the CDR header."""
    return struct.Struct("<" + layout_of(definition, frame_id).format).unpack


def _frame(values: tuple[Any, ...]) -> Frame:
    identifier, is_remote, is_extended, is_error, length, data = values[-6:]
    return Frame(identifier, data[:length], is_extended, is_remote, is_error)


def _text(payload: bytes) -> str:
    """Decode a ``std_msgs/msg/String``."""
    return _string(payload, len(CDR_HEADER))[0]


def _string(payload: bytes, start: int) -> tuple[str, int]:
    """Decode the CDR string at ``start``; returns it and the offset of its end."""
    end = start + 4 + int.from_bytes(payload[start : start + 4], "little")
    return payload[start + 4 : end - 1].decode(), end
