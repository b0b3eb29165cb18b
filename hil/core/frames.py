"""CAN frames as plain values, which the gateway, the simulated boards and the links exchange."""

from __future__ import annotations

from typing import NamedTuple


class Frame(NamedTuple):
    """A classic CAN frame: an identifier of 11 or 29 bits and 0 to 8 bytes of data.

    A remote frame (``is_remote``) asks for ``len(data)`` bytes and holds none: its ``data`` are zeros.

    An error frame (``is_error``) carries its error class in ``id`` and the details in ``data``, in the
    layout of ``linux/can/error.h``.
    """

    id: int
    data: bytes = b""
    is_extended: bool = False
    is_remote: bool = False
    is_error: bool = False

    def __str__(self) -> str:
        """Return the frame in the notation of candump, such as ``190#00400040``."""
        identifier = f"{self.id:08X}" if self.is_extended or self.is_error else f"{self.id:03X}"
        if self.is_remote:
            return f"{identifier}#R{len(self.data) or ''}"
        return f"{identifier}#{self.data.hex().upper()}"
