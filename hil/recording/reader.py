"""Reads the recording of a run: signals, timing and frames as numpy arrays, log, documents and calls.

All ``_ns`` are on the gateway's monotonic clock, unless stated otherwise.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hil.core.errors import RecordingError
from hil.core.suggestions import did_you_mean
from hil.recording.entries import Entry, Logged
from hil.recording.entry_reader import EntryReader, is_complete, messages_dropped
from hil.recording.mcap_reader import Columns, numpy_codes
from hil.recording.run_files import Paths, open_contents
from hil.recording.schemas import (
    AXIS_SIGNALS,
    AXIS_TOPIC,
    CYCLE,
    CYCLE_TOPIC,
    FORMAT_VERSION,
    FRAME,
    RECEIVED_TOPIC,
    REFUSED_TOPIC,
    SENT_TOPIC,
    MessageType,
)
from hil.recording.tables import AxisTable, BoolArray, ByteArray, FrameTable, IntArray, TimingTable

_SECOND_NS = 1_000_000_000
_ALWAYS_NS = 2**62
"""Magnitude of an instant beyond all others."""
_MAX_LOG_DELAY_NS = 10 * _SECOND_NS
"""Largest time from a sampling instant to the log time of its period, for the choice of chunks to read."""
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")
_SIGNALS = (
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
_CYCLE = (
    "number",
    "deadline_ns",
    "wake_ns",
    "receive_ns",
    "computed_ns",
    "sent_ns",
    "state",
    "fresh",
)
_FRAME = ("log_time", "publish_time", "id", "is_extended", "is_rtr", "is_error", "dlc", "data")
_FRAME_TOPICS = {"received": RECEIVED_TOPIC, "sent": SENT_TOPIC, "refused": REFUSED_TOPIC}


class Recording:
    """The recording of one run; see :func:`hil.recording.open_recording` for examples.

    ``path``: a file; or all files of a run that the recorder wrote to several files; or their folder. A file
    that was cut off gives everything up to its last complete chunk. Raises RecordingError when ``path`` is
    not a recording, has another format version than ``schemas.FORMAT_VERSION``, or is damaged other than at
    its end.
    """

    def __init__(self, path: Paths) -> None:
        self._contents = contents = open_contents(path)
        self.path = contents.path
        """The file, or the first file of the run."""
        self._range_ns: tuple[int, int] | None = None
        self.attachments: dict[str, bytes] = contents.attachments
        """Content of each attached document, by its name."""
        self.metadata: dict[str, dict[str, str]] = contents.metadata
        """Entries of each metadata record, by its name: ``run``, ``setpoints``, ``ending``, ``rights``."""
        self.complete: bool = is_complete(contents.is_complete, contents.metadata)
        """True if the file was ended properly, False if it was cut off or saved by ``hil recover``."""
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
    def paths(self) -> tuple[Path, ...]:
        """The file, or all files of the run."""
        return tuple(file.path for file in self._contents.files)

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
        return messages_dropped(self.metadata)

    @property
    def state_names(self) -> dict[int, str]:
        """Names of the life cycle's states, by number, from the definitions in the file."""
        return self._constants(CYCLE_TOPIC)

    @property
    def phase_names(self) -> dict[int, str]:
        """Names of the phases of an experiment, by number, from the definitions in the file.

        Empty for a recording without an axis.
        """
        prefix = "phase_"
        return {
            value: name.removeprefix(prefix)
            for axis in list(self.axes)[:1]
            for value, name in self._constants(AXIS_TOPIC + axis, prefix).items()
        }

    def _constants(self, topic: str, prefix: str = "") -> dict[int, str]:
        """Return the names of the constants in the definition of a topic, in lower case, by value."""
        constants = re.findall(r"^uint8 (\w+)=(\d+)$", self._contents.definition(topic), flags=re.MULTILINE)
        return {int(value): name.lower() for name, value in constants if name.lower().startswith(prefix)}

    @cached_property
    def start_ns(self) -> int:
        """Instant from which ``time_s`` counts: ``wake_ns`` of the first recorded period, 0 without one."""
        first = self._contents.first_row(CYCLE_TOPIC, "")
        if "wake_ns" not in (first.dtype.names or ()):
            raise RecordingError(f"{self.path}: {CYCLE_TOPIC}: the definition of its messages lacks wake_ns")
        return int(first["wake_ns"][0]) if len(first) else 0

    def seconds(self, time_ns: int) -> float:
        """Convert an instant to seconds from the first recorded period, the scale of every ``time_s``."""
        return (time_ns - self.start_ns) * 1e-9

    @property
    def duration_s(self) -> float:
        """Time in seconds from the first recorded period to the last message; 0.0 without a message."""
        span = self._contents.time_range_ns()
        return 0.0 if span is None else self.seconds(span[1] - self.epoch_offset_ns)

    def between(self, from_s: float | None = None, to_s: float | None = None) -> Recording:
        """Return the recording restricted to a range of time, ``from_s`` <= ``time_s`` < ``to_s``.

        The other parts of the file are not read. None means the begin or the end of the recording. Signals,
        timing, frames and log of the result are those of the range; its ``time_s`` still counts from the
        first recorded period, and ``counts`` are those of the whole file.

        >>> from hil.recording import open_recording
        >>> float(open_recording("run.mcap").between(1.0, 1.5).timing().time_s[0])
        1.008
        """
        if from_s is not None and to_s is not None and not from_s < to_s:
            raise RecordingError(f"the range from {from_s:g} s to {to_s:g} s is empty")
        low = -_ALWAYS_NS if from_s is None else self.start_ns + round(from_s * _SECOND_NS)
        high = _ALWAYS_NS if to_s is None else self.start_ns + round(to_s * _SECOND_NS)
        part = copy(self)
        part._range_ns = (low, high)
        return part

    def windows(self, length_s: float) -> Iterator[Recording]:
        """Yield the recording in consecutive ranges of ``length_s`` seconds, to be read one at a time."""
        span = self._contents.time_range_ns()
        if span is None:
            return
        first_s = self.seconds(span[0] - self.epoch_offset_ns)
        count = max(math.ceil((self.duration_s - first_s) / length_s), 1)
        for number in range(count):
            yield self.between(
                first_s + number * length_s if number else None,
                first_s + (number + 1) * length_s if number < count - 1 else None,
            )

    def axis(self, name: str) -> AxisTable:
        """Return the signals of an axis, one row for each period. Raises RecordingError without that axis."""
        if name not in self.axes:
            raise RecordingError(
                f"{self.path}: no axis {name!r}; the recording has {', '.join(self.axes)}"
                f"{did_you_mean(str(name), self.axes)}"
            )
        columns = self._columns(AXIS_TOPIC + name, AXIS_SIGNALS, (*_STAMP, *_SIGNALS))
        seconds, nanoseconds = (columns.pop(field) for field in _STAMP)
        time_ns = seconds.astype(np.int64) * _SECOND_NS + nanoseconds - self.epoch_offset_ns
        columns, time_ns = self._in_range(columns, time_ns)
        return AxisTable(
            time_s=self._seconds(time_ns),
            time_ns=time_ns,
            **columns,
            running=self._is_running(columns["state"]),
            name=name,
            unit=self.axes[name],
        )

    def timing(self) -> TimingTable:
        """Return the timing of the loop, one row for each period."""
        columns = self._columns(CYCLE_TOPIC, CYCLE, _CYCLE)
        columns, _ = self._in_range(columns, columns["wake_ns"])
        return TimingTable(
            time_s=self._seconds(columns["wake_ns"]), **columns, running=self._is_running(columns["state"])
        )

    def frames(
        self, which: Literal["received", "sent", "refused"], identifier: int | None = None
    ) -> FrameTable:
        """Return CAN frames: those received, those sent, or those that the link did not send.

        With ``identifier``, only the data frames with this identifier of 11 bits.
        """
        columns = self._columns(_FRAME_TOPICS[which], FRAME, _FRAME, self.bus)
        if identifier is not None:
            is_other = columns["is_extended"] | columns["is_rtr"] | columns["is_error"]
            columns = _chosen(columns, (columns["id"] == identifier) & ~is_other)
        time_ns = columns.pop("log_time").astype(np.int64) - self.epoch_offset_ns
        columns, time_ns = self._in_range(columns, time_ns)
        return FrameTable(
            time_s=self._seconds(time_ns),
            time_ns=time_ns,
            stamp_ns=columns["publish_time"].astype(np.int64),
            id=columns["id"],
            is_extended=columns["is_extended"],
            is_remote=columns["is_rtr"],
            is_error=columns["is_error"],
            length=columns["dlc"],
            data=np.frombuffer(columns["data"].tobytes(), np.uint8).reshape(-1, 8),
        )

    def log(self) -> list[Logged]:
        """Return the log entries, each with its time in ns."""
        low, high = self._range_ns or (-_ALWAYS_NS, _ALWAYS_NS)
        found = (logged for reader in self._entry_readers() for logged in reader.log())
        return [logged for logged in found if low <= logged.now_ns < high]

    def entries(self) -> Iterator[Entry]:
        """Yield all entries in the order in which they were recorded.

        Raises RecordingError where messages are missing, since the following entries cannot be replayed, and
        for a range of time.
        """
        if self._range_ns is not None:
            raise RecordingError(f"{self.path}: a range of time cannot be replayed; open the whole recording")
        for place, reader in enumerate(self._entry_readers()):
            yield from reader.entries(is_continued=place > 0)

    def check_count(self) -> None:
        """Compare the number of messages with what the recorder states at the end of each file.

        No gap in the sequence shows messages that are missing after the last one. Raises RecordingError.
        """
        for reader in self._entry_readers():
            reader.check_count()

    def _entry_readers(self) -> list[EntryReader]:
        return [EntryReader(file, self.bus, self.epoch_offset_ns) for file in self._contents.files]

    def _columns(self, topic: str, kind: MessageType, names: Sequence[str], frame_id: str = "") -> Columns:
        """Return columns of ``topic`` within the range of time, and some rows around it.

        Raises RecordingError when the topic lacks a field of ``kind``, or has it with another type.
        """
        found: Mapping[str, Any] = self._contents.row_type(topic, frame_id).fields or {}
        for field, code in numpy_codes(kind.definition, frame_id).items():
            if field not in found or found[field][0] != np.dtype(code):
                raise RecordingError(
                    f"{self.path}: {topic}: the definition of its messages lacks the field {field}, or gives "
                    "it another type"
                )
        if self._range_ns is None:
            return self._contents.columns(topic, frame_id, names)
        low, high = (time_ns + self.epoch_offset_ns for time_ns in self._range_ns)
        return self._contents.columns(topic, frame_id, names, (low, high + _MAX_LOG_DELAY_NS))

    def _in_range(self, columns: Columns, time_ns: IntArray) -> tuple[Columns, IntArray]:
        if self._range_ns is None:
            return columns, time_ns
        is_chosen = (time_ns >= self._range_ns[0]) & (time_ns < self._range_ns[1])
        return _chosen(columns, is_chosen), time_ns[is_chosen]

    def _seconds(self, time_ns: IntArray) -> npt.NDArray[np.float64]:
        return np.asarray((time_ns - self.start_ns) * 1e-9)

    def _is_running(self, state: ByteArray) -> BoolArray:
        running = [value for value, name in self.state_names.items() if name == "running"]
        return np.isin(state, running)


def _chosen(columns: Columns, is_chosen: BoolArray) -> Columns:
    return {name: column[is_chosen] for name, column in columns.items()}
