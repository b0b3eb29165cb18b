"""Reads an MCAP file, complete or cut off: attachments, metadata, channels, and messages as numpy rows.

This module knows MCAP, not the gateway. The classes of ``mcap`` parse all records except messages: those of
one channel have a fixed layout, so numpy copies them out of a chunk at once. The readers of ``mcap`` are not
used, since they refuse a file without a footer.

A complete file has CRCs of its data and of its summary. When they match, the message indexes in the file say
where the messages are, and a chunk is decompressed when it is read. In every other file, each chunk is
decompressed when the file is opened: its own CRC is checked, and its records are walked through.
"""

from __future__ import annotations

import stat
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from hil.core.errors import RecordingError
from hil.recording.handover import MESSAGE_HEADER, RECORD_HEADER, index_messages
from hil.recording.schemas import layout_of

Rows: TypeAlias = npt.NDArray[np.void]
"""Structured array with one row for each message."""
Offsets: TypeAlias = dict[int, npt.NDArray[np.int64]]
"""Offsets of the message records in an uncompressed chunk, in ascending order, by channel id."""

MESSAGE_FIELDS = {"length": ("<u8", 1), "log_time": ("<u8", 15), "publish_time": ("<u8", 23)}
"""Type and offset of the fields before each payload that :meth:`McapContents.rows` adds to the columns."""

MAX_CHUNK_BYTES = 256 * 1024 * 1024
"""Largest chunk that is decompressed: a damaged or hostile file may state any size."""
_PARSE_ERRORS = (McapError, struct.error, ValueError, OverflowError, MemoryError)
"""Exceptions of the classes of ``mcap`` when the bytes are not such a record."""
_FOOTER_UP_TO_CRC = RECORD_HEADER.size + 16
_CRC_BYTES = 4
_INDEX_HEADER = struct.Struct("<HI")
"""Message index up to its entries: channel id, length of the entries (log time and offset, 8 bytes each)."""


@dataclass
class _Chunk:
    offset: int
    """Offset of the record in the file."""
    record: Chunk
    index: dict[int, npt.NDArray[np.int64]] = field(default_factory=dict)
    """Log time and offset of each message, one after the other, by channel id."""

    def offsets(self, channel: int) -> npt.NDArray[np.int64]:
        """Return the offsets of the channel's messages in the uncompressed chunk, in ascending order."""
        return np.sort(self.index[channel][1::2])


class _Section(NamedTuple):
    """A part of the file that a CRC covers."""

    start: int
    end: int
    crc: int

    def is_damaged(self, content: bytes) -> bool:
        return zlib.crc32(memoryview(content)[self.start : self.end]) != self.crc


class McapContents:
    """The contents of an MCAP file. Raises RecordingError when it is no MCAP file, or is damaged."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.channels: dict[str, Channel] = {}
        """Channels by topic."""
        self._schemas: dict[int, Schema] = {}
        self._chunks: list[_Chunk] = []
        self._decompressor = zstandard.ZstdDecompressor()
        try:
            if not stat.S_ISREG(path.stat().st_mode):
                raise RecordingError(f"{path}: not a regular file")
            content = path.read_bytes()
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
        if not content.startswith(MCAP0_MAGIC):
            raise RecordingError(f"{path}: not an MCAP file")
        places: dict[int, tuple[int, int]] = {}
        end = len(MCAP0_MAGIC)
        for opcode, offset, body in _records(content, end):
            end = offset + RECORD_HEADER.size + len(body)
            places[opcode] = offset, end
            try:
                self._take(opcode, offset, body)
            except _PARSE_ERRORS:
                kind = Opcode(opcode).name.lower().replace("_", " ")
                raise RecordingError(f"{path}: the {kind} at byte {offset} is damaged") from None
        self.is_complete = self._is_complete(content, places, end)
        """True if the file has a footer. If not, it was cut off, and its complete chunks can be read."""
        sections = _sections(content, places) if self.is_complete else []
        damaged = [section for section in sections if section.is_damaged(content)]
        self._is_intact = not damaged and any(section.start == 0 for section in sections)
        """True if a CRC of the file covers all chunks and indexes, and matches."""
        for chunk in self._chunks:
            if not (self._is_intact and chunk.index and self._describes(chunk)):
                self._walk_through(chunk)
        for start, end, _ in damaged:
            raise RecordingError(f"{path}: damaged: the CRC of bytes {start} to {end} does not match them")

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages, by topic."""
        return {
            topic: sum(len(chunk.index.get(channel.id, ())) // 2 for chunk in self._chunks)
            for topic, channel in self.channels.items()
        }

    def channel(self, topic: str) -> Channel:
        """Return the channel of ``topic``. Raises RecordingError when there is none."""
        if topic not in self.channels:
            raise RecordingError(f"{self.path}: has no channel {topic}; it has {', '.join(self.channels)}")
        return self.channels[topic]

    def definition(self, topic: str) -> str:
        """Return the ``ros2msg`` definition of the messages of ``topic``."""
        return self._schemas[self.channel(topic).schema_id].data.decode()

    def chunks(self) -> Iterator[tuple[bytes, Offsets]]:
        """Yield each chunk, uncompressed, and the offsets of its messages."""
        for chunk in self._chunks:
            yield self._uncompressed(chunk), {channel: chunk.offsets(channel) for channel in chunk.index}

    def rows(self, topic: str, frame_id: str) -> Rows:
        """Return all messages of ``topic``, whose only string is ``frame_id``, in file order.

        The columns are the definition's fields by their dotted names, and :data:`MESSAGE_FIELDS`.
        """
        row_type = self._row_type(topic, frame_id)
        blocks = [np.empty((0, row_type.itemsize), np.uint8), *self._blocks(topic, row_type)]
        rows: Rows = np.concatenate(blocks).view(row_type)[:, 0]
        if np.any(rows["length"] != row_type.itemsize - RECORD_HEADER.size):
            raise self._wrong_length(topic)
        return rows

    def first_row(self, topic: str, frame_id: str) -> Rows:
        """Return the first row of :meth:`rows`; an empty array if there is none."""
        row_type = self._row_type(topic, frame_id)
        block = next(self._blocks(topic, row_type), np.empty((0, row_type.itemsize), np.uint8))
        rows: Rows = block[:1].view(row_type)[:, 0]
        return rows

    def _blocks(self, topic: str, row_type: np.dtype[np.void]) -> Iterator[npt.NDArray[np.uint8]]:
        """Yield the message records of ``topic`` in each chunk that has any, shape (messages, bytes)."""
        channel, size = self.channel(topic).id, row_type.itemsize
        for chunk in self._chunks:
            if channel not in chunk.index:
                continue
            starts = chunk.offsets(channel)
            body = np.frombuffer(self._uncompressed(chunk), np.uint8)
            if starts[0] < 0 or starts[-1] + size > len(body):
                raise self._wrong_length(topic)
            yield np.lib.stride_tricks.as_strided(body, (len(body) - size + 1, size), (1, 1))[starts]

    def _row_type(self, topic: str, frame_id: str) -> np.dtype[np.void]:
        layout = layout_of(self.definition(topic), frame_id)
        fields = [
            (field.name, _numpy_code(field.code), field.offset + MESSAGE_HEADER.size)
            for field in layout.fields
        ]
        fields += [(name, code, offset) for name, (code, offset) in MESSAGE_FIELDS.items()]
        names, codes, places = zip(*fields, strict=True)
        size = MESSAGE_HEADER.size + layout.size
        return np.dtype({"names": names, "formats": codes, "offsets": places, "itemsize": size})

    def _wrong_length(self, topic: str) -> RecordingError:
        return RecordingError(f"{self.path}: {topic}: a message has not the length that its definition gives")

    def _take(self, opcode: int, offset: int, body: bytes) -> None:
        match opcode:
            case Opcode.MESSAGE_INDEX if self._chunks:
                channel, size = _INDEX_HEADER.unpack_from(body)
                if size:
                    self._chunks[-1].index[channel] = np.frombuffer(body, "<i8", offset=_INDEX_HEADER.size)
            case Opcode.ATTACHMENT:
                attachment = Attachment.read(_stream(body))
                crc = int.from_bytes(body[-_CRC_BYTES:], "little")
                if crc and zlib.crc32(body[:-_CRC_BYTES]) != crc:
                    raise RecordingError(
                        f"{self.path}: the attachment {attachment.name} is damaged: its CRC does not match "
                        "its content"
                    )
                self.attachments[attachment.name] = attachment.data
            case Opcode.METADATA:
                metadata = Metadata.read(_stream(body))
                self.metadata[metadata.name] = metadata.metadata
            case Opcode.SCHEMA | Opcode.CHANNEL:
                self._describe(opcode, body)
            case Opcode.CHUNK:
                self._chunks.append(_Chunk(offset, Chunk.read(_stream(body))))

    def _is_complete(self, content: bytes, places: dict[int, tuple[int, int]], end: int) -> bool:
        """Return False for a file that was cut off. Raises RecordingError for one that is damaged at its end.

        ``places`` has the begin and end of the last record of each opcode; ``end`` is that of the last whole
        record.
        """
        rest, has_footer = content[end:], Opcode.FOOTER in places
        if has_footer and Opcode.DATA_END in places and rest == MCAP0_MAGIC:
            return True
        has_end = len(content) > len(MCAP0_MAGIC) and content.endswith(MCAP0_MAGIC)
        if has_end or (has_footer and not MCAP0_MAGIC.startswith(rest)):
            raise RecordingError(f"{self.path}: damaged: its records do not lead to its end")
        return False

    def _describe(self, opcode: int, body: bytes) -> None:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(_stream(body))
            self._schemas[schema.id] = schema
        else:
            channel = Channel.read(_stream(body))
            self.channels[channel.topic] = channel

    def _describes(self, chunk: _Chunk) -> bool:
        """Return True if the channels of the chunk's messages are known, with their schemas."""
        known = {channel.id for channel in self.channels.values() if channel.schema_id in self._schemas}
        return chunk.index.keys() <= known

    def _walk_through(self, chunk: _Chunk) -> None:
        """Find the chunk's messages, and the channels that it describes, without an index."""
        body = self._uncompressed(chunk)
        try:
            index = index_messages(body)
            chunk.index = {channel: np.array(entries, np.int64) for channel, entries in index.items()}
            if not self._describes(chunk):
                for opcode, _, description in _records(body, 0):
                    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                        self._describe(opcode, description)
        except _PARSE_ERRORS:
            raise RecordingError(f"{self.path}: the chunk at byte {chunk.offset} is damaged") from None

    def _uncompressed(self, chunk: _Chunk) -> bytes:
        record = chunk.record
        damaged = f"{self.path}: the chunk at byte {chunk.offset} is damaged"
        if record.compression not in ("zstd", ""):
            raise RecordingError(
                f"{self.path}: its chunks are compressed with {record.compression}; only zstd can be read"
            )
        try:
            stated = max(record.uncompressed_size, _frame_bytes(record.data) if record.compression else 0)
            if stated > MAX_CHUNK_BYTES:
                raise RecordingError(f"{damaged}: it states {stated} bytes, limit {MAX_CHUNK_BYTES}")
            body: bytes = (
                self._decompressor.decompress(record.data, record.uncompressed_size)
                if record.compression
                else record.data
            )
        except zstandard.ZstdError as error:
            raise RecordingError(f"{damaged}: {error}") from None
        if not self._is_intact and record.uncompressed_crc and zlib.crc32(body) != record.uncompressed_crc:
            raise RecordingError(f"{damaged}: its CRC does not match its content")
        return body


def _sections(content: bytes, places: dict[int, tuple[int, int]]) -> list[_Section]:
    """Return the sections of a complete file that have a CRC: the data, and the summary with the footer."""
    (data_end, summary), (footer, _) = places[Opcode.DATA_END], places[Opcode.FOOTER]
    data_crc = DataEnd.read(_stream(content[data_end + RECORD_HEADER.size :])).data_section_crc
    summary_crc = Footer.read(_stream(content[footer + RECORD_HEADER.size :])).summary_crc
    sections = (
        _Section(0, data_end, data_crc),
        _Section(summary, footer + _FOOTER_UP_TO_CRC, summary_crc),
    )
    return [section for section in sections if section.crc]


def _records(content: bytes, start: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield opcode, offset and body of each whole record from ``start`` on."""
    while start + RECORD_HEADER.size <= len(content):
        opcode, length = RECORD_HEADER.unpack_from(content, start)
        end = start + RECORD_HEADER.size + length
        if end > len(content):
            return
        yield opcode, start, content[start + RECORD_HEADER.size : end]
        start = end


def _numpy_code(struct_code: str) -> str:
    return f"V{struct_code[:-1]}" if struct_code.endswith("s") else f"<{struct_code}"


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))


def _frame_bytes(compressed: bytes) -> int:
    """Return the size that a zstd frame states for its content; -1 if it states none."""
    return int(zstandard.frame_content_size(compressed))
