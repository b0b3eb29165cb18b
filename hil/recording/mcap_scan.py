"""Walks through an MCAP file record by record, and goes on after damage.

A complete file with CRCs needs no walk (``mcap_reader``). In every other file, each chunk is uncompressed
once: its own CRC is checked, and its records are walked through. When a record is damaged, the walk goes on
at the next place where a record begins that proves itself: a chunk or an attachment whose CRC matches, or a
schema, a channel or a metadata record whose fields fill it exactly (``record_search``). What lies between is
a :class:`hil.recording.scan_result.Loss`.
"""

from __future__ import annotations

import struct

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.writer import MCAP0_MAGIC

from hil.recording.handover import RECORD_HEADER
from hil.recording.mcap_chunks import (
    Offsets,
    UnsupportedCompressionError,
    check_index,
    descriptions_in,
    log_times,
    sequences,
    uncompressed,
    walk,
)
from hil.recording.mcap_records import (
    SUMMARY_OPCODES,
    FileBytes,
    Record,
    parse_attachment,
    parse_channel,
    parse_chunk_header,
    parse_metadata,
    parse_schema,
    record_at,
)
from hil.recording.record_search import PROVABLE, RecordSearch, proves_itself
from hil.recording.scan_result import Loss, Part, Place, Scan

_LOOSE_BYTES = 1024 * 1024
"""Messages outside chunks are taken in portions of about this size."""
_AFTER_DATA = SUMMARY_OPCODES | {Opcode.SCHEMA, Opcode.CHANNEL}
_WITHOUT_DATA = SUMMARY_OPCODES | {Opcode.MESSAGE_INDEX, Opcode.DATA_END, MCAP0_MAGIC[0]}
"""First bytes of what can be cut off without a loss: a recovery makes it again."""
_CHUNK_HEADER_BYTES = 256
"""Size of the begin of a chunk that is read to see which time it covers."""


class _DamagedError(ValueError):
    """The record is damaged."""


def scan(file: FileBytes) -> Scan:
    """Walk through ``file``. Raises UnsupportedCompressionError, and RecordingError when reading fails."""
    return _Scanner(file).run()


class _Scanner:
    def __init__(self, file: FileBytes) -> None:
        self._file = file
        self._found = Scan()
        self._search = RecordSearch(file)

    def run(self) -> Scan:
        found, file = self._found, self._file
        start = len(MCAP0_MAGIC)
        while start < file.size and found.data_end is None:
            start = self._step(start)
        if found.data_end is not None:
            self._take_summary(start)
        elif not any(loss.is_tail for loss in found.losses):
            self._check_end()
        return found

    def _step(self, start: int) -> int:
        """Take the record at ``start``, or lose what lies up to the next one; return where to go on."""
        record = record_at(self._file, start)
        try:
            if record is None:
                return self._take_by_own_size(start) or self._break_off(start)
            if record.opcode == Opcode.MESSAGE:
                return self._take_loose(record)
            self._take(record)
            if record.opcode == Opcode.CHUNK:
                return self._end_of_chunk(record)
        except UnsupportedCompressionError:
            raise
        except (ValueError, struct.error) as error:
            return self._take_by_own_size(start) or self._lose(start, self._in_words(record, error))
        return record.end

    def _end_of_chunk(self, record: Record) -> int:
        """Return the end of a chunk: that of its data if a record begins there, otherwise the stated one.

        Padding may follow the data. A wrong length looks like padding, too.
        """
        header = parse_chunk_header(self._file.read(record.body_start, _CHUNK_HEADER_BYTES))
        end = record.body_start + header.data_start + header.data_size
        if end == record.end or end == self._file.size:
            return end
        following = record_at(self._file, end)
        if following is None or following.opcode not in _NAMES:
            return record.end
        self._found.wrong_lengths.append(record.start)
        return end

    def _take_by_own_size(self, start: int) -> int | None:
        """Take a chunk whose record states a wrong length, if it proves itself with the size of its data.

        Returns the offset after it; None if there is no such chunk.
        """
        content = self._file.read(start, _CHUNK_HEADER_BYTES)
        if content[:1] != bytes([Opcode.CHUNK]):
            return None
        try:
            header = parse_chunk_header(content[RECORD_HEADER.size :])
        except (ValueError, struct.error):
            return None
        end = start + RECORD_HEADER.size + header.data_start + header.data_size
        if end > self._file.size:
            return None
        record = Record(Opcode.CHUNK, start, end)
        body = self._body(record)
        if not proves_itself(Opcode.CHUNK, body):
            return None
        self._take_chunk(record, body)
        self._found.wrong_lengths.append(start)
        return end

    def _in_words(self, record: Record | None, error: Exception) -> str:
        if record is None or record.opcode not in _NAMES:
            return f"{error}"
        if record.opcode == Opcode.ATTACHMENT and str(error).startswith("the attachment"):
            return str(error)
        return f"the {_NAMES[record.opcode]} at byte {record.start} is damaged: {error}"

    def _break_off(self, start: int) -> int:
        """Take a record that is longer than the file for the end, if no record follows within it."""
        file, found = self._file, self._found
        following = self._search.next_after(start + 1)
        ends_whole = following is None and file.read(file.size - len(MCAP0_MAGIC), 8) == MCAP0_MAGIC
        if following is not None or (ends_whole and start + len(MCAP0_MAGIC) < file.size):
            return self._lose(start, "its records do not lead to its end", following)
        if file.read(start, 1)[0] not in _WITHOUT_DATA:
            found.losses.append(
                Loss(
                    start,
                    file.size,
                    "the file was cut off",
                    True,
                    len(found.parts),
                    file.read(start, 1)[0] in (Opcode.CHUNK, Opcode.MESSAGE),
                    self._span_at(start),
                )
            )
        return file.size

    def _span_at(self, start: int) -> tuple[int, int] | None:
        content = self._file.read(start, _CHUNK_HEADER_BYTES)
        if content[:1] != bytes([Opcode.CHUNK]):
            return None
        try:
            header = parse_chunk_header(content[RECORD_HEADER.size :])
        except (ValueError, struct.error):
            return None
        return header.start_ns, header.end_ns

    def _lose(self, start: int, reason: str, following: int | None = None) -> int:
        end = following or self._search.next_after(start + 1) or self._file.size
        found = self._found
        last = found.losses[-1] if found.losses else None
        if last is not None and last.end == start and last.parts_before == len(found.parts):
            found.losses[-1] = last._replace(end=end)
        else:
            found.losses.append(Loss(start, end, reason, False, len(found.parts)))
        return end

    def _take(self, record: Record) -> None:
        found = self._found
        body = self._body(record)
        match record.opcode:
            case Opcode.CHUNK:
                self._take_chunk(record, body)
            case Opcode.ATTACHMENT:
                found.attachments.append(parse_attachment(body)[0])
            case Opcode.METADATA:
                found.metadata.append(parse_metadata(body)[0])
            case Opcode.SCHEMA:
                self._describe(parse_schema(body)[0])
            case Opcode.CHANNEL:
                self._describe(parse_channel(body)[0])
            case Opcode.MESSAGE_INDEX:
                check_index(body)
            case Opcode.DATA_END:
                following = self._file.read(record.end, 1)
                if len(body) < 4 or (following and following[0] not in _AFTER_DATA):
                    raise _DamagedError("it does not stand at the end of the data")
                found.data_end = record
            case Opcode.HEADER:
                if record.start != len(MCAP0_MAGIC):
                    raise _DamagedError("it does not stand at the begin of the file")
            case opcode if opcode in SUMMARY_OPCODES:
                raise _DamagedError("it stands before the end of the data")
            case opcode:
                if opcode == 0 or self._is_disguised(record, body):
                    raise _DamagedError(f"the record at byte {record.start} has the unknown kind {opcode}")

    def _body(self, record: Record) -> bytes:
        return self._file.read(record.body_start, record.end - record.body_start)

    def _is_disguised(self, record: Record, body: bytes) -> bool:
        """Return True if a record of an unknown kind proves itself as a record of a known kind."""
        return any(proves_itself(opcode, body) for opcode in PROVABLE)

    def _take_chunk(self, record: Record, body: bytes) -> None:
        header = parse_chunk_header(body)
        data = body[header.data_start : header.data_start + header.data_size]
        if len(data) < header.data_size:
            raise _DamagedError("its data are longer than its record")
        content = uncompressed(header, data, check_crc=True)
        offsets = walk(content)
        place = Place(record.start, record.end - record.start, 0, header.start_ns, header.end_ns)
        self._take_messages(content, offsets, place)
        if content[:1] != bytes([Opcode.MESSAGE]) or not offsets.keys() <= self._found.channels.keys():
            for description in descriptions_in(content):
                self._describe(description)

    def _take_messages(self, content: bytes, offsets: Offsets, place: Place) -> None:
        if not offsets:
            return
        ordered = np.sort(np.concatenate(list(offsets.values())))
        times = log_times(content, ordered)
        start_ns, end_ns = int(times.min()), int(times.max())
        first, last = sequences(content, ordered[[0, -1]]).tolist()
        self._found.counts.update({channel: len(places) for channel, places in offsets.items()})
        self._found.parts.append(Part(place._replace(start_ns=start_ns, end_ns=end_ns), first, last))

    def _take_loose(self, first: Record) -> int:
        """Take the messages outside chunks that begin with ``first``; return the offset after them."""
        end, record = first.start, record_at(self._file, first.start)
        while record is not None and record.opcode == Opcode.MESSAGE and end - first.start < _LOOSE_BYTES:
            end = record.end
            record = record_at(self._file, end)
        content = self._file.read(first.start, end - first.start)
        offsets = walk(content)
        if not offsets.keys() <= self._found.channels.keys():
            raise _DamagedError("its channel is unknown")
        self._take_messages(content, offsets, Place(first.start, end - first.start, 0, 0, 0, is_chunk=False))
        return end

    def _describe(self, description: Schema | Channel) -> None:
        known: dict[int, Schema] | dict[int, Channel] = (
            self._found.schemas if isinstance(description, Schema) else self._found.channels
        )
        known.setdefault(description.id, description)  # type: ignore[arg-type]

    def _describe_unless_misnumbered(self, description: Schema | Channel) -> None:
        """Take a description of the summary, unless it is a known one under a number that nothing uses.

        Nothing but the whole summary's CRC protects its number, and two channels with one topic mislead.
        """
        found = self._found
        if isinstance(description, Schema):
            used = {channel.schema_id for channel in found.channels.values()}
            is_known = any(
                (known.name, known.data) == (description.name, description.data)
                for known in found.schemas.values()
            )
        else:
            used = set(found.counts)
            is_known = any(known.topic == description.topic for known in found.channels.values())
        if description.id in used or not is_known:
            self._describe(description)

    def _take_summary(self, start: int) -> None:
        """Take schemas and channels of the summary, and find out whether the file has its end."""
        found, file = self._found, self._file
        while (record := record_at(file, start)) is not None:
            try:
                if record.opcode == Opcode.SCHEMA:
                    self._describe_unless_misnumbered(parse_schema(self._body(record))[0])
                elif record.opcode == Opcode.CHANNEL:
                    self._describe_unless_misnumbered(parse_channel(self._body(record))[0])
                elif record.opcode == Opcode.FOOTER:
                    found.footer = record
            except ValueError:
                break
            start = record.end
            if found.footer is not None:
                break
        found.has_end = found.footer is not None and file.read(start, file.size) == MCAP0_MAGIC
        if not found.has_end:
            self._check_end()

    def _check_end(self) -> None:
        """Note a loss if the file ends as a whole one does, or with other bytes after its footer."""
        file, found = self._file, self._found
        if any(loss.end == file.size for loss in found.losses):
            return
        rest = file.read(found.footer.end, file.size) if found.footer is not None else b""
        has_magic = file.size > len(MCAP0_MAGIC) and file.read(file.size - 8, 8) == MCAP0_MAGIC
        if (has_magic and found.data_end is not None) or not MCAP0_MAGIC.startswith(rest):
            start = found.data_end.end if found.data_end is not None else file.size
            reason = "its records do not lead to its end"
            found.losses.append(Loss(start, file.size, reason, False, len(found.parts)))


_NAMES = {opcode.value: opcode.name.lower().replace("_", " ") for opcode in Opcode}
