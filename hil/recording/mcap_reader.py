"""Reads an MCAP file, complete or cut off: attachments, metadata, channels, and messages as numpy rows.

This module knows MCAP, not the gateway. Messages of one channel have a fixed layout, so numpy copies them out
of a chunk at once. Chunks are read when they are needed, one at a time.

A complete file has CRCs of its data and of its summary. When they match, the summary says where chunks,
attachments and metadata are, and the message indexes say where the messages are. Every other file is walked
through when it is opened (``mcap_scan``), and its message indexes are not used.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt
from mcap.records import Channel
from mcap.writer import MCAP0_MAGIC

from hil.core.errors import RecordingError
from hil.recording.handover import MESSAGE_HEADER, RECORD_HEADER
from hil.recording.mcap_chunks import (
    Offsets,
    UnsupportedCompressionError,
    offsets_in_index,
    uncompressed,
    walk,
)
from hil.recording.mcap_records import (
    FileBytes,
    parse_chunk_header,
)
from hil.recording.mcap_scan import scan
from hil.recording.mcap_summary import CRC_BYTES, FOOTER, Contents, summarised_contents
from hil.recording.scan_result import NO_DATA, Place, Scan
from hil.recording.schemas import layout_of

Rows: TypeAlias = npt.NDArray[np.void]
"""Structured array with one row for each message."""
Columns: TypeAlias = dict[str, npt.NDArray[Any]]
"""Arrays of equal length, with one value for each message, by the name of the field."""

BLOCK_ROWS = 4096
"""Number of rows that are gathered before their columns are copied. They take half a megabyte."""

MESSAGE_FIELDS = {"length": ("<u8", 1), "log_time": ("<u8", 15), "publish_time": ("<u8", 23)}
"""Type and offset of the fields before each payload that :meth:`McapContents.columns` knows, too."""
MAX_MESSAGE_BYTES: Final = 1024 * 1024
"""Largest message of fixed size. A damaged definition may describe any size."""
DEFINITION_ERRORS = (ValueError, KeyError, IndexError, struct.error, RecursionError, OverflowError)
"""Exceptions of the parser of definitions when the text is not a definition."""


class McapContents:
    """The contents of an MCAP file. Raises RecordingError when it is no MCAP file, or is damaged."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = FileBytes(path)
        begin = self._file.read(0, len(MCAP0_MAGIC))
        if begin != MCAP0_MAGIC:
            raise RecordingError(
                f"{path}: {NO_DATA if MCAP0_MAGIC.startswith(begin) else 'not an MCAP file'}"
            )
        intact = summarised_contents(self._file)
        self._is_intact = intact is not None
        """True if CRCs of the file cover all chunks and indexes, and match."""
        found = intact or self._walked()
        self.attachments = {record.name: record.data for record in found.attachments}
        self.metadata = {record.name: record.metadata for record in found.metadata}
        self.channels = {channel.topic: channel for channel in found.channels.values()}
        """Channels by topic."""
        self.is_complete = found.is_complete
        """True if the file has a footer. If not, it was cut off, and its complete chunks can be read."""
        self._row_types: dict[tuple[str, str], np.dtype[np.void]] = {}
        self._schemas, self._places, self._counts = found.schemas, found.places, found.counts

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages, by topic."""
        return {topic: self._counts.get(channel.id, 0) for topic, channel in self.channels.items()}

    def channel(self, topic: str) -> Channel:
        """Return the channel of ``topic``. Raises RecordingError when there is none."""
        if topic not in self.channels:
            raise RecordingError(
                f"{self.path}: has no channel {topic}; it has {', '.join(self.channels) or 'none'}"
            )
        return self.channels[topic]

    def definition(self, topic: str) -> str:
        """Return the ``ros2msg`` definition of the messages of ``topic``. Raises RecordingError."""
        schema = self._schemas.get(self.channel(topic).schema_id)
        try:
            if schema is not None:
                return schema.data.decode()
        except UnicodeDecodeError:
            pass
        raise RecordingError(
            f"{self.path}: {topic}: the definition of its messages is "
            f"{'missing' if schema is None else 'damaged'}"
        )

    def chunks(self, topic: str | None = None) -> Iterator[tuple[bytes, Offsets]]:
        """Yield each chunk, uncompressed, and the offsets of its messages; with ``topic``, of that one only.

        Chunks without such a message may be yielded empty.
        """
        channel = None if topic is None else self.channel(topic).id
        for place in self._places:
            content, offsets = self._read(place, channel)
            yield content, {number: offsets[number] for number in offsets if channel in (None, number)}

    def columns(
        self, topic: str, frame_id: str, names: Sequence[str], range_ns: tuple[int, int] | None = None
    ) -> Columns:
        """Return columns of all messages of ``topic``, whose only string is ``frame_id``, in file order.

        The names are the definition's fields by their dotted names, and :data:`MESSAGE_FIELDS`. With
        ``range_ns``, only the chunks are read that have log times (epoch ns) from its first to its second
        value, and all of their messages are returned.
        """
        row_type = self.row_type(topic, frame_id)
        fields: Mapping[str, Any] = row_type.fields or {}
        types = {name: fields[name][0] for name in names}
        if range_ns is not None:
            blocks = self._row_blocks(topic, row_type, _within(self._places, range_ns))
            parts = [{name: rows[name].copy() for name in names} for rows in blocks]
            return {
                name: np.concatenate([np.empty(0, kind), *(part[name] for part in parts)])
                for name, kind in types.items()
            }
        count, filled = self.counts[topic], 0
        columns = {name: np.empty(count, kind) for name, kind in types.items()}
        for rows in self._row_blocks(topic, row_type, self._places):
            end = filled + len(rows)
            if end > count:
                raise RecordingError(f"{self.path}: {topic}: more messages than the file states")
            for name, column in columns.items():
                column[filled:end] = rows[name]
            filled = end
        return {name: column[:filled] for name, column in columns.items()}

    def _row_blocks(self, topic: str, row_type: np.dtype[np.void], places: Sequence[Place]) -> Iterator[Rows]:
        """Yield the rows of ``topic`` in blocks that stay in the processor's cache.

        A block is valid until the next one is asked for.
        """
        gathered: Rows = np.empty(BLOCK_ROWS, row_type)
        count = 0
        for at_every_offset, starts in self._blocks(topic, row_type, places):
            if count + len(starts) > BLOCK_ROWS:
                yield self._checked(topic, gathered[:count])
                count = 0
            if len(starts) > BLOCK_ROWS:
                yield self._checked(topic, at_every_offset[starts].view(row_type))
                continue
            gathered.view(at_every_offset.dtype)[count : count + len(starts)] = at_every_offset[starts]
            count += len(starts)
        yield self._checked(topic, gathered[:count])

    def _checked(self, topic: str, rows: Rows) -> Rows:
        """Return the rows. Raises RecordingError if a record has another length than its definition gives."""
        if np.any(rows["length"] != rows.dtype.itemsize - RECORD_HEADER.size):
            raise self._wrong_length(topic)
        return rows

    def first_row(self, topic: str, frame_id: str) -> Rows:
        """Return the first row of ``topic``; an empty array if there is none."""
        row_type = self.row_type(topic, frame_id)
        for block, starts in self._blocks(topic, row_type, self._places):
            return block[starts[:1]].view(row_type)
        return np.empty(0, row_type)

    @property
    def files(self) -> tuple[McapContents]:
        """The file itself, as the only one of its run."""
        return (self,)

    def rows_at(self, content: bytes, starts: npt.NDArray[np.int64], topic: str, frame_id: str) -> Rows:
        """Return the rows of ``topic`` that begin at the offsets ``starts`` of a chunk's ``content``.

        Raises RecordingError when a record has another length than its definition gives.
        """
        row_type = self._row_types.get((topic, frame_id))
        if row_type is None:
            row_type = self._row_types[topic, frame_id] = self.row_type(topic, frame_id)
        size = row_type.itemsize
        if starts[0] < 0 or starts[-1] + size > len(content):
            raise self._wrong_length(topic)
        return self._checked(topic, _at_every_offset(content, size)[starts].view(row_type))

    def time_range_ns(self) -> tuple[int, int] | None:
        """Return the smallest and the largest log time in epoch ns; None without a message."""
        if not self._places:
            return None
        return min(p.start_ns for p in self._places), max(p.end_ns for p in self._places)

    def row_type(self, topic: str, frame_id: str) -> np.dtype[np.void]:
        """Return the type of a row of ``topic``. Raises RecordingError when its definition is damaged."""
        definition = self.definition(topic)
        try:
            layout = layout_of(definition, frame_id)
            if layout.size > MAX_MESSAGE_BYTES:
                raise ValueError(f"messages of {layout.size} bytes, limit {MAX_MESSAGE_BYTES}")
        except DEFINITION_ERRORS as error:
            raise RecordingError(
                f"{self.path}: {topic}: the definition of its messages cannot be read: {error}"
            ) from None
        fields = [
            (field.name, _numpy_code(field.code), field.offset + MESSAGE_HEADER.size)
            for field in layout.fields
        ]
        fields += [(name, code, offset) for name, (code, offset) in MESSAGE_FIELDS.items()]
        names, codes, places = zip(*fields, strict=True)
        size = MESSAGE_HEADER.size + layout.size
        return np.dtype({"names": names, "formats": codes, "offsets": places, "itemsize": size})

    def _blocks(
        self, topic: str, row_type: np.dtype[np.void], places: Sequence[Place]
    ) -> Iterator[tuple[Rows, npt.NDArray[np.int64]]]:
        """Yield each chunk that has messages of ``topic``, and the offsets of their records.

        Item i of the chunk is the record that begins at offset i, as bytes.
        """
        channel, size = self.channel(topic).id, row_type.itemsize
        for place in places:
            content, offsets = self._read(place, channel)
            if channel not in offsets:
                continue
            starts = offsets[channel]
            if starts[0] < 0 or starts[-1] + size > len(content):
                raise self._wrong_length(topic)
            yield _at_every_offset(content, size), starts

    def _read(self, place: Place, channel: int | None) -> tuple[bytes, Offsets]:
        """Return a chunk, uncompressed, and the offsets of the messages of ``channel``, or of all."""
        record = self._file.read(place.offset, place.length + place.index_length)
        try:
            if place.index_length:
                offsets = offsets_in_index(record[place.length :], channel)
                if not offsets:
                    return b"", offsets
            body = self._body_of(record[: place.length]) if place.is_chunk else record
            return body, offsets if place.index_length else walk(body)
        except (ValueError, struct.error) as error:
            raise RecordingError(
                f"{self.path}: the chunk at byte {place.offset} is damaged: {error}"
            ) from None

    def _body_of(self, record: bytes) -> bytes:
        start = RECORD_HEADER.size
        header = parse_chunk_header(record[start : start + _CHUNK_HEADER_BYTES])
        start += header.data_start
        return uncompressed(header, record[start : start + header.data_size], not self._is_intact)

    def _wrong_length(self, topic: str) -> RecordingError:
        return RecordingError(f"{self.path}: {topic}: a message has not the length that its definition gives")

    def _walked(self) -> Contents:
        """Walk through the file. Raises RecordingError when anything but its end is missing."""
        try:
            found = scan(self._file)
        except UnsupportedCompressionError as error:
            raise RecordingError(f"{self.path}: {error}") from None
        for loss in found.losses:
            if not loss.is_tail:
                raise RecordingError(f"{self.path}: damaged: {loss.reason}; {self._advice(found, loss.end)}")
        if found.has_end:
            self._check_sections(found)
        return Contents(
            found.attachments,
            found.metadata,
            found.schemas,
            found.channels,
            [part.place for part in found.parts],
            found.counts,
            found.has_end,
        )

    def _advice(self, found: Scan, end: int) -> str:
        following = sum(part.place.offset >= end for part in found.parts)
        chunks = f"{following} chunks follow the damage; " if following else ""
        return f"{chunks}`hil recover {self.path}` saves what is whole"

    def _check_sections(self, found: Scan) -> None:
        """Check the CRCs of data and summary, where the file has them. Raises RecordingError."""
        assert found.data_end is not None and found.footer is not None
        data_end, footer = found.data_end, found.footer
        data_crc = int.from_bytes(self._file.read(data_end.body_start, CRC_BYTES), "little")
        crc_start = footer.body_start + FOOTER.size - CRC_BYTES
        summary_crc = int.from_bytes(self._file.read(crc_start, CRC_BYTES), "little")
        for start, end, crc in ((0, data_end.start, data_crc), (data_end.end, crc_start, summary_crc)):
            if crc and self._file.crc(start, end) != crc:
                raise RecordingError(
                    f"{self.path}: damaged: the CRC of bytes {start} to {end} does not match them"
                )


def _at_every_offset(content: bytes, size: int) -> Rows:
    """Return a view whose item i are the ``size`` bytes from offset i on."""
    return np.ndarray((len(content) - size + 1,), f"V{size}", content, strides=(1,))


_CHUNK_HEADER_BYTES = 256
"""Size of the begin of a chunk in which its fields before the data lie."""


def _within(places: Sequence[Place], range_ns: tuple[int, int]) -> list[Place]:
    return [place for place in places if place.start_ns <= range_ns[1] and place.end_ns >= range_ns[0]]


def numpy_codes(definition: str, frame_id: str) -> dict[str, str]:
    """Return the numpy type of each field of a message definition, by its dotted name."""
    return {field.name: _numpy_code(field.code) for field in layout_of(definition, frame_id).fields}


def _numpy_code(struct_code: str) -> str:
    return f"V{struct_code[:-1]}" if struct_code.endswith("s") else f"<{struct_code}"
