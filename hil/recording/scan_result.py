"""What a walk through an MCAP file finds: its records, and what is lost."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.records import Attachment, Channel, Metadata, Schema

from hil.recording.mcap_records import Record

NO_DATA = (
    "was cut off before its first period: it holds no data. If its run has just begun, try again in a "
    "second; otherwise remove the file, because nothing in it can be saved"
)
"""Message about a recording that ends before its first chunk. The file's name stands before it."""


class Place(NamedTuple):
    """Place of a chunk in the file, or of messages outside chunks."""

    offset: int
    length: int
    """Size of the chunk record with its header, or of the messages, in bytes."""
    index_length: int
    """Size of the message indexes after the chunk that can be relied on, in bytes; 0: there are none."""
    start_ns: int
    """Smallest log time of the messages, in epoch ns."""
    end_ns: int
    """Largest log time of the messages, in epoch ns."""
    is_chunk: bool = True


class Part(NamedTuple):
    """A chunk, or messages outside chunks, that the walk has read."""

    place: Place
    first_sequence: int
    last_sequence: int


class Loss(NamedTuple):
    """Bytes of the file that hold no readable record."""

    start: int
    end: int
    reason: str
    is_tail: bool
    """True if the file was cut off here: the last record is longer than the file."""
    parts_before: int
    """Number of parts that were read before it."""
    has_messages: bool = True
    """False if the lost record is of a kind that holds no messages."""
    span_ns: tuple[int, int] | None = None
    """First and last log time of a cut-off chunk, as its header states them; None if that is unknown."""


@dataclass
class Scan:
    """What is readable in a file."""

    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    """Schemas by id."""
    channels: dict[int, Channel] = field(default_factory=dict)
    """Channels by id."""
    parts: list[Part] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    """Number of messages, by channel id."""
    losses: list[Loss] = field(default_factory=list)
    wrong_lengths: list[int] = field(default_factory=list)
    """Offsets of chunk records that state a wrong length, and were read by the size of their data."""
    data_end: Record | None = None
    footer: Record | None = None
    has_end: bool = False
    """True if footer and magic bytes follow the data where they should."""

    @property
    def was_cut_off_before_data(self) -> bool:
        """True if the file holds no message because it was cut off, and not because it was damaged."""
        return not (self.parts or self.has_end) and all(loss.is_tail for loss in self.losses)
