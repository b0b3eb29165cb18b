"""Reads a recording: the core's calls for replay, signals and timing as numpy arrays, events, configuration.

All ``_ns`` are monotonic, as the loop saw them, unless said otherwise.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.errors import RecordingError
from hil.core.frames import Frame
from hil.core.output import AxisSignals, LogEntry, Severity
from hil.recording.handover import MESSAGE_HEADER, RECORD_HEADER, SEQUENCE_MASK
from hil.recording.mcap_reader import MESSAGE_FIELDS, McapContents, Rows
from hil.recording.schemas import AXIS_TOPIC, CDR_HEADER, layout_of

_SECOND_NS = 1_000_000_000


class FrameReceived(NamedTuple):
    """The core was given ``frame``, which the link had stamped ``stamp_ns`` (epoch)."""

    now_ns: int
    frame: Frame
    stamp_ns: int


class FrameSent(NamedTuple):
    """The core had answered with ``frame``, which left at ``now_ns``."""

    now_ns: int
    frame: Frame


class DeadlineCalled(NamedTuple):
    """The core's ``on_deadline`` was called."""

    now_ns: int
    deadline_ns: int


class Operated(NamedTuple):
    """The core was given an operator's command, or told of a failure (``recorder.LINK_FAILED``).

    Or, as an answer, a frame that the bus did not take (``recorder.NOT_SENT``).
    """

    now_ns: int
    command: str


Call = FrameReceived | FrameSent | DeadlineCalled | Operated


class EventTold(NamedTuple):
    """The core, or the shell, reported ``event``."""

    now_ns: int
    event: LogEntry


class AxisRecorded(NamedTuple):
    """An axis in the period that ended; ``wake_ns`` is the sampling instant, when SYNC left."""

    now_ns: int
    axis: str
    wake_ns: int
    signals: AxisSignals
    state: int
    fresh: bool


class CycleRecorded(NamedTuple):
    """A period that ended: instants as in :meth:`Recording.timing`."""

    now_ns: int
    number: int
    deadline_ns: int
    wake_ns: int
    receive_ns: int
    computed_ns: int
    sent_ns: int
    state: int
    fresh: bool


Entry = Call | EventTold | AxisRecorded | CycleRecorded


class Recording:
    """One run. Raises RecordingError when ``path`` is no recording, or is damaged other than at its end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._contents = contents = McapContents(path)
        self.attachments = contents.attachments
        self.metadata = contents.metadata
        self.complete = contents.is_complete
        """Whether the file was ended properly; if not, it holds everything up to the last whole chunk."""
        own = self.metadata.get("recording", {})
        for key in ("epoch_offset_ns", "bus"):
            if key not in own:
                raise RecordingError(
                    f"{path}: not the recording of a run: metadata recording.{key} is missing"
                )
        try:
            self.epoch_offset_ns = int(own["epoch_offset_ns"])
            """Epoch time minus monotonic time."""
        except ValueError:
            raise RecordingError(f"{path}: metadata recording.epoch_offset_ns is no number") from None
        self.bus = own["bus"]

    @property
    def axes(self) -> dict[str, str]:
        """Axis names and units, in the rig file's order."""
        return {
            topic.removeprefix(AXIS_TOPIC): channel.metadata.get("unit", "")
            for topic, channel in self._contents.channels.items()
            if topic.startswith(AXIS_TOPIC)
        }

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic."""
        return self._contents.counts

    @property
    def state_names(self) -> dict[int, str]:
        """Names of the life cycle's states, as they were when this was recorded."""
        definition = self._contents.definition("/gateway/cycle")
        constants = re.findall(r"^uint8 (\w+)=(\d+)$", definition, flags=re.MULTILINE)
        return {int(value): name.lower() for name, value in constants}

    def axis(self, name: str) -> Rows:
        """The periods of an axis.

        Columns: ``time_ns`` (SYNC, the sampling instant); ``setpoint``, ``position``, ``error`` in the axis'
        unit; ``output_v``, ``command_v``, ``potentiometer_v``; ``state``, ``fresh``.
        """
        rows = self._contents.rows(AXIS_TOPIC + name, "")
        time_ns = rows["header.stamp.sec"].astype(np.int64) * _SECOND_NS + rows["header.stamp.nanosec"]
        own = [
            column for column in rows.dtype.names or () if "." not in column and column not in MESSAGE_FIELDS
        ]
        return _table({"time_ns": time_ns - self.epoch_offset_ns} | {column: rows[column] for column in own})

    def timing(self) -> Rows:
        """The periods of the loop.

        Columns: ``number``, ``deadline_ns``, ``wake_ns``, ``receive_ns`` (0: no sample came),
        ``computed_ns``, ``sent_ns``, ``state``, ``fresh``.
        """
        rows = self._contents.rows("/gateway/cycle", "")
        instants = ("deadline", "wake", "receive", "computed", "sent")
        return _table(
            {"number": rows["number"]}
            | {f"{instant}_ns": rows[instant] for instant in instants}
            | {"state": rows["state"], "fresh": rows["fresh"]}
        )

    def times_sent(self, identifier: int) -> npt.NDArray[np.int64]:
        """When data frames of an 11-bit identifier had been handed to the link."""
        return self._times("/can/tx", identifier)

    def times_received(self, identifier: int) -> npt.NDArray[np.int64]:
        """When the core was given data frames of an 11-bit identifier."""
        return self._times("/can/rx", identifier)

    def _times(self, topic: str, identifier: int) -> npt.NDArray[np.int64]:
        rows = self._contents.rows(topic, self.bus)
        chosen = (rows["id"] == identifier) & ~rows["is_extended"] & ~rows["is_rtr"]
        times_ns: npt.NDArray[np.int64] = rows["log_time"][chosen].astype(np.int64)
        return times_ns - self.epoch_offset_ns

    def log(self) -> list[tuple[int, LogEntry]]:
        """What was reported, with its time in ns."""
        channel = self._contents.channel("/gateway/log").id
        return [(message.now_ns, _event(message.payload)) for message in self._messages({channel})]

    def calls(self) -> Iterator[Call]:
        """The core's calls and answers in their order. Raises what :meth:`entries` raises."""
        return (entry for entry in self.entries() if isinstance(entry, Call))

    def entries(self) -> Iterator[Entry]:
        """All that was recorded, in its order.

        Raises RecordingError where messages are missing: what was dropped while recording cannot be replayed.
        """
        channels = self._contents.channels
        readers = {channel.id: self._reader(topic) for topic, channel in channels.items()}
        expected = 1
        for message in self._messages(None):
            if message.sequence != expected:
                missing = (message.sequence - expected) & SEQUENCE_MASK
                raise RecordingError(
                    f"{self.path}: {missing} messages before {message.now_ns} ns were dropped while "
                    "recording; from there on the calls of the core are not known"
                )
            expected = (message.sequence + 1) & SEQUENCE_MASK
            read = readers.get(message.channel)
            if read is None:
                continue
            try:
                entry = read(message)
            except (ValueError, struct.error) as error:
                raise RecordingError(
                    f"{self.path}: message {message.sequence} cannot be read: {error}"
                ) from None
            yield entry
        dropped = self.messages_dropped
        if dropped:
            raise RecordingError(
                f"{self.path}: {dropped} messages after the last one were dropped while recording"
            )

    @property
    def messages_dropped(self) -> int:
        """Messages that were not recorded, because the recorder process fell behind or ended."""
        counts = self.metadata.get("recorder", {})
        return sum(int(count) for key, count in counts.items() if key.startswith("dropped "))

    def _reader(self, topic: str) -> Callable[[_Message], Entry] | None:
        """What makes an entry of a message of ``topic``; None for topics that are not the gateway's."""
        match topic:
            case "/can/rx":
                frame = self._struct(topic, self.bus).unpack
                return lambda m: FrameReceived(m.now_ns, _frame(frame(m.payload)), m.stamp_ns)
            case "/can/tx":
                frame = self._struct(topic, self.bus).unpack
                return lambda m: FrameSent(m.now_ns, _frame(frame(m.payload)))
            case "/gateway/deadline":
                deadline = self._struct(topic, "").unpack
                return lambda m: DeadlineCalled(*deadline(m.payload)[:0:-1])
            case "/gateway/operator":
                return lambda m: Operated(m.now_ns, _string(m.payload, len(CDR_HEADER))[0])
            case "/gateway/log":
                return lambda m: EventTold(m.now_ns, _event(m.payload))
            case "/gateway/cycle":
                cycle = self._struct(topic, "").unpack
                return lambda m: CycleRecorded(m.now_ns, *cycle(m.payload)[1:])
        return self._axis_reader(topic.removeprefix(AXIS_TOPIC)) if topic.startswith(AXIS_TOPIC) else None

    def _axis_reader(self, name: str) -> Callable[[_Message], AxisRecorded]:
        axis = self._struct(AXIS_TOPIC + name, "")

        def read(message: _Message) -> AxisRecorded:
            _, seconds, nanoseconds, _, *signals, state, fresh = axis.unpack(message.payload)
            wake_ns = seconds * _SECOND_NS + nanoseconds - self.epoch_offset_ns
            return AxisRecorded(message.now_ns, name, wake_ns, AxisSignals(*signals), state, fresh)

        return read

    def _messages(self, channels: set[int] | None) -> Iterator[_Message]:
        """Messages of ``channels`` (None: of all) in the order recorded."""
        for body, offsets in self._contents.chunks():
            chosen = offsets.keys() if channels is None else channels & offsets.keys()
            places = sorted((offset, channel) for channel in chosen for offset in offsets[channel].tolist())
            for offset, channel in places:
                prefix, sequence, log_time, stamp_ns = MESSAGE_HEADER.unpack_from(body, offset)
                end = offset + RECORD_HEADER.size + RECORD_HEADER.unpack(prefix[: RECORD_HEADER.size])[1]
                payload = body[offset + MESSAGE_HEADER.size : end]
                yield _Message(channel, sequence, log_time - self.epoch_offset_ns, stamp_ns, payload)

    def _struct(self, topic: str, frame_id: str) -> struct.Struct:
        return struct.Struct("<" + layout_of(self._contents.definition(topic), frame_id).format)


class _Message(NamedTuple):
    channel: int
    sequence: int
    now_ns: int
    stamp_ns: int
    """Publish time, epoch."""
    payload: bytes


def _frame(values: tuple[Any, ...]) -> Frame:
    *_, identifier, is_remote, is_extended, is_error, length, data = values
    return Frame(identifier, data[:length], is_extended, is_remote, is_error)


def _event(payload: bytes) -> LogEntry:
    """From a ``rcl_interfaces/msg/Log``: stamp, level, then name and text, each aligned to 4 bytes."""
    source, end = _string(payload, 16)
    text, _ = _string(payload, end + -end % 4)
    return LogEntry(Severity(payload[12]), source, text)


def _string(payload: bytes, start: int) -> tuple[str, int]:
    """The CDR string at ``start``, and where it ends."""
    end = start + 4 + int.from_bytes(payload[start : start + 4], "little")
    return payload[start + 4 : end - 1].decode(), end


def _table(columns: Mapping[str, npt.NDArray[Any]]) -> Rows:
    kinds = [(name, column.dtype) for name, column in columns.items()]
    table = np.empty(len(next(iter(columns.values()))), kinds)
    for name, column in columns.items():
        table[name] = column
    return table
