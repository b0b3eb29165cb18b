"""Reads an MCAP file, complete or cut off: attachments, metadata, channels, and messages as numpy rows.

This module knows MCAP, not the gateway. Messages of one channel have a fixed layout, so numpy copies them out
of a chunk at once. Chunks are read when they are needed, one at a time.

A complete file has CRCs of its data and of its summary. When they match, the summary says where chunks,
attachments and metadata are, and the message indexes say where the messages are. Every other file is walked
through when it is opened (``mcap_scan``), and its message indexes are not used.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema
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
    FileStatistics,
    parse_attachment,
    parse_channel,
    parse_chunk_header,
    parse_chunk_index,
    parse_metadata,
    parse_place,
    parse_schema,
    parse_statistics,
    records_in,
)
from hil.recording.mcap_scan import Place, Scan, scan
from hil.recording.schemas import layout_of

Rows: TypeAlias = npt.NDArray[np.void]
"""Structured array with one row for each message."""

MESSAGE_FIELDS = {"length": ("<u8", 1), "log_time": ("<u8", 15), "publish_time": ("<u8", 23)}
"""Type and offset of the fields before each payload that :meth:`McapContents.rows` adds to the columns."""
MAX_MESSAGE_BYTES: Final = 1024 * 1024
"""Largest message of fixed size. A damaged definition may describe any size."""
_FOOTER_BYTES = RECORD_HEADER.size + 20
_FOOTER = struct.Struct("<QQI")
_DATA_END_BYTES = RECORD_HEADER.size + 4
_CRC_BYTES = 4
DEFINITION_ERRORS = (ValueError, KeyError, IndexError, struct.error, RecursionError, OverflowError)
"""Exceptions of the parser of definitions when the text is not a definition."""


class _Contents(NamedTuple):
    """What a file holds, however it was found."""

    attachments: list[Attachment]
    metadata: list[Metadata]
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    places: list[Place]
    counts: Counter[int]
    is_complete: bool


class McapContents:
    """The contents of an MCAP file. Raises RecordingError when it is no MCAP file, or is damaged."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = FileBytes(path)
        if self._file.read(0, len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise RecordingError(f"{path}: not an MCAP file")
        intact = _summarised(self._file)
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

    def rows(self, topic: str, frame_id: str, range_ns: tuple[int, int] | None = None) -> Rows:
        """Return all messages of ``topic``, whose only string is ``frame_id``, in file order.

        The columns are the definition's fields by their dotted names, and :data:`MESSAGE_FIELDS`. With
        ``range_ns``, only the chunks are read that have log times (epoch ns) from its first to its second
        value, and all of their messages are returned.
        """
        row_type = self.row_type(topic, frame_id)
        places = self._places if range_ns is None else _within(self._places, range_ns)
        if range_ns is None:
            filled = np.empty((self.counts[topic], row_type.itemsize), np.uint8)
            place = 0
            for block, starts in self._blocks(topic, row_type, places):
                target = filled[place : place + len(starts)]
                if len(target) < len(starts):
                    raise RecordingError(f"{self.path}: {topic}: more messages than the file states")
                target[:] = block[starts]
                place += len(starts)
            filled = filled[:place]
        else:
            blocks = [block[starts] for block, starts in self._blocks(topic, row_type, places)]
            filled = np.concatenate([np.empty((0, row_type.itemsize), np.uint8), *blocks])
        rows: Rows = filled.view(row_type)[:, 0]
        if np.any(rows["length"] != row_type.itemsize - RECORD_HEADER.size):
            raise self._wrong_length(topic)
        return rows

    def first_row(self, topic: str, frame_id: str) -> Rows:
        """Return the first row of :meth:`rows`; an empty array if there is none."""
        row_type = self.row_type(topic, frame_id)
        for block, starts in self._blocks(topic, row_type, self._places):
            rows: Rows = block[starts[:1]].view(row_type)[:, 0]
            return rows
        return np.empty(0, row_type)

    @property
    def files(self) -> tuple[McapContents]:
        """The file itself, as the only one of its run."""
        return (self,)

    def rows_at(self, content: bytes, starts: npt.NDArray[np.int64], topic: str, frame_id: str) -> Rows:
        """Return the rows of ``topic`` that begin at the offsets ``starts`` of a chunk's ``content``.

        Raises RecordingError as :meth:`rows` does.
        """
        row_type = self._row_types.get((topic, frame_id))
        if row_type is None:
            row_type = self._row_types[topic, frame_id] = self.row_type(topic, frame_id)
        size = row_type.itemsize
        if starts[0] < 0 or starts[-1] + size > len(content):
            raise self._wrong_length(topic)
        rows: Rows = _at_every_offset(content, size)[starts].view(row_type)[:, 0]
        if np.any(rows["length"] != size - RECORD_HEADER.size):
            raise self._wrong_length(topic)
        return rows

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
    ) -> Iterator[tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]]:
        """Yield each chunk that has messages of ``topic``, and the offsets of their records.

        Row i of the chunk, shape (offsets, bytes of a record), is the record that begins at offset i.
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

    def _walked(self) -> _Contents:
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
        return _Contents(
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
        data_crc = int.from_bytes(self._file.read(data_end.body_start, _CRC_BYTES), "little")
        crc_start = footer.body_start + _FOOTER.size - _CRC_BYTES
        summary_crc = int.from_bytes(self._file.read(crc_start, _CRC_BYTES), "little")
        for start, end, crc in ((0, data_end.start, data_crc), (data_end.end, crc_start, summary_crc)):
            if crc and self._file.crc(start, end) != crc:
                raise RecordingError(
                    f"{self.path}: damaged: the CRC of bytes {start} to {end} does not match them"
                )


def _at_every_offset(content: bytes, size: int) -> npt.NDArray[np.uint8]:
    """Return a view whose row i are the ``size`` bytes from offset i on."""
    return np.ndarray((len(content) - size + 1, size), np.uint8, content, strides=(1, 1))


_CHUNK_HEADER_BYTES = 256
"""Size of the begin of a chunk in which its fields before the data lie."""


def _within(places: Sequence[Place], range_ns: tuple[int, int]) -> list[Place]:
    return [place for place in places if place.start_ns <= range_ns[1] and place.end_ns >= range_ns[0]]


def _summarised(file: FileBytes) -> _Contents | None:
    """Return the contents by the summary of a complete file whose CRCs match; None for any other file."""
    footer_start = file.size - len(MCAP0_MAGIC) - _FOOTER_BYTES
    end = file.read(max(footer_start, 0), _FOOTER_BYTES + len(MCAP0_MAGIC))
    if footer_start < 0 or not end.endswith(MCAP0_MAGIC):
        return None
    if RECORD_HEADER.unpack_from(end) != (Opcode.FOOTER, _FOOTER.size):
        return None
    summary_start, _, summary_crc = _FOOTER.unpack_from(end, RECORD_HEADER.size)
    data_end = summary_start - _DATA_END_BYTES
    if not len(MCAP0_MAGIC) <= data_end < summary_start <= footer_start or not summary_crc:
        return None
    data_end_record = file.read(data_end, _DATA_END_BYTES)
    data_crc = int.from_bytes(data_end_record[RECORD_HEADER.size :], "little")
    if RECORD_HEADER.unpack_from(data_end_record) != (Opcode.DATA_END, _CRC_BYTES) or not data_crc:
        return None
    crc_start = footer_start + RECORD_HEADER.size + _FOOTER.size - _CRC_BYTES
    if file.crc(summary_start, crc_start) != summary_crc or file.crc(0, data_end) != data_crc:
        return None
    try:
        return _contents_of(file, file.read(summary_start, footer_start - summary_start))
    except (ValueError, struct.error):
        return None


def _contents_of(file: FileBytes, summary: bytes) -> _Contents | None:
    """Return what the summary lists; None if it does not list everything. Raises ValueError, struct.error."""
    schemas, channels = {}, {}
    places, messages = [], 0
    attachments, metadata = [], []
    statistics: FileStatistics | None = None
    for opcode, body in records_in(summary):
        match opcode:
            case Opcode.SCHEMA:
                schema, _ = parse_schema(body)
                schemas[schema.id] = schema
            case Opcode.CHANNEL:
                channel, _ = parse_channel(body)
                channels[channel.id] = channel
            case Opcode.STATISTICS:
                statistics = parse_statistics(body)
            case Opcode.CHUNK_INDEX:
                chunk = parse_chunk_index(body)
                messages += chunk.messages
                if chunk.index_length:
                    places.append(
                        Place(chunk.offset, chunk.length, chunk.index_length, chunk.start_ns, chunk.end_ns)
                    )
            case Opcode.ATTACHMENT_INDEX:
                attachments.append(parse_attachment(_body_at(file, *parse_place(body)))[0])
            case Opcode.METADATA_INDEX:
                metadata.append(parse_metadata(_body_at(file, *parse_place(body)))[0])
    if statistics is None or (statistics.messages, statistics.attachments, statistics.metadata) != (
        messages,
        len(attachments),
        len(metadata),
    ):
        return None  # messages outside chunks, or records that the summary does not list
    described = {number for number, channel in channels.items() if channel.schema_id in schemas}
    if not statistics.by_channel.keys() <= described:
        return None  # schemas and channels stand in chunks alone
    places.sort(key=lambda place: place.offset)
    return _Contents(attachments, metadata, schemas, channels, places, Counter(statistics.by_channel), True)


def _body_at(file: FileBytes, offset: int, length: int) -> bytes:
    return file.read(offset, length)[RECORD_HEADER.size :]


def numpy_codes(definition: str, frame_id: str) -> dict[str, str]:
    """Return the numpy type of each field of a message definition, by its dotted name."""
    return {field.name: _numpy_code(field.code) for field in layout_of(definition, frame_id).fields}


def _numpy_code(struct_code: str) -> str:
    return f"V{struct_code[:-1]}" if struct_code.endswith("s") else f"<{struct_code}"
