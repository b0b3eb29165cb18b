"""Parses the records of an MCAP file, strictly: a field that leaves its record raises ValueError.

The parsers of ``mcap`` return fewer bytes than a field states without an error, so they cannot be used on
files that may be damaged. The classes of ``mcap`` hold the parsed values. Bytes after the last field of a
record are padding, which newer writers may add. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import stat
import struct
import weakref
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from hil.core.errors import RecordingError
from hil.recording.handover import RECORD_HEADER

_BLOCK_BYTES = 1024 * 1024
_CRC_BYTES = 4
_CHUNK_FIELDS = struct.Struct("<QQQII")
_CHUNK_INDEX_START = struct.Struct("<QQQQI")
_CHANNEL_OFFSET_BYTES = 10
_INDEX_RECORD_BYTES = 15
"""Size of a message index record without its entries."""
_INDEX_ENTRY_BYTES = 16
_CHANNEL_COUNT = struct.Struct("<HQ")


class FileBytes:
    """Random access to the bytes of a regular file; no more of it is in memory than what was asked for.

    Raises RecordingError when the file cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if not stat.S_ISREG(path.stat().st_mode):
                raise RecordingError(f"{path}: not a regular file")
            self._descriptor = os.open(path, os.O_RDONLY)
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
        weakref.finalize(self, os.close, self._descriptor)
        self.size = os.fstat(self._descriptor).st_size

    def read(self, start: int, size: int) -> bytes:
        """Return up to ``size`` bytes from offset ``start``, fewer at the end. Raises RecordingError."""
        try:
            content = os.pread(self._descriptor, size, start)
            while 0 < len(content) < size:
                more = os.pread(self._descriptor, size - len(content), start + len(content))
                if not more:
                    break
                content += more
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read: {error.strerror}") from None
        return content

    def crc(self, start: int, end: int) -> int:
        """Return the CRC-32 of the bytes from ``start`` to ``end``, read block by block."""
        crc = 0
        while start < end:
            block = self.read(start, min(_BLOCK_BYTES, end - start))
            if not block:
                return -1
            crc = zlib.crc32(block, crc)
            start += len(block)
        return crc


class Record(NamedTuple):
    """A record that lies within the file."""

    opcode: int
    start: int
    """Offset of its first byte."""
    end: int
    """Offset of the first byte after it."""

    @property
    def body_start(self) -> int:
        """Offset of the first byte after opcode and length."""
        return self.start + RECORD_HEADER.size


class ChunkHeader(NamedTuple):
    """A chunk's fields without its data."""

    start_ns: int
    """Smallest log time of its messages, in epoch ns."""
    end_ns: int
    """Largest log time of its messages, in epoch ns."""
    uncompressed_size: int
    crc: int
    """CRC-32 of the uncompressed data; 0: not recorded."""
    compression: str
    data_start: int
    """Offset of the data in the record's body."""
    data_size: int


class IndexedChunk(NamedTuple):
    """A chunk as the summary describes it."""

    start_ns: int
    end_ns: int
    offset: int
    """Offset of the chunk record in the file."""
    length: int
    """Size of the chunk record with its header, in bytes."""
    index_length: int
    """Size of the message indexes that follow the chunk, in bytes."""
    messages: int
    """Number of messages that these indexes list."""


class _Fields:
    """Takes fields off the body of a record, one after the other. Raises ValueError beyond its end."""

    def __init__(self, body: bytes) -> None:
        self._body = body
        self.place = 0

    def take(self, size: int) -> bytes:
        end = self.place + size
        if end > len(self._body):
            raise ValueError("a field is longer than its record")
        self.place, start = end, self.place
        return self._body[start:end]

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        return self.take(self.number(4)).decode()

    def pairs(self) -> dict[str, str]:
        end = self.place + 4 + self.number(4)
        found = {}
        while self.place < end:
            key = self.text()
            found[key] = self.text()
        if self.place != end:
            raise ValueError("the entries do not end where they should")
        return found


def record_at(file: FileBytes, start: int) -> Record | None:
    """Return the record that begins at ``start``; None if it does not end within the file."""
    header = file.read(start, RECORD_HEADER.size)
    if len(header) < RECORD_HEADER.size:
        return None
    opcode, length = RECORD_HEADER.unpack(header)
    end = start + RECORD_HEADER.size + length
    return Record(opcode, start, end) if end <= file.size else None


def records_in(content: bytes, start: int = 0) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and body of each record from ``start`` on. Raises ValueError when the last one is cut."""
    while start < len(content):
        if start + RECORD_HEADER.size > len(content):
            raise ValueError("a record is cut off")
        opcode, length = RECORD_HEADER.unpack_from(content, start)
        end = start + RECORD_HEADER.size + length
        if end > len(content):
            raise ValueError("a record is cut off")
        yield opcode, content[start + RECORD_HEADER.size : end]
        start = end


def parse_attachment(body: bytes) -> tuple[Attachment, int]:
    """Return an attachment, and the size of its fields. Raises ValueError, also when its CRC is wrong."""
    fields = _Fields(body)
    log_time, create_time = fields.number(8), fields.number(8)
    name, media_type = fields.text(), fields.text()
    data = fields.take(fields.number(8))
    content_end = fields.place
    crc = fields.number(_CRC_BYTES)
    if crc and zlib.crc32(memoryview(body)[:content_end]) != crc:
        raise ValueError(f"the attachment {name} is damaged: its CRC does not match its content")
    return Attachment(create_time, log_time, name, media_type, data), fields.place


def parse_metadata(body: bytes) -> tuple[Metadata, int]:
    """Return a metadata record, and the size of its fields. Raises ValueError."""
    fields = _Fields(body)
    return Metadata(fields.text(), fields.pairs()), fields.place


def parse_schema(body: bytes) -> tuple[Schema, int]:
    """Return a schema, and the size of its fields. Raises ValueError."""
    fields = _Fields(body)
    number, name, encoding = fields.number(2), fields.text(), fields.text()
    return Schema(data=fields.take(fields.number(4)), encoding=encoding, id=number, name=name), fields.place


def parse_channel(body: bytes) -> tuple[Channel, int]:
    """Return a channel, and the size of its fields. Raises ValueError."""
    fields = _Fields(body)
    number, schema, topic, encoding = fields.number(2), fields.number(2), fields.text(), fields.text()
    return Channel(number, topic, encoding, fields.pairs(), schema), fields.place


def parse_chunk_header(body: bytes) -> ChunkHeader:
    """Return the fields of a chunk; ``body`` may end after them. Raises ValueError."""
    if len(body) < _CHUNK_FIELDS.size:
        raise ValueError("a field is longer than its record")
    start_ns, end_ns, uncompressed_size, crc, name_size = _CHUNK_FIELDS.unpack_from(body)
    place = _CHUNK_FIELDS.size + name_size
    data_start = place + 8
    if data_start > len(body):
        raise ValueError("a field is longer than its record")
    compression = body[_CHUNK_FIELDS.size : place].decode()
    size = int.from_bytes(body[place:data_start], "little")
    return ChunkHeader(start_ns, end_ns, uncompressed_size, crc, compression, data_start, size)


def parse_chunk_index(body: bytes) -> IndexedChunk:
    """Return a chunk index. Raises ValueError or struct.error."""
    start_ns, end_ns, offset, length, offsets_size = _CHUNK_INDEX_START.unpack_from(body)
    place = _CHUNK_INDEX_START.size + offsets_size
    index_length = int.from_bytes(body[place : place + 8], "little")
    entries = index_length - _INDEX_RECORD_BYTES * (offsets_size // _CHANNEL_OFFSET_BYTES)
    return IndexedChunk(start_ns, end_ns, offset, length, index_length, entries // _INDEX_ENTRY_BYTES)


class FileStatistics(NamedTuple):
    """The counts that the summary states."""

    messages: int
    attachments: int
    metadata: int
    chunks: int
    by_channel: dict[int, int]
    """Number of messages, by channel id."""


def parse_statistics(body: bytes) -> FileStatistics:
    """Return the statistics. Raises ValueError or struct.error."""
    fields = _Fields(body)
    messages, _, _ = fields.number(8), fields.number(2), fields.number(4)
    attachments, metadata, chunks = fields.number(4), fields.number(4), fields.number(4)
    fields.take(16)  # first and last log time
    counts = dict(_CHANNEL_COUNT.iter_unpack(fields.take(fields.number(4))))
    return FileStatistics(messages, attachments, metadata, chunks, counts)


def parse_place(body: bytes) -> tuple[int, int]:
    """Return offset and length of the record that an attachment index or metadata index names."""
    fields = _Fields(body)
    return fields.number(8), fields.number(8)


SUMMARY_OPCODES = frozenset(
    {
        Opcode.FOOTER,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.STATISTICS,
        Opcode.METADATA_INDEX,
        Opcode.SUMMARY_OFFSET,
    }
)
"""Opcodes of records that stand in the summary alone."""
