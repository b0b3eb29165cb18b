"""The object dictionary of a simulated board (CiA 301): entries by index and subindex, with their access.

An entry reads its value when it is asked for, so that it always shows the board's present state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Final, NamedTuple, TypeAlias


class DataType(IntEnum):
    """Data type of an entry, with its number in CiA 301."""

    INTEGER16 = 0x03
    INTEGER32 = 0x04
    UNSIGNED8 = 0x05
    UNSIGNED16 = 0x06
    UNSIGNED32 = 0x07
    VISIBLE_STRING = 0x09


NOT_USED: Final = 0x8000_0000
"""Bit of a PDO's identifier that says that the PDO is not used."""
WIRE_VERSION_INDEX: Final = 0x2010
"""Index of the object that says in which wire version the board computes the CRC of its PDOs."""

SIZES: Final[Mapping[DataType, int]] = {
    DataType.INTEGER16: 2,
    DataType.INTEGER32: 4,
    DataType.UNSIGNED8: 1,
    DataType.UNSIGNED16: 2,
    DataType.UNSIGNED32: 4,
}
"""Length of an integer type in bytes."""
_SIGNED: Final = (DataType.INTEGER16, DataType.INTEGER32)


class AbortCode(IntEnum):
    """Reason why an SDO transfer is aborted (CiA 301)."""

    TOGGLE = 0x0503_0000
    COMMAND = 0x0504_0001
    READ_ONLY = 0x0601_0002
    NO_OBJECT = 0x0602_0000
    LENGTH = 0x0607_0010
    NO_SUBINDEX = 0x0609_0011
    VALUE = 0x0609_0030
    NO_DATA = 0x0800_0024


Value: TypeAlias = int | str | AbortCode
"""Value of an entry, or the reason why it has none."""


class Entry(NamedTuple):
    """One entry of the dictionary."""

    data_type: DataType
    read: Callable[[], Value]
    write: Callable[[int], AbortCode | None] | None = None
    """Takes a new value; returns why it is refused, or None. Without it, the entry is read-only."""


Dictionary: TypeAlias = dict[tuple[int, int], Entry]
"""Entries by index and subindex."""


def constant(data_type: DataType, value: int | str) -> Entry:
    """Return an entry whose value never changes."""
    return Entry(data_type, lambda: value)


def record(index: int, *entries: Entry) -> Dictionary:
    """Return an object with subindexes: 0 is the highest subindex, the others are ``entries``."""
    highest = constant(DataType.UNSIGNED8, len(entries))
    return {(index, 0): highest} | {(index, number): entry for number, entry in enumerate(entries, 1)}


def communication(index: int, identifier: int, transmission_type: int) -> Dictionary:
    """Return the communication parameters of a PDO: its identifier (``NOT_USED``: bit 31), and its type."""
    return record(
        index,
        constant(DataType.UNSIGNED32, identifier),
        constant(DataType.UNSIGNED8, transmission_type),
    )


def mapping(index: int, *mapped: tuple[int, int, int]) -> Dictionary:
    """Return the mapping of a PDO. Each mapped entry is its index, subindex and length in bits."""
    return record(
        index,
        *(
            constant(DataType.UNSIGNED32, entry << 16 | subindex << 8 | bits)
            for entry, subindex, bits in mapped
        ),
    )


def read(dictionary: Dictionary, index: int, subindex: int) -> bytes | AbortCode:
    """Return the value of an entry as SDO carries it, or why it cannot be read."""
    entry = dictionary.get((index, subindex))
    if entry is None:
        return _missing(dictionary, index)
    value = entry.read()
    if isinstance(value, AbortCode):
        return value
    if isinstance(value, str):
        return value.encode("ascii")
    return value.to_bytes(SIZES[entry.data_type], "little", signed=entry.data_type in _SIGNED)


def write(dictionary: Dictionary, index: int, subindex: int, data: bytes) -> AbortCode | None:
    """Write an entry. Returns why it is refused, or None."""
    entry = dictionary.get((index, subindex))
    if entry is None:
        return _missing(dictionary, index)
    if entry.write is None:
        return AbortCode.READ_ONLY
    if len(data) != SIZES[entry.data_type]:
        return AbortCode.LENGTH
    return entry.write(int.from_bytes(data, "little", signed=entry.data_type in _SIGNED))


def _missing(dictionary: Dictionary, index: int) -> AbortCode:
    return AbortCode.NO_SUBINDEX if (index, 0) in dictionary else AbortCode.NO_OBJECT
