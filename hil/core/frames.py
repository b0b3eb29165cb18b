"""CAN frames as plain values: what the gateway, the boards and the links hand to each other."""

from __future__ import annotations

from typing import NamedTuple


class Frame(NamedTuple):
    """A classic CAN frame: ``id`` 11 or 29 bit, ``data`` of 0 to 8 bytes.

    An error frame of the bus (``is_error``) carries its error class in ``id`` and its details in
    ``data``, as ``linux/can/error.h`` lays them out.
    """

    id: int
    data: bytes = b""
    is_extended: bool = False
    is_remote: bool = False
    is_error: bool = False

    def __str__(self) -> str:
        """As candump prints it: ``190#00400040…``."""
        identifier = f"{self.id:08X}" if self.is_extended or self.is_error else f"{self.id:03X}"
        return f"{identifier}#" + ("R" if self.is_remote else self.data.hex().upper())
