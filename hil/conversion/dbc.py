"""Read what a log import needs from a DBC file: identifiers, senders, and the places of signals.

It is no full parser: multiplexed signals, value tables and attributes are skipped. Format: Vector, DBC File
Format Documentation, version 1.0.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from hil.core.errors import DocumentError

_MESSAGE = re.compile(r"^BO_\s+(\d+)\s+(\w+)\s*:\s*(\d+)\s+(\w+)")
_SIGNAL = re.compile(r"^SG_\s+(\w+)\s*:\s*(\d+)\|(\d+)@([01])([+-])\s*\(\s*([^,\s]+)\s*,\s*([^)\s]+)\s*\)")
_EXTENDED_FLAG = 0x8000_0000
"""Flag of an identifier of 29 bits in a DBC file."""
_MAX_BITS = 64


class DbcSignal(NamedTuple):
    """Place and scaling of a signal in the data of a frame."""

    name: str
    start: int
    """Number of the lowest bit of a little-endian signal, and of the highest bit of a big-endian one."""
    length: int
    is_little_endian: bool
    is_signed: bool
    factor: float
    offset: float

    def decode(self, data: bytes) -> float | None:
        """Return the physical value, or None if ``data`` is too short to have it."""
        if self.is_little_endian:
            first = self.start
            raw = int.from_bytes(data, "little") >> first
            end = first + self.length
        else:
            # Bits of a big-endian signal go down within a byte, then on to the next byte's highest bit.
            first = 8 * (self.start // 8) + 7 - self.start % 8
            end = first + self.length
            raw = int.from_bytes(data, "big") >> max(8 * len(data) - end, 0)
        if end > 8 * len(data):
            return None
        raw &= (1 << self.length) - 1
        if self.is_signed and raw >> (self.length - 1):
            raw -= 1 << self.length
        return raw * self.factor + self.offset


class DbcMessage(NamedTuple):
    """A message of a DBC file."""

    name: str
    identifier: int
    """Identifier without the flag of 29 bits."""
    is_extended: bool
    sender: str
    """Name of the node that sends it."""
    signals: Mapping[str, DbcSignal]
    """Signals by name."""


def read_dbc(text: str, source: str) -> dict[str, DbcMessage]:
    """Return the messages of a DBC file by name. ``source`` is its name for errors. Raises DocumentError."""
    messages: dict[str, DbcMessage] = {}
    signals: dict[str, DbcSignal] = {}
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if match := _MESSAGE.match(stripped):
            signals = {}
            identifier = int(match[1])
            name = match[2]
            messages[name] = DbcMessage(
                name, identifier & ~_EXTENDED_FLAG, bool(identifier & _EXTENDED_FLAG), match[4], signals
            )
        elif match := _SIGNAL.match(stripped):
            signals[match[1]] = _signal(match, f"{source}: line {number}")
    if not messages:
        raise DocumentError(f"{source}: has no message (BO_), so it is no DBC file")
    return messages


def _signal(match: re.Match[str], where: str) -> DbcSignal:
    try:
        factor, offset = float(match[6]), float(match[7])
    except ValueError:
        raise DocumentError(f"{where}: signal {match[1]}: factor or offset is not a number") from None
    start, length = int(match[2]), int(match[3])
    if not 1 <= length <= _MAX_BITS or start >= _MAX_BITS:
        raise DocumentError(
            f"{where}: signal {match[1]}: starts at bit {start} with {length} bits, but a frame has "
            f"{_MAX_BITS} bits"
        )
    return DbcSignal(match[1], start, length, match[4] == "1", match[5] == "-", factor, offset)
