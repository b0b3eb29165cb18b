"""What crosses from the loop to the recorder process: blocks of a kind, a length and that many bytes.

A header block (:class:`RunHeader`), batches of message records exactly as they stand in an MCAP chunk, and an
end block (metadata); the first and the last encoded by msgspec. Nothing here knows a pipe or a file.
"""

from __future__ import annotations

import struct

import msgspec

BLOCK_HEADER = struct.Struct("<cI")
HEADER, BATCH, END = b"H", b"B", b"E"
LOSSLESS, REAL_TIME = "lossless", "real-time"
"""What the recorder process is started as: chunks end by recorded time alone, or by the clock too."""

MESSAGE_OPCODE = 5
MESSAGE_HEADER = struct.Struct("<11sIQQ")
"""A message record up to its data: :func:`message_prefix`; sequence; log time; publish time."""
SEQUENCE_MASK = 0xFFFF_FFFF
"""Sequences count all messages of a run from 1; after this, 71 days at 700 a second, follows 0."""
RECORD_HEADER = struct.Struct("<BQ")
"""Opcode and length, which stand before every record."""
_INDEXED = struct.Struct("<BQHIQ")
"""A message record up to its log time."""


class RunHeader(msgspec.Struct, frozen=True):
    """What is known when a run starts; all of it is in the file before the first message."""

    epoch_offset_ns: int
    """Epoch time minus monotonic time, constant for the file. Log times are epoch nanoseconds."""
    bus: str
    """Name of the bus; ``frame_id`` of every frame."""
    stamp_origin: str
    """Where receive stamps come from: hardware, kernel, user, or simulated time."""
    axes: tuple[tuple[str, str], ...]
    """(name, unit) in the rig file's order."""
    attachments: dict[str, tuple[str, bytes]] = {}
    """Name to (media type, content): rig file, DBC, controller files, setpoint files."""
    metadata: dict[str, dict[str, str]] = {}
    """Name to entries: versions, granted rights, setpoints…"""


def message_prefix(channel: int, payload_size: int) -> bytes:
    """Opcode, length and channel id of a message record."""
    length = MESSAGE_HEADER.size - RECORD_HEADER.size + payload_size
    return struct.pack("<BQH", MESSAGE_OPCODE, length, channel)


def index_messages(records: bytes | bytearray | memoryview, start: int = 0) -> dict[int, list[int]]:
    """Where the messages are among ``records``, from byte ``start`` on.

    Returns channel id to [log time, offset, log time, offset…] in file order, as MCAP indexes messages.
    """
    index: dict[int, list[int]] = {}
    end = len(records)
    unpack_from = _INDEXED.unpack_from
    while start < end:
        opcode, length, channel, _, log_time = unpack_from(records, start)
        if opcode == MESSAGE_OPCODE:
            if channel in index:
                index[channel] += (log_time, start)
            else:
                index[channel] = [log_time, start]
        start += RECORD_HEADER.size + length
    return index


def log_time_of_first(records: bytes) -> int:
    """Log time of the first message."""
    log_time: int = _INDEXED.unpack_from(records)[-1]
    return log_time
