"""Uncompresses the chunks of an MCAP file within bounded memory, and finds the messages in them."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from importlib import import_module
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from hil.recording.handover import MESSAGE_HEADER, MESSAGE_OPCODE, RECORD_HEADER
from hil.recording.mcap_records import ChunkHeader, parse_channel, parse_schema, records_in

Offsets: TypeAlias = dict[int, npt.NDArray[np.int64]]
"""Offsets of the message records in an uncompressed chunk, in ascending order, by channel id."""

MAX_CHUNK_BYTES = 64 * 1024 * 1024
"""Largest chunk that is uncompressed: a damaged or hostile file may state any size."""
MAX_CHUNK_RATIO = 1000
"""Largest size of a chunk's content as a multiple of its compressed size, for chunks above 256 KiB.

Recorded signals compress to a fifth. A file that exceeds this ratio was made to exhaust memory or time.
"""
_ALWAYS_ACCEPTED_BYTES = 256 * 1024
_SCHEMA, _CHANNEL = Opcode.SCHEMA.value, Opcode.CHANNEL.value
_FIRST_PRIVATE_OPCODE = 0x80
_INDEX_HEADER = struct.Struct("<HI")
"""Message index up to its entries: channel id, size of the entries (log time and offset, 8 bytes each)."""
_INDEX_RECORD = struct.Struct("<BQHI")
"""Message index record up to its entries: opcode, length, channel id, size of the entries."""
_LOG_TIME_OFFSET, _SEQUENCE_OFFSET = 15, 11
_UP_TO_CHANNEL = struct.Struct("<BQH")
_MIN_MESSAGE_BYTES = MESSAGE_HEADER.size - RECORD_HEADER.size


class UnsupportedCompressionError(ValueError):
    """A chunk is compressed in a way that this installation cannot read."""


def uncompressed(header: ChunkHeader, data: bytes, check_crc: bool) -> bytes:
    """Return the content of a chunk from its header and compressed ``data``. Raises ValueError."""
    _check_size(header.uncompressed_size, len(data))
    match header.compression:
        case "":
            body = data
        case "zstd":
            body = _uncompressed_zstd(data, header.uncompressed_size)
        case "lz4":
            body = _uncompressed_lz4(data, header.uncompressed_size)
        case other:
            raise UnsupportedCompressionError(
                f"its chunks are compressed with {other!r}; only zstd and lz4 can be read"
            )
    if len(body) != header.uncompressed_size:
        raise ValueError(f"it has {len(body)} bytes and states {header.uncompressed_size}")
    if check_crc and header.crc and zlib.crc32(body) != header.crc:
        raise ValueError("its CRC does not match its content")
    return body


def _check_size(stated: int, compressed: int) -> None:
    limit = min(MAX_CHUNK_BYTES, max(_ALWAYS_ACCEPTED_BYTES, MAX_CHUNK_RATIO * compressed))
    if stated > limit:
        raise ValueError(f"it states {stated} bytes, limit {limit}")


def _uncompressed_zstd(data: bytes, size: int) -> bytes:
    try:
        stated = zstandard.frame_content_size(data)
        if stated > 0:
            _check_size(stated, len(data))
        return _ZSTD.decompress(data, size)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from None


_ZSTD = zstandard.ZstdDecompressor()


def _uncompressed_lz4(data: bytes, size: int) -> bytes:
    try:
        lz4 = import_module("lz4.frame")
    except ImportError:
        raise UnsupportedCompressionError(
            "its chunks are compressed with lz4, and the package lz4 is not installed: pip install lz4"
        ) from None
    try:
        body: bytes = lz4.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    except RuntimeError as error:
        raise ValueError(str(error)) from None
    return body


def walk(body: bytes) -> Offsets:
    """Find the messages of a chunk without an index. Raises ValueError when it is no sequence of records."""
    index: dict[int, list[int]] = {}
    start, last_start = 0, len(body) - _UP_TO_CHANNEL.size
    unpack_from = _UP_TO_CHANNEL.unpack_from
    while start <= last_start:
        opcode, length, channel = unpack_from(body, start)
        if opcode == MESSAGE_OPCODE:
            if length < _MIN_MESSAGE_BYTES:
                raise ValueError("a message is shorter than its header")
            if channel in index:
                index[channel].append(start)
            else:
                index[channel] = [start]
        elif opcode not in (_SCHEMA, _CHANNEL) and opcode < _FIRST_PRIVATE_OPCODE:
            raise ValueError(f"a record has the kind {opcode}, which no chunk may hold")
        start += RECORD_HEADER.size + length
    if start != len(body):
        raise ValueError("a record is cut off")
    return {channel: np.array(offsets, np.int64) for channel, offsets in index.items()}


def log_times(body: bytes, offsets: npt.NDArray[np.int64]) -> npt.NDArray[np.uint64]:
    """Return the log times (epoch ns) of the message records at ``offsets``."""
    return _numbers(body, offsets, _LOG_TIME_OFFSET, "<u8")


def sequences(body: bytes, offsets: npt.NDArray[np.int64]) -> npt.NDArray[np.uint32]:
    """Return the sequence numbers of the message records at ``offsets``."""
    return _numbers(body, offsets, _SEQUENCE_OFFSET, "<u4")


def _numbers(body: bytes, offsets: npt.NDArray[np.int64], place: int, kind: str) -> npt.NDArray[Any]:
    """Return the numbers that stand ``place`` bytes after each offset."""
    size = np.dtype(kind).itemsize
    content = np.frombuffer(body, np.uint8)[place:]
    shape = (max(len(content) - size + 1, 0), size)
    at_every_offset = np.lib.stride_tricks.as_strided(content, shape, (1, 1))
    return np.ascontiguousarray(at_every_offset[offsets]).view(kind)[:, 0]


def message_index(body: bytes) -> dict[int, list[int]]:
    """Return log time, offset, log time, offset… of the messages of a chunk, by channel id.

    Raises ValueError when it is no sequence of records.
    """
    index = {}
    for channel, offsets in walk(body).items():
        pairs = np.stack([log_times(body, offsets).astype(np.int64), offsets], axis=1)
        index[channel] = [int(value) for value in pairs.ravel()]
    return index


def offsets_in_index(records: bytes, channel: int | None = None) -> Offsets:
    """Return the offsets that message index ``records`` list, of one channel or of all.

    Raises ValueError or struct.error.
    """
    found: Offsets = {}
    start, end = 0, len(records)
    unpack_from = _INDEX_RECORD.unpack_from
    while start < end:
        _, length, number, entries_size = unpack_from(records, start)
        if entries_size and (channel is None or channel == number):
            entries = np.frombuffer(records, "<i8", entries_size // 8, start + _INDEX_RECORD.size)
            found[number] = np.sort(entries[1::2])
            if number == channel:
                break
        start += RECORD_HEADER.size + length
    return found


def indexed_messages(records: bytes) -> dict[int, npt.NDArray[np.uint64]]:
    """Return what message index ``records`` list, by channel id, in the order of the offsets.

    Each array has log time and offset of a message in a row. Raises ValueError or struct.error.
    """
    found = {}
    for _, body in records_in(records):
        number, size = _INDEX_HEADER.unpack_from(body)
        if size:
            entries = np.frombuffer(body, "<u8", size // 8, _INDEX_HEADER.size).reshape(-1, 2)
            found[number] = entries[np.argsort(entries[:, 1], kind="stable")]
    return found


def check_index(body: bytes) -> None:
    """Check the form of a message index record. Raises ValueError or struct.error."""
    _, size = _INDEX_HEADER.unpack_from(body)
    if size % 16 or size > len(body) - _INDEX_HEADER.size:
        raise ValueError("the size of its entries is wrong")


def descriptions_in(body: bytes) -> Iterator[Schema | Channel]:
    """Yield the schemas and channels among the records of a chunk. Raises ValueError."""
    for opcode, content in records_in(body):
        if opcode == Opcode.SCHEMA:
            yield parse_schema(content)[0]
        elif opcode == Opcode.CHANNEL:
            yield parse_channel(content)[0]
