"""Digital inputs in the rig file, ``[emergency_stop]`` and ``[enable]``: the frame and the bit of a contact.

Both inputs are normally closed: a set bit is a closed contact, so that a broken wire acts like a pressed
button. A frame that does not arrive acts in the same way.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from hil.core.documents import Document
from hil.core.errors import DocumentError

PROTECTION_BYTES = 2
"""Number of bytes at the end of a protected frame: counter and CRC."""
MAX_INPUT_TIMEOUT_S = 1.0
"""Longest time for which an input without a new frame may count as closed."""
MAX_STANDARD_IDENTIFIER = 0x7FF

RESERVED_IDENTIFIERS = {
    0x000: "NMT",
    0x080: "SYNC",
    0x090: "EMCY_ADC",
    0x0A0: "EMCY_DAC",
    0x190: "TPDO1_ADC",
    0x1A0: "TPDO1_DAC",
    0x220: "RPDO1_DAC",
    0x320: "RPDO2 to the DAC board",
    0x420: "RPDO3 to the DAC board",
    0x520: "RPDO4 to the DAC board",
    0x590: "SDO of the ADC board",
    0x5A0: "SDO of the DAC board",
    0x610: "SDO to the ADC board",
    0x620: "SDO to the DAC board",
    0x701: "HEARTBEAT_GATEWAY",
    0x710: "HEARTBEAT_ADC",
    0x720: "HEARTBEAT_DAC",
}
"""Identifiers that no input can have, and what they are.

They are written out, because the simulated boards read rig files too and share no wire code with the gateway.
"""

Bit = Annotated[int, msgspec.Meta(ge=0, le=7)]


class InputSettings(Document, frozen=True):
    """A contact that a module reports in a frame. A set bit is a closed contact."""

    frame: Annotated[int, msgspec.Meta(ge=1, le=MAX_STANDARD_IDENTIFIER)]
    """Standard identifier (11 bit) of the frame, such as 0x290: TPDO2 of the ADC board."""
    byte: Bit
    """Place of the byte in the frame, counted from 0."""
    bit: Bit
    """Place of the bit in the byte, counted from 0, the least significant one."""
    timeout_s: Annotated[float, msgspec.Meta(ge=0.001, le=MAX_INPUT_TIMEOUT_S)]
    """Time in seconds without a good frame after which the contact counts as open."""
    protected: bool = True
    """True if the frame ends with counter and CRC, false for modules that have none."""


def check_inputs(inputs: dict[str, InputSettings], source: str) -> None:
    """Check the inputs of a rig file, by the name of their table. Raises DocumentError."""
    for name, settings in inputs.items():
        what = RESERVED_IDENTIFIERS.get(settings.frame)
        if what is not None:
            raise DocumentError(
                f"{source}: {name}.frame: 0x{settings.frame:03X} is the identifier of {what}; use that of "
                "the frame with the digital inputs, such as 0x290"
            )
        if settings.protected and settings.byte > 7 - PROTECTION_BYTES:
            raise DocumentError(
                f"{source}: {name}.byte: {settings.byte} exceeds {7 - PROTECTION_BYTES}, because the last "
                "two of at most 8 bytes are counter and CRC; reduce it, or write protected = false for a "
                "module that has none"
            )
    if len(inputs) < 2:
        return
    (first_name, first), (second_name, second) = inputs.items()
    if first.frame != second.frame:
        return
    if (first.byte, first.bit) == (second.byte, second.bit):
        raise DocumentError(
            f"{source}: {second_name}: bit {second.bit} of byte {second.byte} of frame 0x{second.frame:03X} "
            f"is taken by {first_name}; each contact needs a bit of its own"
        )
    if first.protected != second.protected:
        raise DocumentError(
            f"{source}: {second_name}.protected: frame 0x{second.frame:03X} is the same as that of "
            f"{first_name}, so both tables need the same value"
        )
