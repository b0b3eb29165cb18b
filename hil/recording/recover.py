"""Saves what is whole in a recording that was cut off or damaged, as a new file with an index.

Chunks are copied as they are, once their CRC has matched. The result is a complete MCAP file. Its metadata
``recovery`` say from which file it comes and what is missing, so that a replay is not taken for that of the
whole run.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC

from hil import __version__
from hil.core.errors import DocumentError, RecordingError, RecordingExistsError
from hil.core.rig import read_rig
from hil.recording.handover import MESSAGE_OPCODE, RECORD_HEADER, SEQUENCE_MASK
from hil.recording.indexed_file import IndexedFile, record_bytes
from hil.recording.lost_metadata import restore_recording
from hil.recording.mcap_chunks import UnsupportedCompressionError, message_index, uncompressed
from hil.recording.mcap_records import FileBytes, parse_chunk_header
from hil.recording.mcap_scan import scan
from hil.recording.mcap_writer import described_channels
from hil.recording.metadata_digests import DIGESTS, END_DIGESTS, damaged_metadata, with_digests
from hil.recording.repairs import IndexCheck, repairs
from hil.recording.scan_result import NO_DATA, Loss, Part, Place, Scan

_NS_PER_MS = 1_000_000
RECOVERY = "recovery"
"""Name of the metadata of a saved recording."""


class LostPart(NamedTuple):
    """Bytes of the damaged file that are not in the new one."""

    start: int
    """Offset of the first lost byte."""
    size: int
    """Number of lost bytes."""
    reason: str
    messages: int | None
    """Number of lost messages by the sequence numbers around them; None if no message follows."""
    from_ns: int | None
    """Log time of the last message before the loss, in epoch ns; None if there is none."""
    to_ns: int | None
    """Log time of the first message after the loss, or of the last in a cut-off chunk; None if unknown."""

    @property
    def duration_ms(self) -> float | None:
        """Time between the messages around the loss, in ms; None if one of them is unknown."""
        if self.from_ns is None or self.to_ns is None:
            return None
        return max(self.to_ns - self.from_ns, 0) / _NS_PER_MS


class Recovery(NamedTuple):
    """Result of saving a recording."""

    path: Path
    """The new file."""
    messages: int
    """Number of messages in it."""
    span_ns: tuple[int, int]
    """First and last log time in it, in epoch ns."""
    lost: tuple[LostPart, ...]
    was_complete: bool
    """True if the file had its end."""
    rebuilt_channels: bool
    """True if the descriptions of the channels were lost, and were made again from the rig file."""
    restored_metadata: bool
    """True if the metadata ``recording`` were lost, and were made again from the messages."""
    repaired: tuple[str, ...]
    """What was damaged without a loss of data and is whole in the new file, in words."""


def recover(source: Path, output: Path) -> Recovery:
    """Write what is whole in ``source`` to the new file ``output``.

    Raises RecordingExistsError when ``output`` exists, and RecordingError when nothing in ``source`` is
    usable or a file cannot be read or written; ``output`` does not exist then.
    """
    file = FileBytes(source)
    try:
        found = scan(file)
    except UnsupportedCompressionError as error:
        raise RecordingError(f"{source}: {error}") from None
    rebuilt = _describe_channels(found)
    unknown = found.counts.keys() - found.channels.keys()
    lost = (*_lost_parts(found), *_changed_metadata(found))
    if not found.parts:
        raise RecordingError(f"{source}: {_no_message(file, found)}")
    if unknown:
        raise RecordingError(
            f"{source}: nothing can be saved: the descriptions of its channels are lost, and its rig file too"
        )
    restored = restore_recording(found, lambda part: _chunk_at(file, part.place)[1])
    indexes = IndexCheck(file)
    messages = _written(output, lambda write: _copy(file, found, lost, indexes, write))
    return Recovery(
        output,
        messages,
        (min(p.place.start_ns for p in found.parts), max(p.place.end_ns for p in found.parts)),
        lost,
        found.has_end,
        rebuilt,
        restored,
        repairs(file, found, indexes.damaged),
    )


def _no_message(file: FileBytes, found: Scan) -> str:
    """Return why a file without a whole message cannot be saved."""
    begin = file.read(0, len(MCAP0_MAGIC))
    if not MCAP0_MAGIC.startswith(begin):
        return "nothing can be saved: it is not an MCAP file, and no chunk with a matching CRC is in it"
    return NO_DATA if found.was_cut_off_before_data else "nothing can be saved: no message in it is whole"


def _lost_parts(found: Scan) -> tuple[LostPart, ...]:
    data_end = None if found.data_end is None else found.data_end.end
    of_data = [loss for loss in found.losses if data_end is None or loss.start < data_end]
    return tuple(_lost_part(found.parts, loss) for loss in of_data)


def _changed_metadata(found: Scan) -> list[LostPart]:
    """Return a part without bytes for each metadata record that is not as it was recorded."""
    names = damaged_metadata({record.name: record.metadata for record in found.metadata})
    return [
        LostPart(0, 0, f"metadata {name}: not as recorded, or missing, by their SHA-256", 0, None, None)
        for name in names
    ]


def _lost_part(parts: Sequence[Part], loss: Loss) -> LostPart:
    before = parts[loss.parts_before - 1] if loss.parts_before else None
    after = parts[loss.parts_before] if loss.parts_before < len(parts) else None
    from_ns = None if before is None else before.place.end_ns
    to_ns = None if after is None else after.place.start_ns
    messages = None
    if after is not None:
        last = before.last_sequence if before is not None else 0
        messages = (after.first_sequence - last - 1) & SEQUENCE_MASK
    elif not loss.has_messages:
        messages = 0
    elif loss.span_ns is not None and (from_ns is None or from_ns <= loss.span_ns[1]):
        from_ns, to_ns = (loss.span_ns[0] if from_ns is None else from_ns), loss.span_ns[1]
    return LostPart(loss.start, loss.end - loss.start, loss.reason, messages, from_ns, to_ns)


def _describe_channels(found: Scan) -> bool:
    """Make the descriptions of the channels from the rig file, if the file has lost them.

    They stand in the first chunk and in the summary. Returns True if they were made.
    """
    known = {number for number, channel in found.channels.items() if channel.schema_id in found.schemas}
    if found.counts.keys() <= known:
        return False
    rig = next((a.data for a in found.attachments if a.name == "rig.toml"), None)
    own = next((m.metadata for m in found.metadata if m.name == "recording"), {})
    if rig is None:
        return False
    try:
        axes = read_rig(rig.decode(), "rig.toml").axes
    except (DocumentError, UnicodeDecodeError):
        return False
    units = [(name, axis.unit) for name, axis in axes.items()]
    schemas, channels = described_channels(units, own.get("stamp_origin", ""))
    found.schemas = {schema.id: schema for schema in schemas}
    found.channels = {channel.id: channel for channel in channels}
    return True


def _written(output: Path, write_all: Callable[[Callable[[bytes], object]], int]) -> int:
    """Create ``output`` and let ``write_all`` fill it; a file that could not be filled is removed."""
    try:
        descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    except FileExistsError:
        raise RecordingExistsError(f"{output}: exists already; choose another name with -o") from None
    except OSError as error:
        raise RecordingError(f"{output}: cannot be created: {error.strerror}") from None
    try:
        with os.fdopen(descriptor, "wb") as stream:
            return write_all(stream.write)
    except BaseException as error:
        with suppress(OSError):
            output.unlink()
        if isinstance(error, OSError):
            raise RecordingError(f"{output}: cannot be written: {error.strerror}") from None
        raise


def _copy(
    file: FileBytes,
    found: Scan,
    lost: Sequence[LostPart],
    indexes: IndexCheck,
    write: Callable[[bytes], object],
) -> int:
    """Write the new file; return the number of messages in it."""
    new = IndexedFile(write, f"pneumatic-hil {__version__}")
    for attachment in found.attachments:
        new.add_attachment(attachment)
    new.add_metadata(_new_metadata(file.path, found, lost))
    schemas, channels = list(found.schemas.values()), list(found.channels.values())
    for number, part in enumerate(found.parts):
        chunk, body = _chunk_at(file, part.place)
        index = message_index(body)
        indexes.add(part, index)
        if number == 0 and body[0] == MESSAGE_OPCODE:
            chunk, body = _new_chunk(record_bytes([*schemas, *channels]) + body, part.place)
            index = message_index(body)
        new.add_chunk(chunk, index)
    new.finish(schemas, channels)
    return new.message_count


def _chunk_at(file: FileBytes, place: Place) -> tuple[Chunk, bytes]:
    """Return a chunk of the file, and its content. Messages outside chunks become a chunk."""
    record = file.read(place.offset, place.length)
    if not place.is_chunk:
        return _new_chunk(record, place)
    body = record[RECORD_HEADER.size :]
    header = parse_chunk_header(body)
    data = body[header.data_start : header.data_start + header.data_size]
    content = uncompressed(header, data, check_crc=True)
    crc = header.crc or zlib.crc32(content)
    return Chunk(header.compression, data, place.end_ns, place.start_ns, crc, len(content)), content


def _new_chunk(content: bytes, place: Place) -> tuple[Chunk, bytes]:
    """Return an uncompressed chunk that holds ``content``, and ``content``."""
    return Chunk("", content, place.end_ns, place.start_ns, zlib.crc32(content), len(content)), content


def _new_metadata(source: Path, found: Scan, lost: Sequence[LostPart]) -> dict[str, Mapping[str, str]]:
    """Return the metadata of the new file: those of the old one, what is lost, and new digests."""
    kept = {
        record.name: record.metadata
        for record in found.metadata
        if record.name not in (DIGESTS, END_DIGESTS, RECOVERY)
    }
    return with_digests({**kept, RECOVERY: _recovery_metadata(source, found, lost)}, DIGESTS)


def _recovery_metadata(source: Path, found: Scan, lost: Sequence[LostPart]) -> dict[str, str]:
    messages = [part.messages for part in lost]
    known = sum(count for count in messages if count is not None)
    return {
        "file": source.name,
        "complete": "yes" if found.has_end and not lost else "no",
        "bytes lost": str(sum(part.size for part in lost)),
        "messages lost": f"{known} or more" if None in messages else str(known),
        "damaged metadata": ", ".join(part.reason for part in lost if part.size == 0),
        "hil": __version__,
    }
