"""A ring of messages in shared memory, which one process writes and any number of processes read.

Writing a message is one copy in memory: no system call, no lock, and no way for a reader to delay the writer.
A reader that is slower than the ring loses the oldest messages, and knows how many.

Layout: the number of messages that were ever written (8 bytes, host order), then slots of equal size. A slot
is the CRC-32 of the rest, the length of the message, its number, and the message. A reader takes a message
only if CRC and number are right, so that it never takes one that is just being written, whatever the order
in which the processor makes the bytes visible.
"""

from __future__ import annotations

import struct
from typing import NamedTuple
from zlib import crc32

_HEAD = struct.Struct("<IQ")
"""Length and number of a message. The CRC before them covers them too."""
_CRC_BYTES = 4
_COUNT_BYTES = 8
OVERHEAD_BYTES = _CRC_BYTES + _HEAD.size


def ring_bytes(slot_bytes: int, slots: int) -> int:
    """Return the size of a ring in bytes, a multiple of 8."""
    return _COUNT_BYTES + -(-slot_bytes * slots // 8) * 8


class RingWriter:
    """The end that writes. ``memory`` has ``ring_bytes(slot_bytes, slots)`` bytes, all of them zero."""

    def __init__(self, memory: memoryview, slot_bytes: int, slots: int) -> None:
        self._count = memory[:_COUNT_BYTES].cast("Q")
        self._memory = memory
        self._slot_bytes = slot_bytes
        self._slots = slots
        self._end = 0

    def write(self, message: bytes) -> None:
        """Write a message. Raises ValueError if it is too large for a slot."""
        end = self._end
        content = _HEAD.pack(len(message), end) + message
        size = _CRC_BYTES + len(content)
        if size > self._slot_bytes:
            raise ValueError(f"a message of {len(message)} bytes does not fit into {self._slot_bytes} bytes")
        begin = _COUNT_BYTES + end % self._slots * self._slot_bytes
        self._memory[begin : begin + size] = crc32(content).to_bytes(_CRC_BYTES, "little") + content
        self._count[0] = self._end = end + 1

    def release(self) -> None:
        """Release the memory, so that it can be unmapped."""
        self._count.release()
        self._memory.release()


class Messages(NamedTuple):
    """Messages that a reader has taken."""

    messages: list[bytes]
    lost: int
    """Number of messages that were overwritten before they were read."""


class RingReader:
    """An end that reads. It begins with the oldest message that the ring still holds."""

    def __init__(self, memory: memoryview, slot_bytes: int, slots: int) -> None:
        self._count = memory[:_COUNT_BYTES].cast("Q")
        self._memory = memory
        self._slot_bytes = slot_bytes
        self._slots = slots
        self._next = max(self._count[0] - slots, 0)

    def read(self) -> Messages:
        """Take all messages that are new since the last call."""
        end = self._count[0]
        begin = max(self._next, end - self._slots)
        lost = begin - self._next
        taken: list[bytes] = []
        for number in range(begin, end):
            message = self._message(number)
            if message is not None:
                taken.append(message)
            elif number < end - self._slots // 2:
                lost += 1  # it is being overwritten
            else:
                end = number  # it is not visible yet: the next call takes it
                break
        self._next = end
        return Messages(taken, lost)

    def release(self) -> None:
        """Release the memory, so that it can be unmapped."""
        self._count.release()
        self._memory.release()

    def _message(self, number: int) -> bytes | None:
        begin = _COUNT_BYTES + number % self._slots * self._slot_bytes
        head = bytes(self._memory[begin : begin + OVERHEAD_BYTES])
        length, found = _HEAD.unpack_from(head, _CRC_BYTES)
        if found != number or length > self._slot_bytes - OVERHEAD_BYTES:
            return None
        message = bytes(self._memory[begin + OVERHEAD_BYTES : begin + OVERHEAD_BYTES + length])
        if crc32(message, crc32(head[_CRC_BYTES:])) != int.from_bytes(head[:_CRC_BYTES], "little"):
            return None
        return message
