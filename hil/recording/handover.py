"""Format of the data that the loop hands over to the recorder process: a sequence of blocks.

A block is a kind, a length and that many bytes. The first block is the header (:class:`RunHeader`), the last
one is the end (metadata); msgspec encodes both. Between them are batches of message records, in the bytes
that they have in an MCAP chunk. After the end, another file may begin. This module uses no pipe and no file.

The recorder process answers on its standard error, one line each: how far the file is (:class:`Progress`), or
the reason why it cannot be written.
"""

from __future__ import annotations

import hashlib
import json
import struct
from typing import Any, NamedTuple

import msgspec

from hil.recording.rotation_names import AFTER_PAUSE, PART

BLOCK_HEADER = struct.Struct("<cI")
HEADER, BATCH, END, NEXT = b"H", b"B", b"E", b"N"
"""Kinds of blocks. HEADER begins the contents of the first file, and END finishes a file. NEXT
(:class:`NextFile`) opens another file and begins its contents."""
LOSSLESS, REAL_TIME = "lossless", "real-time"
"""Argument of the recorder process. In real time, a chunk also ends when no block has come for a while."""

MESSAGE_OPCODE = 5
MESSAGE_HEADER = struct.Struct("<11sIQQ")
"""Message record up to its data: :func:`message_prefix`, sequence, log time, publish time."""
SEQUENCE_MASK = 0xFFFF_FFFF
"""Largest sequence number; 0 follows it. Sequence numbers count the messages of a file from 1.

At 700 messages a second, the numbers last for 71 days.
"""
RECORD_HEADER = struct.Struct("<BQ")
"""Header of every MCAP record: opcode and length of the rest."""
_UP_TO_LOG_TIME = struct.Struct("<BQHIQ")
"""Message record up to its log time: opcode, length, channel, sequence, log time."""


class RunHeader(msgspec.Struct, frozen=True):
    """Data that is known when a run starts. All of it is in the file before the first message."""

    epoch_offset_ns: int
    """Epoch time minus monotonic time in ns, constant for the file. Log times are epoch time in ns."""
    bus: str
    """Name of the bus. It is the ``frame_id`` of every frame."""
    stamp_origin: str
    """Origin of the receive stamps: hardware, kernel, user, or simulated."""
    axes: tuple[tuple[str, str], ...]
    """Name and unit of each axis, in the rig file's order."""
    attachments: dict[str, tuple[str, bytes]] = {}
    """Media type and content of each document, by its name: rig file, DBC, controller and setpoint files."""
    metadata: dict[str, dict[str, str]] = {}
    """Entries of each metadata record, by its name: versions, setpoints, hashes of the documents."""
    began_ns: int = 0
    """Time at which the run began, in epoch ns; 0: ``epoch_offset_ns``. The attachments have this time."""


class NextFile(msgspec.Struct, frozen=True):
    """File that follows on the one that was ended. Its header is :func:`next_header`."""

    path: str
    """Its path. It must not exist."""
    part: int
    """Number of the file in the run; the first file has 1."""
    is_after_pause: bool = False
    """True if nothing was recorded between the two files for a while."""
    remove: tuple[str, ...] = ()
    """Files that are removed first, to make room."""
    attachments: dict[str, tuple[str, bytes]] = {}
    """Media type and content of each document that the first file does not have, by its name."""
    states: dict[str, dict[str, Any]] = {}
    """Plain values of each further document, by its name. They are written as JSON."""


def next_header(first: RunHeader, file: NextFile) -> RunHeader:
    """Return the header of a further file: that of the first one, with the documents of ``file``.

    This takes about a millisecond. Therefore the recorder process does it, and not the loop.
    """
    added = dict(file.attachments)
    for name, state in file.states.items():
        text = json.dumps(state, allow_nan=False, separators=(",", ":"))
        added[name] = ("application/json", text.encode())
    digests = {name: hashlib.sha256(content).hexdigest() for name, (_, content) in added.items()}
    own = {PART: str(file.part)} | ({AFTER_PAUSE: "yes"} if file.is_after_pause else {})
    return msgspec.structs.replace(
        first,
        attachments={**first.attachments, **added},
        metadata={
            **first.metadata,
            "recording": {**first.metadata["recording"], **own},
            "documents": {**first.metadata.get("documents", {}), **digests},
        },
    )


class Progress(NamedTuple):
    """How far the recorder process is with its file."""

    written_bytes: int
    """Bytes of the present file."""
    free_bytes: int
    """Free space of its file system, in bytes."""


FAILED = "failed: "
"""Beginning of the line with which the recorder process reports that it cannot write its file."""
_PROGRESS = "progress: "


def progress_line(progress: Progress) -> str:
    """Return the line that reports progress."""
    return f"{_PROGRESS}{progress.written_bytes} {progress.free_bytes}"


def read_progress(line: str) -> Progress | None:
    """Return the progress that a line reports, or None for any other line."""
    if not line.startswith(_PROGRESS):
        return None
    written, free = line.removeprefix(_PROGRESS).split()
    return Progress(int(written), int(free))


def message_prefix(channel: int, payload_size: int) -> bytes:
    """Return the first bytes of a message record: opcode, length and channel id."""
    length = MESSAGE_HEADER.size - RECORD_HEADER.size + payload_size
    return struct.pack("<BQH", MESSAGE_OPCODE, length, channel)


def index_messages(records: bytes | bytearray | memoryview, start: int = 0) -> dict[int, list[int]]:
    """Find the messages among ``records``, from byte ``start`` on.

    Returns, for each channel id, [log time, offset, log time, offset…] in file order, as in an MCAP index.
    """
    index: dict[int, list[int]] = {}
    end = len(records)
    unpack_from = _UP_TO_LOG_TIME.unpack_from
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
    """Return the log time of the first message, in epoch ns."""
    log_time: int = _UP_TO_LOG_TIME.unpack_from(records)[-1]
    return log_time
