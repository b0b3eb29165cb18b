"""The conformance files of the MCAP project, made again: six contents in every combination of features.

The bytes are those of the project's own generator (foxglove/mcap, tests/conformance, MIT licence): the
SHA-256 of all 416 files were compared with the published ones. Features: ``ch`` chunks, ``mx`` message
indexes, ``st`` statistics, ``rsh`` and ``rch`` schemas and channels repeated in the summary, ``ax``, ``mdx``,
``chx`` attachment, metadata and chunk indexes, ``sum`` summary offsets, ``pad`` bytes after the last field of
a record.
"""

from __future__ import annotations

import itertools
import zlib
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

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
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from hil.recording.handover import RECORD_HEADER
from support.mcap_files import record_bytes

FEATURES = ("ch", "mx", "st", "rsh", "rch", "ax", "mdx", "chx", "sum", "pad")
PADDING = b"\x01\xff\xff"
_UNPADDED = (Footer, Message, Chunk, DataEnd)
_SCHEMA = Schema(id=1, name="Example", encoding="c", data=bytes([4, 5, 6]))
_CHANNEL = Channel(id=1, topic="example", schema_id=1, message_encoding="a", metadata={"foo": "bar"})


def _message(log_time: int, publish_time: int, sequence: int) -> Message:
    return Message(1, log_time, bytes([1, 2, 3]), publish_time, sequence)


CONTENTS: dict[str, list[McapRecord]] = {
    "NoData": [],
    "OneSchemalessMessage": [Channel(1, "example", "text", {}, 0), _message(2, 1, 10)],
    "OneMessage": [_SCHEMA, _CHANNEL, _message(2, 1, 10)],
    "OneAttachment": [Attachment(1, 2, "myFile", "application/octet-stream", bytes([1, 2, 3]))],
    "OneMetadata": [Metadata("myMetadata", {"foo": "bar"})],
    "TenMessages": [
        _SCHEMA,
        _CHANNEL,
        *(_message(time, time, number) for number, time in enumerate((0, 2, 1, 3, 3, 5, 4, 7, 8, 9))),
    ],
}


class Variant(NamedTuple):
    """A content with features."""

    content: str
    features: frozenset[str]

    def __str__(self) -> str:
        return "-".join([self.content, *sorted(self.features)])

    @property
    def records(self) -> list[McapRecord]:
        """The records that the file holds."""
        return CONTENTS[self.content]


def variants() -> Iterator[Variant]:
    """Yield the combinations that make sense."""
    for content, records in CONTENTS.items():
        kinds = {type(record) for record in records}
        for chosen in itertools.product((False, True), repeat=len(FEATURES)):
            features = frozenset(itertools.compress(FEATURES, chosen))
            needed = {"ax": Attachment, "mdx": Metadata, "rsh": Schema, "rch": Channel}
            if any(kind not in kinds for feature, kind in needed.items() if feature in features):
                continue
            if not kinds & {Message, Channel, Schema} and features & {"ch", "chx", "mx"}:
                continue
            if "sum" in features and not features & {"chx", "rsh", "rch", "mdx", "ax", "st"}:
                continue
            if features & {"chx", "mx"} and "ch" not in features:
                continue
            yield Variant(content, features)


class _File:
    def __init__(self, is_padded: bool) -> None:
        self.content = bytearray(MCAP0_MAGIC)
        self._is_padded = is_padded

    def add(self, record: McapRecord) -> tuple[int, int]:
        """Append a record; return its offset and size."""
        data = record_bytes(record)
        if self._is_padded and not isinstance(record, _UNPADDED):
            opcode, length = RECORD_HEADER.unpack_from(data)
            data = RECORD_HEADER.pack(opcode, length + len(PADDING)) + data[RECORD_HEADER.size :] + PADDING
        offset = len(self.content)
        self.content += data
        return offset, len(data)


def file_of(variant: Variant) -> bytes:
    """Return the bytes of a file."""
    features, records = variant.features, variant.records
    file = _File("pad" in features)
    file.add(Header("", ""))
    summary: dict[Opcode, list[McapRecord]] = {opcode: [] for opcode in _SUMMARY_ORDER}
    chunk: bytes = b""
    index: list[tuple[int, int]] = []
    for record in records:
        if isinstance(record, Attachment):
            offset, size = file.add(record)
            summary[Opcode.ATTACHMENT_INDEX] += [
                AttachmentIndex(
                    offset, size, record.log_time, record.create_time, len(record.data), record.name,
                    record.media_type,
                )
            ] * ("ax" in features)  # fmt: skip
        elif isinstance(record, Metadata):
            offset, size = file.add(record)
            summary[Opcode.METADATA_INDEX] += [MetadataIndex(offset, size, record.name)] * ("mdx" in features)
        elif "ch" in features:
            if isinstance(record, Message):
                index.append((record.log_time, len(chunk)))
            chunk += record_bytes(record)
        else:
            file.add(record)
    messages = [record for record in records if isinstance(record, Message)]
    times = [message.log_time for message in messages] or [0]
    if "ch" in features:
        summary[Opcode.CHUNK_INDEX] = _add_chunk(file, chunk, index, times, features)
    file.add(DataEnd(zlib.crc32(file.content)))
    if "rsh" in features:
        summary[Opcode.SCHEMA] = [record for record in records if isinstance(record, Schema)]
    if "rch" in features:
        summary[Opcode.CHANNEL] = [record for record in records if isinstance(record, Channel)]
    if "st" in features:
        kinds = Counter(type(record) for record in records)
        counts = {1: len(messages)} if messages else {}
        summary[Opcode.STATISTICS] = [
            Statistics(
                kinds[Attachment], kinds[Channel], counts, int("ch" in features), len(messages), max(times),
                min(times), kinds[Metadata], kinds[Schema],
            )
        ]  # fmt: skip
    _add_summary(file, summary, "sum" in features)
    return bytes(file.content)


_SUMMARY_ORDER = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.METADATA_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.CHUNK_INDEX,
)


def _add_chunk(
    file: _File, chunk: bytes, index: list[tuple[int, int]], times: list[int], features: frozenset[str]
) -> list[McapRecord]:
    """Append a chunk and its index; return its chunk index, if the features include it."""
    offset, size = file.add(Chunk("", chunk, max(times), min(times), zlib.crc32(chunk), len(chunk)))
    places, index_size = {}, 0
    if "mx" in features and index:
        places[1], index_size = file.add(MessageIndex(1, index))
    if "chx" not in features:
        return []
    return [
        ChunkIndex(
            size, offset, "", len(chunk), max(times), index_size, places, min(times), len(chunk)
        )
    ]  # fmt: skip


def _add_summary(file: _File, summary: dict[Opcode, list[McapRecord]], has_offsets: bool) -> None:
    start = len(file.content)
    offsets = []
    for opcode, group in summary.items():
        begin = len(file.content)
        for record in group:
            file.add(record)
        if len(file.content) > begin:
            offsets.append(SummaryOffset(opcode, begin, len(file.content) - begin))
    offset_start = len(file.content) if has_offsets else 0
    summary_start = start if len(file.content) > start else 0
    for offset in offsets if has_offsets else []:
        file.add(offset)
    footer = record_bytes(Footer(summary_start, offset_start, 0))[:-4]
    crc = zlib.crc32(bytes(file.content[start:]) + footer)
    file.add(Footer(summary_start, offset_start, crc))
    file.content += MCAP0_MAGIC
