"""Finds the next whole record after damage: one that proves itself, by its CRC or by fields that fill it."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
from mcap.opcode import Opcode

from hil.recording.handover import RECORD_HEADER
from hil.recording.mcap_chunks import uncompressed, walk
from hil.recording.mcap_records import (
    FileBytes,
    parse_attachment,
    parse_channel,
    parse_chunk_header,
    parse_metadata,
    parse_schema,
    record_at,
)

PROVABLE = (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.SCHEMA, Opcode.CHANNEL)
"""Kinds of records that can prove themselves."""
_SEARCH_FACTOR, _SEARCH_FLOOR_BYTES = 8, 16 * 1024 * 1024
"""A search reads at most this multiple of the file, or at least the second value.

A file may be made of bytes that look like the beginning of records everywhere.
"""
_BLOCK_BYTES = 1024 * 1024


class RecordSearch:
    """Searches one file. The work of all searches together is bounded."""

    def __init__(self, file: FileBytes) -> None:
        self._file = file
        self._bytes_left = max(_SEARCH_FACTOR * file.size, _SEARCH_FLOOR_BYTES)

    def next_after(self, start: int) -> int | None:
        """Return the offset of the next record from ``start`` on that proves itself, None if none does."""
        for place in self._candidates(start):
            record = record_at(self._file, place)
            if record is None:
                continue
            if self._bytes_left < 0:
                return None
            self._bytes_left -= record.end - place
            if proves_itself(
                record.opcode, self._file.read(record.body_start, record.end - record.body_start)
            ):
                return place
        return None

    def _candidates(self, start: int) -> Iterator[int]:
        """Yield the offsets at which a provable record of less than 4 GB may begin."""
        size = RECORD_HEADER.size
        for begin in range(start, self._file.size, _BLOCK_BYTES):
            block = np.frombuffer(self._file.read(begin, _BLOCK_BYTES + size - 1), np.uint8)
            count = len(block) - size + 1
            if count <= 0:
                return
            may_begin = np.isin(block[:count], PROVABLE)
            for place in range(5, size):
                may_begin &= block[place : place + count] == 0
            yield from (begin + int(place) for place in np.flatnonzero(may_begin))


def proves_itself(opcode: int, body: bytes) -> bool:
    """Return True if ``body`` is that of a record of the kind ``opcode`` beyond doubt."""
    try:
        match opcode:
            case Opcode.CHUNK:
                header = parse_chunk_header(body)
                if header.data_start + header.data_size != len(body):
                    return False
                content = uncompressed(header, body[header.data_start :], check_crc=True)
                return bool(walk(content)) and header.crc != 0
            case Opcode.ATTACHMENT:
                return parse_attachment(body)[1] == len(body) and body[-4:] != bytes(4)
            case Opcode.METADATA:
                record, size = parse_metadata(body)
                return size == len(body) and record.name != ""
            case Opcode.SCHEMA:
                schema, size = parse_schema(body)
                return size == len(body) and schema.name != "" and schema.id != 0
            case Opcode.CHANNEL:
                channel, size = parse_channel(body)
                return size == len(body) and channel.topic != ""
    except (ValueError, struct.error):
        pass
    return False
