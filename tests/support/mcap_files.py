"""MCAP files for tests: their records one by one, damaged copies, and copies by another writer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import McapRecord
from mcap.writer import MCAP0_MAGIC, Writer

from hil.recording.handover import RECORD_HEADER


def records(content: bytes) -> list[tuple[int, int, int]]:
    """Return opcode, begin and end of each record."""
    found, start = [], len(MCAP0_MAGIC)
    while start + RECORD_HEADER.size < len(content):
        opcode, length = RECORD_HEADER.unpack_from(content, start)
        found.append((opcode, start, start + RECORD_HEADER.size + length))
        start = found[-1][2]
    return found


def chunk_starts(content: bytes) -> list[int]:
    return [start for opcode, start, _ in records(content) if opcode == Opcode.CHUNK]


def without_end(content: bytes) -> bytes:
    """Return the file as a crash after its last message index leaves it."""
    return content[: max(end for opcode, _, end in records(content) if opcode == Opcode.MESSAGE_INDEX)]


def without_crcs(content: bytes) -> bytes:
    """Return the file with the CRCs of data and summary set to 0, which means that there are none."""
    changed = bytearray(content)
    for opcode, start, end in records(content):
        if opcode == Opcode.DATA_END:
            changed[start + 9 : end] = bytes(4)
        if opcode == Opcode.FOOTER:
            changed[end - 4 : end] = bytes(4)
    return bytes(changed)


def record_bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def rewritten(
    source: Path,
    target: Path,
    options: dict[str, object],
    keep: Callable[[str, int], bool] = lambda topic, sequence: True,
) -> Path:
    """Copy a recording with the writer of the mcap package."""
    with source.open("rb") as original, target.open("wb") as stream:
        reader, writer = make_reader(original), Writer(stream, **options)  # type: ignore[arg-type]
        writer.start("ros2")
        for attachment in reader.iter_attachments():
            writer.add_attachment(
                attachment.create_time,
                attachment.log_time,
                attachment.name,
                attachment.media_type,
                attachment.data,
            )
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, "cdr", schema_id, channel.metadata
                )
            if keep(channel.topic, message.sequence):
                writer.add_message(
                    channels[channel.id],
                    message.log_time,
                    message.data,
                    message.publish_time,
                    message.sequence,
                )
        writer.finish()
    return target
