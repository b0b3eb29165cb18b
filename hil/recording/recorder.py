"""The loop's side of the recording: packs every message, and sends batches of them to the recorder process.

The shell reports each call of the core and each part of the answer in order. This order is the ``sequence``
of the messages, and replay repeats it. Compression, index and file are the recorder process' work. In real
time, no method here blocks.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from hil.core.errors import RecordingError
from hil.core.frames import Frame
from hil.core.output import Cycle, LogEntry, Severity
from hil.core.requests import Request
from hil.recording import schemas
from hil.recording.handover import (
    BATCH,
    BLOCK_HEADER,
    END,
    HEADER,
    MESSAGE_HEADER,
    SEQUENCE_MASK,
    NextFile,
    RunHeader,
    message_prefix,
)
from hil.recording.pipe import RecorderPipe
from hil.recording.request_texts import request_text
from hil.recording.rotation_names import PART, RUN_ID
from hil.recording.schemas import CDR_HEADER, Layout, MessageType, cdr_string, layout_of

if TYPE_CHECKING:
    from hil.recording.direct_writer import DirectWriter

__all__ = [
    "ARM_EVENTS",
    "BEGINS",
    "EVENT_SOURCE",
    "FAULTS_BEGUN",
    "FAULT_SOURCE",
    "Recorder",
    "RecorderReport",
    "RunHeader",
]

ARM_EVENTS = "arm events"
"""Name of the metadata with the planned events of a simulated arm.

The keys are the events as in ``--event``, the values are their times in seconds from the first sample.
"""

FAULT_SOURCE = "simulated fault"
"""Source of the log entries about simulated faults."""
EVENT_SOURCE = "arm"
"""Source of the log entries about the planned events of a simulated arm."""
BEGINS = " begins"
"""End of the text of an entry of both if the fault or event begins; before it stands its own text."""
FAULTS_BEGUN = "faults begun"
"""Name of the metadata with the faults of a simulated rig: instant to the faults that began then.

Several faults of the same instant are separated by spaces.
"""

BATCH_BYTES = 32 * 1024
"""A batch is sent at the end of the period in which it reaches this size."""
BATCH_SPAN_NS = 200_000_000
"""A batch is sent at the end of the period in which it spans this time."""

_SECOND_NS = 1_000_000_000
ROS_TIME_END_NS = 2**31 * _SECOND_NS
"""End of the time that ``builtin_interfaces/msg/Time`` can hold, January 2038, in epoch ns."""
_MAX_RUN_NS = 365 * 86400 * _SECOND_NS
_NO_FRAME_ID = cdr_string("")
_RUN_ID_LENGTH = 32


class RecorderReport(NamedTuple):
    """Result of a recording that was closed."""

    messages: int
    """Number of messages that were sent to the recorder process."""
    dropped: dict[str, int]
    """Number of messages that were not sent to the recorder process, by topic."""
    path: Path
    failure: str | None
    """Reason why the file is incomplete; None when it is complete."""

    def missing(self, in_file: int) -> int:
        """Return how many recorded messages are missing from a file that holds ``in_file`` messages."""
        return self.messages + sum(self.dropped.values()) - in_file


class Recorder:
    """Records one run into ``path``.

    Create it before the loop takes real-time rights or a processor of its own: the recorder process inherits
    them. With ``lossless``, the loop waits for the recorder process, and the same calls give the same bytes.
    ``now_ns`` is the time on the gateway's monotonic clock in every method. ``pipe`` replaces the recorder
    process. Raises RecordingError when ``path`` exists or cannot be created, or when the clock is outside ROS
    time.
    """

    def __init__(
        self,
        path: Path,
        header: RunHeader,
        lossless: bool,
        pipe: DirectWriter | None = None,
        min_free_bytes: int = 0,
    ) -> None:
        """With less free space than ``min_free_bytes``, :meth:`hand_over` gives a warning."""
        if not 0 <= header.epoch_offset_ns < ROS_TIME_END_NS - _MAX_RUN_NS:
            raise RecordingError(
                f"{path}: the clock shows {header.epoch_offset_ns // _SECOND_NS} s since 1970, but the time "
                "stamps of a recording must lie between 1970 and January 2038: set the clock"
            )
        self._path = path
        self._part = 1
        """Number of the present file of the run."""
        self._is_stopped = False
        """True after :meth:`stop`, until the next file begins. Messages are then discarded."""
        self._min_free_bytes = min_free_bytes
        self._is_short_of_space = False
        self._pipe: RecorderPipe | DirectWriter = pipe or RecorderPipe(path, lossless)
        self._batch = _empty_block()
        self._sequence = 0
        self._now_ns = self._handed_over_ns = 0
        self._epoch_offset_ns = header.epoch_offset_ns
        self._topics = [channel.topic for channel in schemas.channels(header.axes, header.stamp_origin)]
        self._bus = cdr_string(header.bus)
        frame, self._pack_frame = _packer(schemas.FRAME, header.bus)
        self._received = message_prefix(schemas.RECEIVED, frame.size)
        self._sent = message_prefix(schemas.SENT, frame.size)
        self._refused = message_prefix(schemas.REFUSED, frame.size)
        deadline, self._pack_deadline = _packer(schemas.DEADLINE)
        self._deadlines = message_prefix(schemas.DEADLINES, deadline.size)
        cycle, self._pack_cycle = _packer(schemas.CYCLE)
        self._cycles = message_prefix(schemas.CYCLES, cycle.size)
        axis, self._pack_axis = _packer(schemas.AXIS_SIGNALS)
        self._axes = [
            message_prefix(schemas.FIRST_AXIS + place, axis.size) for place in range(len(header.axes))
        ]
        self._pipe.send(_empty_block() + msgspec.msgpack.encode(_with_run_id(header)), HEADER)

    def await_start(self) -> None:
        """Wait until the recorder process has begun its file. Call this before the loop begins, if at all."""
        self._pipe.await_start()

    def frame_received(self, frame: Frame, now_ns: int, stamp_ns: int) -> None:
        """Record that the core is about to receive ``frame``, which the link stamped ``stamp_ns`` (epoch).

        A stamp outside ROS time is recorded as 0.
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
        self._sequence += 1  # Only now: the link may hand over a frame that cannot be packed.

    def frame_sent(self, frame: Frame, now_ns: int) -> None:
        """Record that the core answered with ``frame``, and that the link took it at ``now_ns``."""
        self._add_frame(self._sent, frame, now_ns)

    def frame_refused(self, frame: Frame, now_ns: int) -> None:
        """Record that the core answered with ``frame``, and that the link did not send it."""
        self._add_frame(self._refused, frame, now_ns)

    def deadline_called(self, deadline_ns: int, now_ns: int) -> None:
        """Record that the core's ``on_deadline`` is about to be called for ``deadline_ns``."""
        self._sequence += 1
        self._now_ns = now_ns
        log_time = now_ns + self._epoch_offset_ns
        self._batch += self._pack_deadline(
            self._deadlines, self._sequence & SEQUENCE_MASK, log_time, log_time,
            CDR_HEADER, deadline_ns, now_ns,
        )  # fmt: skip

    def operated(self, request: Request, now_ns: int, asked_by: str = "") -> None:
        """Record that the core is about to be given an operator's ``request``, and who asked."""
        text = request_text(request, asked_by)
        self._add_text(schemas.OPERATOR, now_ns, CDR_HEADER + cdr_string(text))

    def link_failed(self, reason: str, now_ns: int) -> None:
        """Record that the core is about to be given a failure of the link, or of the program."""
        self._add_text(schemas.LINK_FAILURES, now_ns, CDR_HEADER + cdr_string(reason))

    def cycle(self, cycle: Cycle, computed_ns: int, sent_ns: int) -> None:
        """Record the timing of a period that ended and the signals of every axis, logged at ``sent_ns``.

        ``computed_ns``: when the core had answered. ``sent_ns``: when the link had taken the last frame. The
        stamp of the axes is the sampling instant, when SYNC left.
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

    def log_entry(self, entry: LogEntry, now_ns: int) -> None:
        """Record a log entry of the core or of the shell."""
        self._add_text(schemas.LOG_ENTRIES, now_ns, log_payload(entry, now_ns + self._epoch_offset_ns))

    @property
    def dropped(self) -> int:
        """Number of messages that were dropped so far."""
        return self._pipe.dropped.total()

    def hand_over(self) -> LogEntry | None:
        """Send the batch to the recorder process if it is due. Call this once a period, in idle time.

        Returns a log entry for the user when messages are dropped for the first time, when the file cannot be
        written any more, and when little space is left for it.
        """
        if len(self._batch) >= BATCH_BYTES or self._now_ns - self._handed_over_ns >= BATCH_SPAN_NS:
            self._hand_over_batch()
        elif self._pipe.has_backlog:
            self._pipe.push()
        return self._pipe.log.pop(0) if self._pipe.log else None

    @property
    def has_failed(self) -> bool:
        """True if the present file cannot be written any more, such as on a full disk."""
        return self._pipe.failure is not None

    @property
    def path(self) -> Path | None:
        """The present file; None while nothing is recorded."""
        return None if self._is_stopped else self._path

    @property
    def file_bytes(self) -> int:
        """Size of the present file in bytes, as far as the recorder process has said so."""
        progress = self._pipe.progress
        return 0 if progress is None else progress.written_bytes

    def begin_file(
        self,
        path: Path,
        attachments: Mapping[str, tuple[str, bytes]],
        ending: dict[str, dict[str, str]],
        remove: Sequence[Path] = (),
        states: Mapping[str, dict[str, Any]] | None = None,
    ) -> str | None:
        """Go on in another file, and return None, or why that is not possible.

        ``attachments`` are added to those of the first file, and so are the plain values of ``states``, as
        JSON. Their digests are in the metadata ``documents``. ``ending`` is the metadata that ends the
        present file. The files in ``remove`` go. Nothing waits for the disk: whether the file can be written
        is known later, as for every file.
        """
        if path.exists():
            return f"{path} exists already; a recording overwrites no file"
        is_after_pause = self._is_stopped
        self.stop(ending)
        file = NextFile(
            str(path),
            self._part + 1,
            is_after_pause,
            tuple(map(str, remove)),
            dict(attachments),
            dict(states or {}),
        )
        if not self._pipe.next_file(path, _empty_block() + msgspec.msgpack.encode(file)):
            return "the recorder process has ended; end this program and start it again to record"
        self._path = path
        self._part += 1
        self._is_stopped = False
        self._sequence = 0
        self._batch = _empty_block()
        return None

    def stop(self, ending: dict[str, dict[str, str]]) -> None:
        """End the present file with the metadata ``ending``. Messages are discarded until another begins."""
        if self._is_stopped:
            return
        self._end_file(ending)
        self._is_stopped = True

    def close(self, metadata: dict[str, dict[str, str]]) -> RecorderReport:
        """End the file with ``metadata`` (entries by name) and message counts; wait until it is complete."""
        self._pipe.drain()
        if not self._is_stopped:
            self._end_file(metadata)
        self._pipe.close()
        return RecorderReport(
            self._sequence - self.dropped, self._dropped_by_topic(), self._path, self._pipe.failure
        )

    def _add_frame(self, prefix: bytes, frame: Frame, now_ns: int) -> None:
        identifier, data, is_extended, is_remote, is_error = frame
        self._sequence += 1
        log_time = now_ns + self._epoch_offset_ns
        seconds, nanoseconds = divmod(log_time, _SECOND_NS)
        self._batch += self._pack_frame(
            prefix, self._sequence & SEQUENCE_MASK, log_time, log_time,
            CDR_HEADER, seconds, nanoseconds, self._bus,
            identifier, is_remote, is_extended, is_error, len(data), data,
        )  # fmt: skip

    def _add_text(self, channel: int, now_ns: int, payload: bytes | bytearray) -> None:
        self._sequence += 1
        log_time = now_ns + self._epoch_offset_ns
        prefix = message_prefix(channel, len(payload))
        self._batch += MESSAGE_HEADER.pack(prefix, self._sequence & SEQUENCE_MASK, log_time, log_time)
        self._batch += payload

    def _end_file(self, metadata: dict[str, dict[str, str]]) -> None:
        self._hand_over_batch()
        counts = {"messages": str(self._sequence - self.dropped)}
        counts |= {f"dropped {topic}": str(count) for topic, count in self._dropped_by_topic().items()}
        self._pipe.send(_empty_block() + msgspec.msgpack.encode({**metadata, "recorder": counts}), END)

    def _hand_over_batch(self) -> None:
        if len(self._batch) > BLOCK_HEADER.size:
            if not self._is_stopped:
                self._pipe.send(self._batch, BATCH)
            self._batch = _empty_block()
        self._handed_over_ns = self._now_ns
        self._pipe.read_reports()
        self._check_free_space()

    def _check_free_space(self) -> None:
        """Report that little space is left, once, until there is more space again."""
        progress = self._pipe.progress
        if progress is None:
            return
        free, limit = progress.free_bytes, self._min_free_bytes
        if free < limit and not self._is_short_of_space:
            self._is_short_of_space = True
            text = (
                f"{self._path}: {free / 1e6:.0f} MB are free for recordings, less than {limit / 1e6:.0f} MB; "
                "the loop goes on without a recording when the disk is full; remove old recordings"
            )
            self._pipe.log.append(LogEntry(Severity.WARNING, "recorder", text))
        elif free > 1.1 * limit:
            self._is_short_of_space = False

    def _dropped_by_topic(self) -> dict[str, int]:
        return {self._topics[channel - 1]: count for channel, count in sorted(self._pipe.dropped.items())}


def _packer(kind: MessageType, frame_id: str = "") -> tuple[Layout, Callable[..., bytes]]:
    """Return the payload's layout, and a function that packs a message record from its values in order."""
    layout = layout_of(kind.definition, frame_id)
    return layout, struct.Struct(MESSAGE_HEADER.format + layout.format).pack


def log_payload(entry: LogEntry, epoch_ns: int) -> bytearray:
    """Return a log entry of the time ``epoch_ns`` as the payload of a ``rcl_interfaces/msg/Log``."""
    stamp = divmod(epoch_ns, _SECOND_NS)
    payload = bytearray(CDR_HEADER) + struct.pack("<iIB3x", *stamp, entry.severity)
    for text in (entry.source, entry.text, "", ""):
        payload += cdr_string(text)
        payload += bytes(-len(payload) % 4)
    return payload + struct.pack("<I", 0)


def _empty_block() -> bytearray:
    return bytearray(BLOCK_HEADER.size)


def _with_run_id(header: RunHeader) -> RunHeader:
    """Return the header of the first file of a run, with the name of the run."""
    own = {RUN_ID: sha256(msgspec.msgpack.encode(header)).hexdigest()[:_RUN_ID_LENGTH], PART: "1"}
    given = header.metadata.get("recording", {})
    return msgspec.structs.replace(header, metadata={**header.metadata, "recording": {**own, **given}})
