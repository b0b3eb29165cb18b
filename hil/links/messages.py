"""From python-can's messages to frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from hil.core.frames import Frame

if TYPE_CHECKING:
    import can

MAX_STANDARD_ID: Final = 0x7FF
MAX_EXTENDED_ID: Final = 0x1FFF_FFFF
MAX_DATA_BYTES: Final = 8
_MAX_STAMP_S: Final = 1e12
"""Largest distance of a time stamp from 1970, in seconds. Infinity and NaN are excluded with it."""


def frame_of(message: can.Message) -> Frame | None:
    """Return the frame in ``message``; None if it is not classic CAN, or corrupt.

    Another program on a UDP bus may send anything: python-can checks neither types nor ranges.
    """
    identifier, data = message.arbitration_id, message.data
    is_long = message.is_extended_id or message.is_error_frame
    if not (
        not message.is_fd
        and isinstance(identifier, int)
        and 0 <= identifier <= (MAX_EXTENDED_ID if is_long else MAX_STANDARD_ID)
        and len(data) <= MAX_DATA_BYTES
        and isinstance(message.dlc, int)
        and (0 <= message.dlc <= MAX_DATA_BYTES if message.is_remote_frame else len(data) == message.dlc)
        and isinstance(message.timestamp, int | float)
        and abs(message.timestamp) < _MAX_STAMP_S
    ):
        return None
    return Frame(
        int(identifier),
        bytes(message.dlc) if message.is_remote_frame else bytes(data),
        bool(message.is_extended_id),
        bool(message.is_remote_frame),
        bool(message.is_error_frame),
    )
