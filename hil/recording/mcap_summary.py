"""Takes the contents of a complete MCAP file from its summary, if the CRCs of data and summary match."""

from __future__ import annotations

import struct
from collections import Counter
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from hil.recording.handover import RECORD_HEADER
from hil.recording.mcap_records import (
    FileBytes,
    FileStatistics,
    parse_attachment,
    parse_channel,
    parse_chunk_index,
    parse_metadata,
    parse_place,
    parse_schema,
    parse_statistics,
    records_in,
)
from hil.recording.scan_result import Place

_FOOTER_BYTES = RECORD_HEADER.size + 20
FOOTER = struct.Struct("<QQI")
_DATA_END_BYTES = RECORD_HEADER.size + 4
CRC_BYTES = 4


class Contents(NamedTuple):
    """What a file holds, however it was found."""

    attachments: list[Attachment]
    metadata: list[Metadata]
    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    places: list[Place]
    counts: Counter[int]
    is_complete: bool


def summarised_contents(file: FileBytes) -> Contents | None:
    """Return the contents by the summary of a complete file whose CRCs match; None for any other file."""
    footer_start = file.size - len(MCAP0_MAGIC) - _FOOTER_BYTES
    end = file.read(max(footer_start, 0), _FOOTER_BYTES + len(MCAP0_MAGIC))
    if footer_start < 0 or not end.endswith(MCAP0_MAGIC):
        return None
    if RECORD_HEADER.unpack_from(end) != (Opcode.FOOTER, FOOTER.size):
        return None
    summary_start, _, summary_crc = FOOTER.unpack_from(end, RECORD_HEADER.size)
    data_end = summary_start - _DATA_END_BYTES
    if not len(MCAP0_MAGIC) <= data_end < summary_start <= footer_start or not summary_crc:
        return None
    data_end_record = file.read(data_end, _DATA_END_BYTES)
    data_crc = int.from_bytes(data_end_record[RECORD_HEADER.size :], "little")
    if RECORD_HEADER.unpack_from(data_end_record) != (Opcode.DATA_END, CRC_BYTES) or not data_crc:
        return None
    crc_start = footer_start + RECORD_HEADER.size + FOOTER.size - CRC_BYTES
    if file.crc(summary_start, crc_start) != summary_crc or file.crc(0, data_end) != data_crc:
        return None
    try:
        return _contents_of(file, file.read(summary_start, footer_start - summary_start))
    except (ValueError, struct.error):
        return None


def _contents_of(file: FileBytes, summary: bytes) -> Contents | None:
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
    return Contents(attachments, metadata, schemas, channels, places, Counter(statistics.by_channel), True)


def _body_at(file: FileBytes, offset: int, length: int) -> bytes:
    return file.read(offset, length)[RECORD_HEADER.size :]
