"""Messages for Foxglove: those of the feed, in the topics and bytes that they have in a recording."""

from __future__ import annotations

import struct
from typing import NamedTuple

from hil.core.output import LogEntry, Severity
from hil.live.feed_file import FeedLog, FeedReader, RunInformation
from hil.live.period_record import unpack_periods
from hil.recording.recorder import log_payload
from hil.recording.schemas import (
    AXIS_SIGNALS,
    AXIS_TOPIC,
    CDR_HEADER,
    CYCLE,
    CYCLE_TOPIC,
    LOG_TOPIC,
    Channel,
    MessageType,
    cdr_string,
    channels,
    layout_of,
)

_SECOND_NS = 1_000_000_000


class Message(NamedTuple):
    """A message of a topic."""

    topic: str
    log_time_ns: int
    """Epoch time, as in a recording: when the last frame of the period had been sent."""
    payload: bytes


class Packer:
    """Packs what is new in a feed as messages."""

    def __init__(self, run: RunInformation) -> None:
        self._run = run
        self._pack_axis = _packer(AXIS_SIGNALS)
        self._pack_cycle = _packer(CYCLE)
        self._frame_id = cdr_string("")
        self.channels: list[Channel] = [
            channel
            for channel in channels(run.axes, "")
            if channel.topic in (CYCLE_TOPIC, LOG_TOPIC) or channel.topic.startswith(AXIS_TOPIC)
        ]
        """The channels that are served. The frames of the bus are not in the feed."""

    def take(self, feed: FeedReader) -> list[Message]:
        """Return the messages that are new in ``feed`` since the last call."""
        return [*self._periods(feed.periods.read().messages), *map(self._log, feed.log())]

    def _periods(self, records: list[bytes]) -> list[Message]:
        offset_ns = self._run.epoch_offset_ns
        messages = []
        for period in unpack_periods(records, len(self._run.axes)):
            number, deadline_ns, wake_ns, receive_ns, computed_ns, sent_ns, state, fresh, _, axes = (
                period.item()
            )
            log_time_ns = sent_ns + offset_ns
            seconds, nanoseconds = divmod(wake_ns + offset_ns, _SECOND_NS)
            for (name, _), (*signals, _padding) in zip(self._run.axes, axes, strict=True):
                payload = self._pack_axis.pack(
                    CDR_HEADER, seconds, nanoseconds, self._frame_id, *signals, state, fresh
                )
                messages.append(Message(AXIS_TOPIC + name, log_time_ns, payload))
            payload = self._pack_cycle.pack(
                CDR_HEADER, number, deadline_ns, wake_ns, receive_ns, computed_ns, sent_ns, state, fresh
            )
            messages.append(Message(CYCLE_TOPIC, log_time_ns, payload))
        return messages

    def _log(self, entry: FeedLog) -> Message:
        epoch_ns = entry.time_ns + self._run.epoch_offset_ns
        logged = LogEntry(Severity(entry.severity), entry.source, entry.text)
        return Message(LOG_TOPIC, epoch_ns, bytes(log_payload(logged, epoch_ns)))


def _packer(kind: MessageType) -> struct.Struct:
    return struct.Struct("<" + layout_of(kind.definition, "").format)
