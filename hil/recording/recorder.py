"""The loop's side of the recording: packs every message, and passes batches to the recorder process.

The shell reports each call of the core and each answer, in order; that order is MCAP's ``sequence``, and
replay repeats it. Compression, index and file are in ``recorder_process``; in real time nothing here waits.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec

from hil.core.errors import RecordingError
from hil.core.frames import Frame
from hil.core.output import Cycle, LogEntry
from hil.recording import schemas
from hil.recording.handover import (
    BATCH,
    BLOCK_HEADER,
    END,
    HEADER,
    MESSAGE_HEADER,
    SEQUENCE_MASK,
    RunHeader,
    message_prefix,
)
from hil.recording.pipe import RecorderPipe
from hil.recording.schemas import CDR_HEADER, Layout, MessageType, cdr_string, layout_of

__all__ = ["ARM_EVENTS", "LINK_FAILED", "NOT_SENT", "Recorder", "RecorderReport", "RunHeader"]

LINK_FAILED = "link failed: "
"""How a link's failure stands among the operator's commands: this, then the reason."""
NOT_SENT = "not sent: "
"""How a frame that the bus did not take stands there, in its place among the answers."""

ARM_EVENTS = "arm events"
"""Metadata: what was planned to happen to a simulated arm, and its seconds from the first sample on."""

BATCH_BYTES = 32 * 1024
BATCH_AGE_NS = 200_000_000

_SECOND_NS = 1_000_000_000
ROS_TIME_END_NS = 2**31 * _SECOND_NS
"""``builtin_interfaces/msg/Time`` counts seconds from 1970 to January 2038."""
_LONGEST_RUN_NS = 365 * 86400 * _SECOND_NS
_NO_FRAME_ID = cdr_string("")


class RecorderReport(NamedTuple):
    """How a recording ended."""

    messages: int
    """Messages handed to the recorder process."""
    dropped: dict[str, int]
    """Messages that were not, by topic."""
    path: Path
    failure: str | None
    """Why the file is not whole, in words; None when it is."""

    def missing(self, in_file: int) -> int:
        """Messages that were reported and are not among those in the file."""
        return self.messages + sum(self.dropped.values()) - in_file


class Recorder:
    """Records one run into ``path``. Build it before the loop takes real-time rights or a processor.

    The recorder process would inherit those; it starts beside the caller, who does not wait for it. With
    ``lossless`` the loop waits when that process falls behind, and the same calls give the same bytes.
    ``now_ns`` is monotonic throughout. Raises RecordingError when ``path`` exists or cannot be created, or
    when the clock is outside ROS time.
    """

    def __init__(self, path: Path, header: RunHeader, lossless: bool) -> None:
        if not 0 <= header.epoch_offset_ns < ROS_TIME_END_NS - _LONGEST_RUN_NS:
            raise RecordingError(
                f"{path}: the clock is {header.epoch_offset_ns // _SECOND_NS} s after 1970; a recording's "
                "time stamps end in January 2038: set the clock"
            )
        self._path = path
        self._pipe = RecorderPipe(path, lossless)
        self._batch = _empty_block()
        self._sequence = 0
        self._now_ns = self._handed_ns = 0
        self._epoch_offset_ns = header.epoch_offset_ns
        self._topics = [channel.topic for channel in schemas.channels(header.axes, header.stamp_origin)]
        self._bus = cdr_string(header.bus)
        frame, self._pack_frame = _packer(schemas.FRAME, header.bus)
        self._received = message_prefix(schemas.RECEIVED, frame.size)
        self._sent = message_prefix(schemas.SENT, frame.size)
        deadline, self._pack_deadline = _packer(schemas.DEADLINE)
        self._deadlines = message_prefix(schemas.DEADLINES, deadline.size)
        cycle, self._pack_cycle = _packer(schemas.CYCLE)
        self._cycles = message_prefix(schemas.CYCLES, cycle.size)
        axis, self._pack_axis = _packer(schemas.AXIS_SIGNALS)
        self._axes = [
            message_prefix(schemas.FIRST_AXIS + place, axis.size) for place in range(len(header.axes))
        ]
        self._pipe.send(_empty_block() + msgspec.msgpack.encode(header), HEADER)

    def frame_received(self, frame: Frame, now_ns: int, stamp_ns: int) -> None:
        """The core is about to receive ``frame`` at ``now_ns``; the link stamped it ``stamp_ns`` (epoch).

        A stamp outside ROS time cannot be recorded, and stands as 0.
        """
        identifier, data, is_extended, is_remote, is_error = frame
        if not 0 <= stamp_ns < ROS_TIME_END_NS:
            stamp_ns = 0
        seconds, nanoseconds = divmod(stamp_ns, _SECOND_NS)
        self._batch += self._pack_frame(
            self._received, (self._sequence + 1) & SEQUENCE_MASK, now_ns + self._epoch_offset_ns, stamp_ns,
            CDR_HEADER, seconds, nanoseconds, self._bus,
            identifier, is_remote, is_extended, is_error, len(data), data,
        )  # fmt: skip
        self._sequence += 1

    def frame_sent(self, frame: Frame, now_ns: int) -> None:
        """The core answered with ``frame``, which left at ``now_ns``."""
        identifier, data, is_extended, is_remote, is_error = frame
        self._sequence += 1
        log_time = now_ns + self._epoch_offset_ns
        seconds, nanoseconds = divmod(log_time, _SECOND_NS)
        self._batch += self._pack_frame(
            self._sent, self._sequence & SEQUENCE_MASK, log_time, log_time,
            CDR_HEADER, seconds, nanoseconds, self._bus,
            identifier, is_remote, is_extended, is_error, len(data), data,
        )  # fmt: skip

    def deadline_called(self, deadline_ns: int, now_ns: int) -> None:
        """The core's ``on_deadline`` is about to be called at ``now_ns`` for ``deadline_ns``."""
        self._sequence += 1
        self._now_ns = now_ns
        log_time = now_ns + self._epoch_offset_ns
        self._batch += self._pack_deadline(
            self._deadlines, self._sequence & SEQUENCE_MASK, log_time, log_time,
            CDR_HEADER, deadline_ns, now_ns,
        )  # fmt: skip

    def operated(self, command: str, now_ns: int) -> None:
        """The core is about to be given an operator's command, or :data:`LINK_FAILED` and a reason."""
        self._add_text(schemas.OPERATED, now_ns, CDR_HEADER + cdr_string(command))

    def cycle(self, cycle: Cycle, computed_ns: int, sent_ns: int) -> None:
        """A period ended: its timing and every axis' signals, logged at ``sent_ns``.

        ``computed_ns``: when the core had answered; ``sent_ns``: when its frames had been handed to the link.
        The axes' stamp is the sampling instant, when SYNC left.
        """
        number, deadline_ns, wake_ns, receive_ns, state, fresh, axes = cycle
        log_time = sent_ns + self._epoch_offset_ns
        seconds, nanoseconds = divmod(wake_ns + self._epoch_offset_ns, _SECOND_NS)
        sequence = self._sequence
        for prefix, signals in zip(self._axes, axes, strict=True):
            sequence += 1
            self._batch += self._pack_axis(
                prefix, sequence & SEQUENCE_MASK, log_time, log_time,
                CDR_HEADER, seconds, nanoseconds, _NO_FRAME_ID, *signals, state, fresh,
            )  # fmt: skip
        self._sequence = sequence = sequence + 1
        self._batch += self._pack_cycle(
            self._cycles, sequence & SEQUENCE_MASK, log_time, log_time,
            CDR_HEADER, number, deadline_ns, wake_ns, receive_ns, computed_ns, sent_ns, state, fresh,
        )  # fmt: skip

    def log_entry(self, event: LogEntry, now_ns: int) -> None:
        """The core, or the shell, reported ``event``."""
        stamp = divmod(now_ns + self._epoch_offset_ns, _SECOND_NS)
        payload = bytearray(CDR_HEADER) + struct.pack("<iIB3x", *stamp, event.severity)
        for text in (event.source, event.text, "", ""):
            payload += cdr_string(text)
            payload += bytes(-len(payload) % 4)
        self._add_text(schemas.EVENTS, now_ns, payload + struct.pack("<I", 0))

    @property
    def dropped(self) -> int:
        """Messages dropped so far."""
        return self._pipe.dropped.total()

    def hand_over(self) -> LogEntry | None:
        """Pass on what is large or old enough. Call it once a period, in idle time.

        Returns news that the user should read: the first drop, or the end of the recorder process.
        """
        if len(self._batch) >= BATCH_BYTES or self._now_ns - self._handed_ns >= BATCH_AGE_NS:
            self._hand_over_batch()
        elif self._pipe.has_backlog:
            self._pipe.push()
        return self._pipe.news.pop(0) if self._pipe.news else None

    def close(self, metadata: dict[str, dict[str, str]]) -> RecorderReport:
        """End the file with ``metadata`` (name to entries) and what was dropped; wait until it is whole."""
        self._pipe.drain()
        self._hand_over_batch()
        counts = {"messages": str(self._sequence - self.dropped)}
        counts |= {f"dropped {topic}": str(count) for topic, count in self._dropped_by_topic().items()}
        self._pipe.send(_empty_block() + msgspec.msgpack.encode({**metadata, "recorder": counts}), END)
        self._pipe.close()
        return RecorderReport(
            self._sequence - self.dropped, self._dropped_by_topic(), self._path, self._pipe.failure
        )

    def _add_text(self, channel: int, now_ns: int, payload: bytes | bytearray) -> None:
        self._sequence += 1
        log_time = now_ns + self._epoch_offset_ns
        prefix = message_prefix(channel, len(payload))
        self._batch += MESSAGE_HEADER.pack(prefix, self._sequence & SEQUENCE_MASK, log_time, log_time)
        self._batch += payload

    def _hand_over_batch(self) -> None:
        if len(self._batch) > BLOCK_HEADER.size:
            self._pipe.send(self._batch, BATCH)
            self._batch = _empty_block()
        self._handed_ns = self._now_ns

    def _dropped_by_topic(self) -> dict[str, int]:
        return {self._topics[channel - 1]: count for channel, count in sorted(self._pipe.dropped.items())}


def _packer(kind: MessageType, frame_id: str = "") -> tuple[Layout, Callable[..., bytes]]:
    """The payload's layout, and a function that packs a whole message record from its values in order."""
    layout = layout_of(kind.definition, frame_id)
    return layout, struct.Struct(MESSAGE_HEADER.format + layout.format).pack


def _empty_block() -> bytearray:
    return bytearray(BLOCK_HEADER.size)
