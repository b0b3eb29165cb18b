"""Writes an MCAP file from batches of complete message records: chunks, indexes, statistics, footer.

``mcap.writer.Writer`` takes one message at a time and needs 7 µs for it, mostly to build an index entry of
objects. This writer copies a batch into its chunk and indexes the chunk in one pass. The classes of ``mcap``
write all other records. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

import zstandard
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

from hil import __version__
from hil.recording import schemas
from hil.recording.handover import RunHeader, index_messages, log_time_of_first

CHUNK_BYTES = 64 * 1024
"""A chunk ends with the batch that makes it this large."""
CHUNK_SPAN_NS = 400_000_000
"""A chunk ends with the batch that begins this much later than the chunk.

With a batch on either side of the pipe (``recorder.BATCH_SPAN_NS``), a crash loses 0.8 s at most.
"""

METADATA_DIGEST = "metadata sha256"
"""Key, in metadata ``recording``, of :func:`metadata_digest` over the metadata before the first message."""
DIGESTED_NAMES = "metadata names"
"""Key, in metadata ``recording``, of the names of the metadata records that the digest covers, as JSON."""

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


class McapWriter:
    """Writes one recording by calling ``write`` with the bytes of the file in their order."""

    def __init__(self, write: Callable[[bytes], object], header: RunHeader) -> None:
        self._compressor = zstandard.ZstdCompressor()
        self._schemas, self._channels = described_channels(header.axes, header.stamp_origin)
        self._file = IndexedFile(write, f"pneumatic-hil {__version__}")
        began_ns = header.began_ns or header.epoch_offset_ns
        for name, (media_type, content) in header.attachments.items():
            self._file.add_attachment(Attachment(began_ns, began_ns, name, media_type, content))
        own = {
            "format_version": str(schemas.FORMAT_VERSION),
            "epoch_offset_ns": str(header.epoch_offset_ns),
            "bus": header.bus,
            "stamp_origin": header.stamp_origin,
        }
        metadata = {**header.metadata, "recording": {**own, **header.metadata.get("recording", {})}}
        metadata["recording"][DIGESTED_NAMES] = json.dumps(sorted(metadata))
        metadata["recording"][METADATA_DIGEST] = metadata_digest(metadata)
        self._file.add_metadata({"recording": metadata.pop("recording"), **metadata})

        self._chunk = bytearray(record_bytes([*self._schemas, *self._channels]))
        """Chunk in progress. The first chunk begins with the schemas and channels of all messages."""
        self._first_message = len(self._chunk)
        self._chunk_began_ns = 0

    @property
    def message_count(self) -> int:
        """Number of messages in the chunks that were written."""
        return self._file.message_count

    def add_batch(self, records: bytes) -> None:
        """Append complete message records, and write the chunk when it has reached its size or span."""
        began_ns = log_time_of_first(records)
        if len(self._chunk) == self._first_message:
            self._chunk_began_ns = began_ns
        self._chunk += records
        if len(self._chunk) >= CHUNK_BYTES or began_ns - self._chunk_began_ns >= CHUNK_SPAN_NS:
            self.flush()

    def flush(self) -> None:
        """Write the chunk in progress with its message indexes, if it has messages."""
        if len(self._chunk) == self._first_message:
            return
        body = bytes(self._chunk)
        index = index_messages(body, self._first_message)
        chunk = Chunk(
            compression="zstd",
            data=self._compressor.compress(body),
            message_start_time=min(min(pairs[::2]) for pairs in index.values()),
            message_end_time=max(max(pairs[::2]) for pairs in index.values()),
            uncompressed_crc=zlib.crc32(body),
            uncompressed_size=len(body),
        )
        self._file.add_chunk(chunk, index)
        self._chunk.clear()
        self._first_message = 0

    def finish(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Write the last chunk, ``metadata`` (entries by name), the summary and the footer."""
        self.flush()
        self._file.add_metadata(metadata)
        self._file.finish(self._schemas, self._channels)


def metadata_digest(metadata: Mapping[str, Mapping[str, str]]) -> str:
    """Return the SHA-256 of the names, keys and values of metadata records, without the digest itself.

    Metadata records have no CRC of their own. With this digest, damage to them shows in a file that was cut
    off, too.
    """
    digest = hashlib.sha256()
    for name, entries in sorted(metadata.items()):
        for key, value in sorted(entries.items()):
            if key != METADATA_DIGEST:
                for text in (name, key, value):
                    encoded = text.encode("utf-8", "replace")
                    digest.update(len(encoded).to_bytes(4, "little") + encoded)
    return digest.hexdigest()


def has_changed(metadata: Mapping[str, Mapping[str, str]]) -> bool:
    """Return True if metadata differ from their digest. Those without a digest have not changed."""
    own = metadata.get("recording", {})
    digest, names = own.get(METADATA_DIGEST), own.get(DIGESTED_NAMES)
    if digest is None and names is None:
        return False  # recorded by pneumatic-hil 0.2
    try:
        return digest != metadata_digest({name: metadata.get(name, {}) for name in json.loads(names or "[]")})
    except (ValueError, TypeError):
        return True


def described_channels(
    axes: Sequence[tuple[str, str]], stamp_origin: str
) -> tuple[list[Schema], list[Channel]]:
    """Return the schema and channel records of a recording; their ids count from 1.

    ``axes``: name and unit of each axis, in the rig file's order.
    """
    channels = schemas.channels(axes, stamp_origin)
    types = list(dict.fromkeys(channel.type for channel in channels))
    return (
        [
            Schema(id=place, data=kind.definition.encode(), encoding="ros2msg", name=kind.name)
            for place, kind in enumerate(types, start=1)
        ],
        [
            Channel(
                id=place,
                topic=channel.topic,
                message_encoding="cdr",
                metadata={"offered_qos_profiles": "[]", **channel.metadata},
                schema_id=types.index(channel.type) + 1,
            )
            for place, channel in enumerate(channels, start=1)
        ],
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
