"""Reads the entries of a recording in the order in which they were recorded, and finds missing messages."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from itertools import chain
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil.core.errors import RecordingError
from hil.recording.entries import Decoder, Entry, Logged, Message, decoder_of, log_entry_of
from hil.recording.entry_columns import Maker, maker_of
from hil.recording.handover import RECORD_HEADER, SEQUENCE_MASK
from hil.recording.mcap_chunks import Offsets, sequences
from hil.recording.mcap_reader import DEFINITION_ERRORS, McapContents
from hil.recording.rotation_names import AFTER_PAUSE
from hil.recording.schemas import LOG_TOPIC, RECEIVED_TOPIC, REFUSED_TOPIC, SENT_TOPIC

_MESSAGE_FIELDS = struct.Struct("<BQHIQQ")
"""Message record up to its data: opcode, length, channel, sequence, log time, publish time."""
_DECODING_ERRORS = (ValueError, IndexError, TypeError, struct.error)
"""Exceptions of a decoder when the message is not what its topic and definition say."""
_FIRST_SEQUENCE = 1
_JOINED_BYTES = 512 * 1024
"""Size of the chunks that are decoded at once. A small one costs more calls of numpy than it saves memory."""
_BUS_TOPICS = frozenset({RECEIVED_TOPIC, SENT_TOPIC, REFUSED_TOPIC})
"""Topics whose messages name the bus."""
_Decoded = TypeVar("_Decoded")


class EntryReader:
    """Reads the entries of one file. ``bus`` and ``epoch_offset_ns`` are those of its metadata."""

    def __init__(self, file: McapContents, bus: str, epoch_offset_ns: int) -> None:
        self._file = file
        self._bus = bus
        self._epoch_offset_ns = epoch_offset_ns

    def entries(self, is_continued: bool = False) -> Iterator[Entry]:
        """Yield all entries in their order.

        ``is_continued`` is True for a file that follows on another one of its run. Raises RecordingError
        where messages are missing, since the following entries cannot be replayed.
        """
        own = self._file.metadata.get("recording", {})
        if is_continued and AFTER_PAUSE in own:
            raise RecordingError(
                f"{self._file.path}: the recording was stopped before this file, so it cannot be replayed "
                "together with the files before it; replay the files one by one"
            )
        chunk_entries = self._chunk_decoder()
        expected = _FIRST_SEQUENCE
        for body, offsets in _joined(self._file.chunks()):
            ordered = np.concatenate(list(offsets.values()))
            order = np.argsort(ordered, kind="stable")
            found = sequences(body, ordered[order])
            wanted = (np.arange(expected, expected + len(found)) & SEQUENCE_MASK).astype(found.dtype)
            gaps = np.flatnonzero(found != wanted)
            count = int(gaps[0]) if len(gaps) else len(found)
            yield from chunk_entries(body, offsets, order[:count].tolist())
            if len(gaps):
                missing = (int(found[count]) - int(wanted[count])) & SEQUENCE_MASK
                raise self._missing(missing, body, int(ordered[order[count]]))
            expected = (expected + len(found)) & SEQUENCE_MASK
        dropped = messages_dropped(self._file.metadata)
        if dropped:
            raise RecordingError(
                f"{self._file.path}: {dropped} messages after the last one were dropped while recording"
            )

    def log(self) -> Iterator[Logged]:
        """Yield the log entries."""
        for message in self._messages(LOG_TOPIC):
            yield self._decoded(log_entry_of, message)

    def check_count(self) -> None:
        """Compare the number of messages with what the recorder states at the end of the file.

        No gap in the sequence shows messages that are missing after the last one. Raises RecordingError.
        """
        stated = self._file.metadata.get("recorder", {}).get("messages", "")
        found = sum(self._file.counts.values())
        if self._is_complete and stated.isdecimal() and found < int(stated):
            raise RecordingError(
                f"{self._file.path}: {int(stated) - found} messages were removed by another program: the "
                f"recorder wrote {stated}, and the file has {found}"
            )

    @property
    def _is_complete(self) -> bool:
        return is_complete(self._file.is_complete, self._file.metadata)

    def _chunk_decoder(self) -> Callable[[bytes, Offsets, list[int]], Iterator[Entry]]:
        """Return the function that yields the entries of a chunk.

        Its arguments are the chunk, the offsets of its messages by channel, and the order in which the
        messages are wanted, as places in the concatenation of these offsets.
        """
        topics = {channel.id: topic for topic, channel in self._file.channels.items()}
        decoders = {number: self._decoder_of(topic) for number, topic in topics.items()}
        makers = {
            number: (topic, maker_of(topic, self._epoch_offset_ns))
            for number, topic in topics.items()
            if decoders[number] is not None
        }

        def decode(body: bytes, offsets: Offsets, order: list[int]) -> Iterator[Entry]:
            try:
                columns = [self._column(body, starts, *makers.get(number, ("", None)), decoders[number])
                           for number, starts in offsets.items()]  # fmt: skip
            except (*_DECODING_ERRORS, RecordingError):
                return self._one_by_one(body, offsets, order, decoders)
            found = list(chain.from_iterable(columns))
            return filter(None, map(found.__getitem__, order))

        return decode

    def _column(
        self, body: bytes, starts: Any, topic: str, make: Maker | None, decode: Decoder | None
    ) -> list[Entry] | list[None]:
        """Return the entries of one channel of a chunk; None for each message that is no entry."""
        if decode is None:
            return [None] * len(starts)
        if make is not None:
            return make(self._file.rows_at(body, starts, topic, self._bus if topic in _BUS_TOPICS else ""))
        return [decode(self._message(body, offset)) for offset in starts.tolist()]

    def _one_by_one(
        self, body: bytes, offsets: Offsets, order: list[int], decoders: Mapping[int, Decoder | None]
    ) -> Iterator[Entry]:
        """Yield the entries of a chunk in which a message cannot be read, up to that one."""
        ordered = np.concatenate(list(offsets.values()))[order]
        for offset in ordered.tolist():
            message = self._message(body, offset)
            decode = decoders[message.channel]
            if decode is not None:
                yield self._decoded(decode, message)

    def _messages(self, topic: str) -> Iterator[Message]:
        for body, offsets in self._file.chunks(topic):
            for starts in offsets.values():
                for offset in starts.tolist():
                    yield self._message(body, offset)

    def _message(self, body: bytes, offset: int) -> Message:
        _, length, channel, sequence, log_time, stamp_ns = _MESSAGE_FIELDS.unpack_from(body, offset)
        payload = body[offset + _MESSAGE_FIELDS.size : offset + RECORD_HEADER.size + length]
        return Message(channel, sequence, log_time - self._epoch_offset_ns, stamp_ns, payload)

    def _decoder_of(self, topic: str) -> Decoder | None:
        """Return the decoder of a topic; None if the gateway does not write it. Raises RecordingError."""
        try:
            definition = self._file.definition(topic)
        except RecordingError:
            if decoder_of(topic, "", self._bus, self._epoch_offset_ns) is None:
                return None
            raise
        try:
            return decoder_of(topic, definition, self._bus, self._epoch_offset_ns)
        except DEFINITION_ERRORS as error:
            raise RecordingError(
                f"{self._file.path}: {topic}: the definition of its messages cannot be read: {error}"
            ) from None

    def _decoded(self, decode: Callable[[Message], _Decoded], message: Message) -> _Decoded:
        try:
            return decode(message)
        except _DECODING_ERRORS as error:
            raise RecordingError(
                f"{self._file.path}: message {message.sequence} cannot be read: {error}"
            ) from None

    def _missing(self, count: int, body: bytes, offset: int) -> RecordingError:
        now_ns = self._message(body, offset).now_ns
        return RecordingError(
            f"{self._file.path}: {count} messages before {now_ns} ns {self._why_missing()}; the entries "
            "after them cannot be replayed"
        )

    def _why_missing(self) -> str:
        metadata = self._file.metadata
        if "recovery" in metadata:
            return "were lost before `hil recover` saved the rest"
        if messages_dropped(metadata) or not self._is_complete:
            return "were dropped while recording"
        if "messages" in metadata.get("recorder", {}):
            return "were removed by another program: the recorder has dropped none"
        return "were dropped while recording, or removed later"


def _joined(chunks: Iterator[tuple[bytes, Offsets]]) -> Iterator[tuple[bytes, Offsets]]:
    """Join consecutive chunks to larger ones of about :data:`_JOINED_BYTES`, without those that are empty.

    What is joined when a chunk cannot be read is yielded before the error is raised.
    """
    bodies: list[bytes] = []
    size = 0
    places: dict[int, list[NDArray[np.int64]]] = {}
    failure: RecordingError | None = None
    while True:
        try:
            body, offsets = next(chunks, (b"", None))
        except RecordingError as error:
            failure, offsets = error, None
        if offsets is not None:
            for channel, starts in offsets.items():
                places.setdefault(channel, []).append(starts + size)
            bodies.append(body)
            size += len(body)
        if places and (offsets is None or size >= _JOINED_BYTES):
            yield b"".join(bodies), {channel: np.concatenate(starts) for channel, starts in places.items()}
            bodies, size, places = [], 0, {}
        if failure is not None:
            raise failure
        if offsets is None:
            return


def messages_dropped(metadata: Mapping[str, Mapping[str, str]]) -> int:
    """Return the number of messages that were not recorded, from the metadata of a file or run."""
    counts = metadata.get("recorder", {})
    return sum(int(count) for key, count in counts.items() if key.startswith("dropped "))


def is_complete(has_end: bool, metadata: Mapping[str, Mapping[str, str]]) -> bool:
    """Return False if a file was cut off, or saved from one that was; ``has_end`` says if it has its end."""
    return has_end and metadata.get("recovery", {}).get("complete", "yes") == "yes"
