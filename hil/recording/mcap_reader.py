"""An MCAP file as a whole or as a crash left it: attachments, metadata, channels, and messages as numpy rows.

Knows nothing of gateways. mcap's classes parse every record but messages: those of a channel are gathered
from a chunk at once, as their layout is fixed. mcap's own readers refuse a file without a footer. A file with
one is held to its CRCs: of each chunk and attachment, and of all that stands before and after the data's end.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

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

Rows = npt.NDArray[np.void]
"""A structured array, one row a message."""

_UNREADABLE = (McapError, struct.error, ValueError, OverflowError, MemoryError)
"""What mcap's classes raise on bytes that are no such record."""
_FOOTER_UP_TO_CRC = RECORD_HEADER.size + 16
_CRC_BYTES = 4

MESSAGE_FIELDS = {"length": ("<u8", 1), "log_time": ("<u8", 15), "publish_time": ("<u8", 23)}
"""Fields of the record around each payload, with their offsets, that :meth:`McapContents.rows` adds."""


Offsets = dict[int, npt.NDArray[np.int64]]
"""Channel id to the offsets of its message records in an uncompressed chunk."""


class _Chunk(NamedTuple):
    offset: int
    """In the file."""
    record: Chunk
    offsets: Offsets


class McapContents:
    """What is in the file at ``path``. Raises RecordingError when it is no MCAP, or damaged."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.channels: dict[str, Channel] = {}
        """By topic."""
        self._schemas: dict[int, Schema] = {}
        self._chunks: list[_Chunk] = []
        try:
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
            except _UNREADABLE:
                kind = Opcode(opcode).name.lower().replace("_", " ")
                raise RecordingError(f"{path}: the {kind} at byte {offset} is damaged") from None
        self.is_complete = self._is_ended(content, places, end)
        """Whether the file has a footer; if not, it was cut off, and whole chunks up to there are read."""

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic."""
        return {
            topic: sum(len(chunk.offsets.get(channel.id, ())) for chunk in self._chunks)
            for topic, channel in self.channels.items()
        }

    def channel(self, topic: str) -> Channel:
        """The channel of ``topic``. Raises RecordingError when there is none."""
        if topic not in self.channels:
            raise RecordingError(f"{self.path}: has no channel {topic}; it has {', '.join(self.channels)}")
        return self.channels[topic]

    def definition(self, topic: str) -> str:
        """The ``ros2msg`` definition of the messages of ``topic``."""
        return self._schemas[self.channel(topic).schema_id].data.decode()

    def chunks(self) -> Iterator[tuple[bytes, Offsets]]:
        """Each chunk, uncompressed, and where its messages are."""
        for chunk in self._chunks:
            yield self._uncompressed(chunk.offset, chunk.record), chunk.offsets

    def rows(self, topic: str, frame_id: str) -> Rows:
        """All messages of ``topic``, whose only string is ``frame_id``, in file order.

        Columns: the definition's fields by dotted name, and :data:`MESSAGE_FIELDS`.
        """
        channel = self.channel(topic).id
        layout = layout_of(self.definition(topic), frame_id)
        fields = [
            (field.name, _numpy_code(field.code), field.offset + MESSAGE_HEADER.size)
            for field in layout.fields
        ]
        fields += [(name, code, offset) for name, (code, offset) in MESSAGE_FIELDS.items()]
        names, codes, places = zip(*fields, strict=True)
        size = MESSAGE_HEADER.size + layout.size
        kind = np.dtype({"names": names, "formats": codes, "offsets": places, "itemsize": size})
        parts = [np.empty(0, kind)]
        for body, offsets in self.chunks():
            starts = offsets.get(channel)
            if starts is None:
                continue
            if starts[-1] + size > len(body):
                raise self._unlike(topic)
            gathered = np.frombuffer(body, np.uint8)[starts[:, None] + np.arange(size)]
            parts.append(gathered.view(kind)[:, 0])
        rows = np.concatenate(parts)
        if np.any(rows["length"] != size - RECORD_HEADER.size):
            raise self._unlike(topic)
        return rows

    def _unlike(self, topic: str) -> RecordingError:
        return RecordingError(f"{self.path}: {topic}: a message's length is not that of its definition")

    def _take(self, opcode: int, offset: int, body: bytes) -> None:
        match opcode:
            case Opcode.ATTACHMENT:
                attachment = Attachment.read(_stream(body))
                crc = int.from_bytes(body[-_CRC_BYTES:], "little")
                if crc and zlib.crc32(body[:-_CRC_BYTES]) != crc:
                    raise RecordingError(
                        f"{self.path}: the attachment {attachment.name} is damaged: its CRC is not that of "
                        "its content"
                    )
                self.attachments[attachment.name] = attachment.data
            case Opcode.METADATA:
                metadata = Metadata.read(_stream(body))
                self.metadata[metadata.name] = metadata.metadata
            case Opcode.SCHEMA | Opcode.CHANNEL:
                self._describe(opcode, body)
            case Opcode.CHUNK:
                self._index(offset, Chunk.read(_stream(body)))

    def _is_ended(self, content: bytes, places: dict[int, tuple[int, int]], end: int) -> bool:
        """Tell a file that was cut off from one that was changed, and hold a whole one to its CRCs.

        ``places``: where the last record of each opcode begins and ends; ``end``: of the last whole record.
        """
        rest, has_footer = content[end:], Opcode.FOOTER in places
        if not (has_footer and Opcode.DATA_END in places and rest == MCAP0_MAGIC):
            if content.endswith(MCAP0_MAGIC) or (has_footer and not MCAP0_MAGIC.startswith(rest)):
                raise RecordingError(f"{self.path}: damaged: its records do not lead to its end")
            return False
        (data_end, summary), (footer, _) = places[Opcode.DATA_END], places[Opcode.FOOTER]
        data_crc = DataEnd.read(_stream(content[data_end + RECORD_HEADER.size :])).data_section_crc
        summary_crc = Footer.read(_stream(content[footer + RECORD_HEADER.size :])).summary_crc
        self._check_crc(content, 0, data_end, data_crc)
        self._check_crc(content, summary, footer + _FOOTER_UP_TO_CRC, summary_crc)
        return True

    def _check_crc(self, content: bytes, start: int, end: int, crc: int) -> None:
        if crc and zlib.crc32(memoryview(content)[start:end]) != crc:
            raise RecordingError(
                f"{self.path}: damaged: the CRC of bytes {start} to {end} is not that of their content"
            )

    def _describe(self, opcode: int, body: bytes) -> None:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(_stream(body))
            self._schemas[schema.id] = schema
        else:
            channel = Channel.read(_stream(body))
            self.channels[channel.topic] = channel

    def _index(self, offset: int, record: Chunk) -> None:
        body = self._uncompressed(offset, record)
        offsets = {
            channel: np.array(pairs[1::2], np.int64) for channel, pairs in index_messages(body).items()
        }
        self._chunks.append(_Chunk(offset, record, offsets))
        known = {channel.id for channel in self.channels.values()}
        if not offsets.keys() <= known:
            for opcode, _, description in _records(body, 0):
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._describe(opcode, description)

    def _uncompressed(self, offset: int, chunk: Chunk) -> bytes:
        damaged = f"{self.path}: the chunk at byte {offset} is damaged"
        if chunk.compression not in ("zstd", ""):
            raise RecordingError(f"{self.path}: compressed with {chunk.compression}, which is not read here")
        try:
            body = (
                zstandard.decompress(chunk.data, chunk.uncompressed_size) if chunk.compression else chunk.data
            )
        except zstandard.ZstdError as error:
            raise RecordingError(f"{damaged}: {error}") from None
        if chunk.uncompressed_crc and zlib.crc32(body) != chunk.uncompressed_crc:
            raise RecordingError(f"{damaged}: its CRC is not that of its content")
        return body


def _records(content: bytes, start: int) -> Iterator[tuple[int, int, bytes]]:
    """Opcode, offset and body of each whole record from ``start`` on."""
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
