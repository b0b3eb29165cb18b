"""Faults that change frames on their way: each is given a frame and returns the frames that arrive."""

from __future__ import annotations

from random import Random
from struct import Struct
from typing import NamedTuple

from firmware_sim.boards.codec import data_identity, encode_values
from firmware_sim.faults.kinds import (
    FRAME_IDS,
    Alter,
    Amount,
    Corrupt,
    ErrorFrames,
    FrameChange,
    Late,
    Lose,
    Miscount,
    Mislabel,
    Reorder,
    Repeat,
)
from hil.core.frames import Frame

_COUNTS = Struct("<hhh")
_VALUE_BITS = 15
"""Number of magnitude bits of an analogue value."""
_COUNTER = 6
"""Position of the rolling counter in a protected PDO."""


class Arrival(NamedTuple):
    """A frame that arrives, and by how much later than without the fault."""

    frame: Frame
    delay_ns: int = 0
    is_additional: bool = False
    """True if the frame is not the receiver's own, so that gateway and boards receive it."""


class Selection:
    """Chooses the frames that a fault affects: the next so many, or a share of them."""

    def __init__(self, amount: Amount, random: Random) -> None:
        self._left = amount if isinstance(amount, int) else None
        self._share = float(amount.removesuffix("%")) / 100.0 if isinstance(amount, str) else 1.0
        self._random = random

    def takes_next(self) -> bool:
        """Return whether the next frame is affected."""
        if self._left is None:
            return self._share >= 1.0 or self._random.random() < self._share
        self._left -= 1
        return self._left >= 0


class FrameDestroyer:
    """One active fault that destroys frames on a modelled bus."""

    def __init__(self, fault: ErrorFrames, random: Random) -> None:
        self._sender = fault.sender
        self._random = random
        self._selection = Selection(fault.amount, random)

    def broken_bit(self, sender: str, bits: int) -> int | None:
        """Return the bit at which a frame of so many bits is destroyed; None if it is not."""
        if self._sender not in ("any", sender) or not self._selection.takes_next():
            return None
        return self._random.randrange(1, bits)


class FrameChanger:
    """One active fault of frames."""

    def __init__(self, fault: FrameChange, random: Random, wire_version: int) -> None:
        """``wire_version`` is that of the rig, for frames whose CRC must fit again."""
        self._wire_version = wire_version
        self.identifier = FRAME_IDS[fault.frame]
        self._fault = fault
        self._random = random
        self._selection = Selection(fault.amount, random)
        self._held: Frame | None = None

    def change(self, frame: Frame) -> tuple[Arrival, ...]:
        """Return what arrives in place of ``frame``, which has this fault's identifier."""
        if self._held is not None:
            held, self._held = self._held, None
            return Arrival(frame), Arrival(held)
        if not self._selection.takes_next():
            return (Arrival(frame),)
        match self._fault:
            case Lose():
                return ()
            case Late(delay_s=delay_s):
                return (Arrival(frame, round(delay_s * 1e9)),)
            case Repeat():
                return Arrival(frame), Arrival(frame)
            case Reorder():
                self._held = frame
                return ()
            case Corrupt():
                return (Arrival(self._with_inverted_bit(frame)),)
            case Alter():
                return (Arrival(self._with_altered_value(frame)),)
            case Miscount(step=step):
                return (Arrival(with_counter_step(frame, step, self._wire_version)),)
            case Mislabel(label=label):
                return Arrival(frame), Arrival(Frame(FRAME_IDS[label], frame.data), is_additional=True)

    def _with_inverted_bit(self, frame: Frame) -> Frame:
        if not frame.data:
            return Frame(frame.id, b"\x01")  # a SYNC or heartbeat without data gets a byte
        data = bytearray(frame.data)
        bit = self._random.randrange(8 * len(data))
        data[bit // 8] ^= 1 << bit % 8
        return Frame(frame.id, bytes(data))

    def _with_altered_value(self, frame: Frame) -> Frame:
        counts = list(counts_of(frame))
        channel = self._random.randrange(len(counts))
        counts[channel] ^= 1 << self._random.randrange(_VALUE_BITS)
        first, second, third = counts
        return pdo(frame.id, (first, second, third), counter_of(frame), self._wire_version)


def changed_by(changer: FrameChanger, before: Arrival) -> tuple[Arrival, ...]:
    """Return what arrives in place of ``before``, which another fault may have delayed already."""
    if before.frame.id != changer.identifier or before.is_additional:
        return (before,)
    return tuple(
        arrival._replace(delay_ns=before.delay_ns + arrival.delay_ns)
        for arrival in changer.change(before.frame)
    )


def counts_of(frame: Frame) -> tuple[int, int, int]:
    """Return the three analogue values of a PDO, in counts."""
    first, second, third = _COUNTS.unpack_from(frame.data)
    return first, second, third


def counter_of(frame: Frame) -> int | None:
    """Return the rolling counter of a PDO; None for a PDO without one."""
    return frame.data[_COUNTER] if len(frame.data) > _COUNTER else None


def pdo(identifier: int, counts: tuple[int, int, int], counter: int | None, wire_version: int) -> Frame:
    """Return an analogue PDO with a correct CRC; without counter and CRC if ``counter`` is None."""
    return Frame(identifier, encode_values(counts, counter, data_identity(identifier, wire_version)))


def with_counter_step(frame: Frame, step: int, wire_version: int) -> Frame:
    """Return a PDO whose counter differs by ``step``, with a correct CRC. A PDO without one is unchanged."""
    counter = counter_of(frame)
    if counter is None:
        return frame
    return pdo(frame.id, counts_of(frame), (counter + step) & 0xFF, wire_version)
