"""Reads the recording of a run: signals, timing and frames as numpy arrays, log, documents and calls.

All ``_ns`` are on the gateway's monotonic clock, unless stated otherwise.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hil.core.errors import RecordingError
from hil.recording.entries import Entry, Logged, Message, decoder_of, log_entry_of
from hil.recording.handover import MESSAGE_HEADER, RECORD_HEADER, SEQUENCE_MASK
from hil.recording.mcap_reader import McapContents, Rows
from hil.recording.schemas import (
    AXIS_TOPIC,
    CYCLE_TOPIC,
    FORMAT_VERSION,
    LOG_TOPIC,
    RECEIVED_TOPIC,
    REFUSED_TOPIC,
    SENT_TOPIC,
)
from hil.recording.tables import AxisTable, BoolArray, FrameTable, IntArray, TimingTable

_SECOND_NS = 1_000_000_000
_FRAME_TOPICS = {"received": RECEIVED_TOPIC, "sent": SENT_TOPIC, "refused": REFUSED_TOPIC}


class Recording:
    """The recording of one run; see :func:`hil.recording.open_recording` for examples.

    A file that was cut off gives everything up to its last complete chunk. Raises RecordingError when
    ``path`` is not a recording, has another format version than ``schemas.FORMAT_VERSION``, or is damaged
    other than at its end.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._contents = contents = McapContents(self.path)
        self.attachments: dict[str, bytes] = contents.attachments
        """Content of each attached document, by its name."""
        self.metadata: dict[str, dict[str, str]] = contents.metadata
        """Entries of each metadata record, by its name: ``run``, ``setpoints``, ``ending``, ``rights``."""
        self.complete: bool = contents.is_complete
        """True if the file was ended properly, False if it was cut off."""
        own = self._own_metadata()
        self.bus: str = own["bus"]
        """Name of the bus."""
        try:
            self.epoch_offset_ns = int(own["epoch_offset_ns"])
            """Epoch time minus time on the gateway's monotonic clock, in ns."""
        except ValueError:
            raise RecordingError(
                f"{self.path}: metadata recording.epoch_offset_ns is not an integer: "
                f"{own['epoch_offset_ns']!r}"
            ) from None

    def _own_metadata(self) -> dict[str, str]:
        own = self.metadata.get("recording", {})
        for key in ("epoch_offset_ns", "bus"):
            if key not in own:
                raise RecordingError(
                    f"{self.path}: not the recording of a run: metadata recording.{key} is missing"
                )
        version = own.get("format_version", "1")
        if version != str(FORMAT_VERSION):
            writer = self.metadata.get("run", {}).get("hil", "")
            raise RecordingError(
                f"{self.path}: the recording has format version {version}, and this program reads version "
                f"{FORMAT_VERSION}: read it with the pneumatic-hil that recorded it"
                + (f", version {writer}" if writer else "")
            )
        return own

    @property
    def axes(self) -> dict[str, str]:
        """Unit (m or rad) of each axis, by its name, in the rig file's order."""
        return {
            topic.removeprefix(AXIS_TOPIC): channel.metadata.get("unit", "")
            for topic, channel in self._contents.channels.items()
            if topic.startswith(AXIS_TOPIC)
        }

    @property
    def documents(self) -> dict[str, str]:
        """The attachments as text: ``rig.toml``, ``arm.dbc``, ``controllers/<axis>.json`` and others."""
        return {name: content.decode(errors="replace") for name, content in self.attachments.items()}

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages, by topic."""
        return self._contents.counts

    @property
    def messages_dropped(self) -> int:
        """Number of messages that were not recorded, because the recorder process was too slow or ended."""
        counts = self.metadata.get("recorder", {})
        return sum(int(count) for key, count in counts.items() if key.startswith("dropped "))

    @property
    def state_names(self) -> dict[int, str]:
        """Names of the life cycle's states, by number, from the definitions in the file."""
        constants = re.findall(
            r"^uint8 (\w+)=(\d+)$", self._contents.definition(CYCLE_TOPIC), flags=re.MULTILINE
        )
        return {int(value): name.lower() for name, value in constants}

    @cached_property
    def start_ns(self) -> int:
        """Instant from which ``time_s`` counts: ``wake_ns`` of the first recorded period, 0 without one."""
        first = self._contents.first_row(CYCLE_TOPIC, "")
        return int(first["wake_ns"][0]) if len(first) else 0

    def seconds(self, time_ns: int) -> float:
        """Convert an instant to seconds from the first recorded period, the scale of every ``time_s``."""
        return (time_ns - self.start_ns) * 1e-9

    def axis(self, name: str) -> AxisTable:
        """Return the signals of an axis, one row for each period. Raises RecordingError without that axis."""
        if name not in self.axes:
            raise RecordingError(f"{self.path}: no axis {name!r}; the recording has {', '.join(self.axes)}")
        rows = self._contents.rows(AXIS_TOPIC + name, "")
        time_ns = rows["header.stamp.sec"].astype(np.int64) * _SECOND_NS + rows["header.stamp.nanosec"]
        time_ns -= self.epoch_offset_ns
        signals = (
            "setpoint",
            "position",
            "error",
            "output_v",
            "command_v",
            "potentiometer_v",
            "phase",
            "state",
            "fresh",
        )
        return AxisTable(
            time_s=self._seconds(time_ns),
            time_ns=time_ns,
            **_columns(rows, signals),
            running=self._is_running(rows),
            name=name,
            unit=self.axes[name],
        )

    def timing(self) -> TimingTable:
        """Return the timing of the loop, one row for each period."""
        rows = self._contents.rows(CYCLE_TOPIC, "")
        instants = ("deadline_ns", "wake_ns", "receive_ns", "computed_ns", "sent_ns")
        return TimingTable(
            time_s=self._seconds(rows["wake_ns"]),
            **_columns(rows, ("number", *instants, "state", "fresh")),
            running=self._is_running(rows),
        )

    def frames(
        self, which: Literal["received", "sent", "refused"], identifier: int | None = None
    ) -> FrameTable:
        """Return CAN frames: those received, those sent, or those that the link did not send.

        With ``identifier``, only the data frames with this identifier of 11 bits.
        """
        rows = self._contents.rows(_FRAME_TOPICS[which], self.bus)
        if identifier is not None:
            rows = rows[
                (rows["id"] == identifier) & ~rows["is_extended"] & ~rows["is_rtr"] & ~rows["is_error"]
            ]
        time_ns = rows["log_time"].astype(np.int64) - self.epoch_offset_ns
        return FrameTable(
            time_s=self._seconds(time_ns),
            time_ns=time_ns,
            stamp_ns=rows["publish_time"].astype(np.int64),
            **_columns(rows, ("id", "is_extended", "is_error")),
            is_remote=rows["is_rtr"].copy(),
            length=rows["dlc"].copy(),
            data=np.frombuffer(rows["data"].tobytes(), np.uint8).reshape(-1, 8),
        )

    def log(self) -> list[Logged]:
        """Return the log entries, each with its time in ns."""
        return list(map(log_entry_of, self._messages({self._contents.channel(LOG_TOPIC).id})))

    def entries(self) -> Iterator[Entry]:
        """Yield all entries in the order in which they were recorded.

        Raises RecordingError where messages were dropped, since the following entries cannot be replayed.
        """
        decoders = {
            channel.id: decoder_of(topic, self._contents.definition(topic), self.bus, self.epoch_offset_ns)
            for topic, channel in self._contents.channels.items()
        }
        expected = 1
        for message in self._messages(None):
            if message.sequence != expected:
                missing = (message.sequence - expected) & SEQUENCE_MASK
                raise RecordingError(
                    f"{self.path}: {missing} messages before {message.now_ns} ns were dropped while "
                    "recording; the entries after them cannot be replayed"
                )
            expected = (message.sequence + 1) & SEQUENCE_MASK
            decode = decoders.get(message.channel)
            if decode is None:
                continue
            try:
                entry = decode(message)
            except (ValueError, struct.error) as error:
                raise RecordingError(
                    f"{self.path}: message {message.sequence} cannot be read: {error}"
                ) from None
            yield entry
        if self.messages_dropped:
            raise RecordingError(
                f"{self.path}: {self.messages_dropped} messages after the last one were dropped while "
                "recording"
            )

    def _messages(self, channels: set[int] | None) -> Iterator[Message]:
        """Yield the messages of ``channels`` (None: of all) in the order in which they were recorded."""
        for body, offsets in self._contents.chunks():
            chosen = offsets.keys() if channels is None else channels & offsets.keys()
            places = sorted((offset, channel) for channel in chosen for offset in offsets[channel].tolist())
            for offset, channel in places:
                prefix, sequence, log_time, stamp_ns = MESSAGE_HEADER.unpack_from(body, offset)
                end = offset + RECORD_HEADER.size + RECORD_HEADER.unpack(prefix[: RECORD_HEADER.size])[1]
                payload = body[offset + MESSAGE_HEADER.size : end]
                yield Message(channel, sequence, log_time - self.epoch_offset_ns, stamp_ns, payload)

    def _seconds(self, time_ns: IntArray) -> npt.NDArray[np.float64]:
        return np.asarray((time_ns - self.start_ns) * 1e-9)

    def _is_running(self, rows: Rows) -> BoolArray:
        running = [value for value, name in self.state_names.items() if name == "running"]
        return np.isin(rows["state"], running)


def _columns(rows: Rows, names: tuple[str, ...]) -> dict[str, npt.NDArray[Any]]:
    """Copy columns out of the rows, so that they are contiguous and do not keep the messages in memory."""
    return {name: rows[name].copy() for name in names}
