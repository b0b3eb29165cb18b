"""An MCAP file in the making: chunks, attachments and metadata, and the summary that lists them.

The classes of ``mcap`` write the records. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

_MESSAGE_INDEX_HEADER = struct.Struct("<BQHI")
_FOOTER_UP_TO_CRC = struct.Struct("<BQQQ")


class IndexedFile:
    """An MCAP file in the making: chunks, attachments and metadata are written and listed for the summary.

    ``write`` is called with the bytes of the file in their order.
    """

    def __init__(self, write: Callable[[bytes], object], library: str) -> None:
        self._write = write
        self._position = 0
        self._crc = 0
        """CRC-32 of all bytes that were written."""
        self._chunk_indexes: list[ChunkIndex] = []
        self._attachment_indexes: list[AttachmentIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._put(MCAP0_MAGIC)
        self._put(record_bytes([Header("ros2", library)]))

    @property
    def message_count(self) -> int:
        """Number of messages in the chunks that were written."""
        return self._counts.total()

    def add_attachment(self, attachment: Attachment) -> None:
        """Write an attachment."""
        record = record_bytes([attachment])
        self._attachment_indexes.append(
            AttachmentIndex(
                offset=self._position,
                length=len(record),
                log_time=attachment.log_time,
                create_time=attachment.create_time,
                data_size=len(attachment.data),
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )
        self._put(record)

    def add_metadata(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Write a metadata record for each entry of ``metadata``."""
        for name, entries in metadata.items():
            record = record_bytes([Metadata(name, dict(entries))])
            self._metadata_indexes.append(MetadataIndex(self._position, len(record), name))
            self._put(record)

    def add_chunk(self, chunk: Chunk, index: Mapping[int, Sequence[int]]) -> None:
        """Write a chunk and its message indexes.

        ``index``: log time, offset, log time, offset… of the messages in the uncompressed chunk, by channel
        id.
        """
        record = record_bytes([chunk])
        index_offsets: dict[int, int] = {}
        index_records = bytearray()
        for channel, pairs in index.items():
            index_offsets[channel] = self._position + len(record) + len(index_records)
            index_records += _message_index(channel, pairs)
            self._counts[channel] += len(pairs) // 2
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_length=len(record),
                chunk_start_offset=self._position,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=len(index_records),
                message_index_offsets=index_offsets,
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        self._put(record + index_records)

    def finish(self, schemas: Sequence[Schema], channels: Sequence[Channel]) -> None:
        """Write the end of the data, the summary with ``schemas`` and ``channels``, and the footer."""
        self._put(record_bytes([DataEnd(self._crc)]))
        statistics = self._statistics(len(schemas), len(channels))
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*schemas]),
            (Opcode.CHANNEL, [*channels]),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, [*self._chunk_indexes]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachment_indexes]),
            (Opcode.METADATA_INDEX, [*self._metadata_indexes]),
        ]
        start = self._position
        summary = bytearray()
        offsets: list[SummaryOffset] = []
        for opcode, records in groups:
            group = record_bytes(records)
            if group:
                offsets.append(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        offset_start = start + len(summary)
        summary += record_bytes(offsets)
        footer_up_to_crc = _FOOTER_UP_TO_CRC.pack(Opcode.FOOTER, 20, start, offset_start)
        crc = zlib.crc32(summary + footer_up_to_crc)
        self._put(summary + record_bytes([Footer(start, offset_start, crc)]) + MCAP0_MAGIC)

    def _put(self, data: bytes | bytearray) -> None:
        self._write(bytes(data))
        self._position += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def _statistics(self, schema_count: int, channel_count: int) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=channel_count,
            channel_message_counts=dict(sorted(self._counts.items())),
            chunk_count=len(self._chunk_indexes),
            message_count=self.message_count,
            message_end_time=max((index.message_end_time for index in self._chunk_indexes), default=0),
            message_start_time=min((index.message_start_time for index in self._chunk_indexes), default=0),
            metadata_count=len(self._metadata_indexes),
            schema_count=schema_count,
        )


def _message_index(channel: int, pairs: Sequence[int]) -> bytes:
    size = 8 * len(pairs)
    header = _MESSAGE_INDEX_HEADER.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size)
    return header + struct.pack(f"<{len(pairs)}Q", *pairs)


def record_bytes(records: Iterable[McapRecord]) -> bytes:
    """Return the bytes of records, one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
