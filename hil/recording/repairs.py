"""Names damage of a file that costs no data, because a recovery makes the damaged parts again.

These are the magic bytes, stated lengths, message indexes, the summary, and the CRCs. A recovery that found
such damage must not claim that the file was whole.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

import numpy as np
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from hil.recording.handover import RECORD_HEADER
from hil.recording.mcap_chunks import indexed_messages
from hil.recording.mcap_records import FileBytes, record_at
from hil.recording.scan_result import Part, Scan

MAX_NAMED = 20
"""Number of damaged message indexes that are named one by one."""
_CRC_BYTES, _CRC_OFFSET_IN_FOOTER = 4, 16


class IndexCheck:
    """Compares the message indexes of the chunks with what a recovery makes of the chunks."""

    def __init__(self, file: FileBytes) -> None:
        self._file = file
        self.damaged: list[int] = []
        """Offsets of the chunks whose message indexes are damaged."""

    def add(self, part: Part, index: Mapping[int, Sequence[int]]) -> None:
        """Check the indexes after a chunk. ``index``: those made of it, as ``IndexedFile`` takes them."""
        if not part.place.is_chunk:
            return
        start = end = part.place.offset + part.place.length
        while (record := record_at(self._file, end)) is not None and record.opcode == Opcode.MESSAGE_INDEX:
            end = record.end
        if end == start:
            return  # Another program wrote the chunk without an index, or the file was cut off here.
        try:
            stated = indexed_messages(self._file.read(start, end - start))
        except (ValueError, struct.error):
            stated = {}
        is_equal = stated.keys() == index.keys() and all(
            np.array_equal(stated[channel].ravel(), np.array(pairs, np.uint64))
            for channel, pairs in index.items()
        )
        if not is_equal:
            self.damaged.append(part.place.offset)


def repairs(file: FileBytes, found: Scan, damaged_indexes: Sequence[int]) -> tuple[str, ...]:
    """Return what was damaged and is made again, in words.

    ``damaged_indexes``: offsets of the chunks whose message indexes are damaged.
    """
    named = []
    if file.read(0, len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        named.append("the magic bytes at the begin of the file")
    named += [f"the length of the chunk at byte {start}" for start in found.wrong_lengths[:MAX_NAMED]]
    named += [f"the message index of the chunk at byte {start}" for start in damaged_indexes[:MAX_NAMED]]
    unnamed = sum(max(len(places) - MAX_NAMED, 0) for places in (found.wrong_lengths, damaged_indexes))
    if unnamed:
        named.append(f"{unnamed} more lengths or message indexes")
    if found.data_end is None:
        return tuple(named)
    data_end = found.data_end
    if not found.has_end:
        named.append(f"the summary or the footer, from byte {data_end.end} on")
    elif not _crc_matches(file, data_end.end, _summary_crc_place(found)):
        named.append(f"the summary from byte {data_end.end} on, or its CRC")
    if not named and not found.losses and not _crc_matches(file, 0, data_end.body_start, data_end.start):
        named.append(
            f"a record's header or padding before byte {data_end.start}, or the CRC of the data: they do not "
            "match, though every record does that has a CRC of its own"
        )
    return tuple(named)


def _summary_crc_place(found: Scan) -> int:
    assert found.footer is not None
    return found.footer.start + RECORD_HEADER.size + _CRC_OFFSET_IN_FOOTER


def _crc_matches(file: FileBytes, start: int, crc_place: int, end: int | None = None) -> bool:
    """Return False if a CRC is stated that is not that of the bytes up to ``end``, or up to the CRC."""
    stated = int.from_bytes(file.read(crc_place, _CRC_BYTES), "little")
    return not stated or file.crc(start, crc_place if end is None else end) == stated
