"""A CAN controller of the bus model: its transmit queue, its error counters and its error state."""

from __future__ import annotations

from collections import deque
from enum import IntEnum
from typing import Final

from hil.core.frames import Frame

QUEUED_FRAMES: Final = 10
"""Number of frames that wait in a transmit queue before others are refused: ``txqueuelen`` of SocketCAN."""
WARNING_LIMIT: Final = 96
"""Error counter from which the controller warns."""
PASSIVE_LIMIT: Final = 128
"""Error counter from which the controller is error-passive."""
BUS_OFF_LIMIT: Final = 256
"""Transmit error counter from which the controller is bus-off."""
RECOVERY_SEQUENCES: Final = 128
"""Number of sequences of 11 recessive bits after which a controller that was bus-off may send again."""
_MAX_REC: Final = 255
_TRANSMIT_ERROR: Final = 8
"""Increase of the transmit error counter for each error of a frame that the controller sends."""

_ERROR_CONTROLLER: Final = 0x204  # linux/can/error.h: CAN_ERR_CRTL and CAN_ERR_CNT
_ERROR_BUS_OFF: Final = 0x040  # CAN_ERR_BUSOFF
_ERROR_RESTARTED: Final = 0x100  # CAN_ERR_RESTARTED
_RX_WARNING, _TX_WARNING, _RX_PASSIVE, _TX_PASSIVE, _ACTIVE = 0x04, 0x08, 0x10, 0x20, 0x40


class ErrorState(IntEnum):
    """Error state of a controller, as Linux names it."""

    ERROR_ACTIVE = 0
    ERROR_WARNING = 1
    ERROR_PASSIVE = 2
    BUS_OFF = 3


class Controller:
    """One node's controller. The bus changes it; others read it.

    The queue is first in, first out, as that of SocketCAN: a frame of low priority holds up those behind it.
    """

    __slots__ = (
        "max_queued",
        "name",
        "queue",
        "ready_ns",
        "rec",
        "recovering_since_ns",
        "recovery_left",
        "refused",
        "restarts",
        "state",
        "tec",
    )

    def __init__(self, name: str, max_queued: int = QUEUED_FRAMES, *, restarts: bool = True) -> None:
        """``restarts`` says whether the node recovers from bus-off without being asked to."""
        self.name = name
        self.max_queued = max_queued
        self.restarts = restarts
        self.queue: deque[tuple[int, Frame]] = deque()
        """Frames that wait, each behind its priority in arbitration. The first one is being sent, or next."""
        self.refused = 0
        """Number of frames that a full queue, or a controller that is bus-off, refused or discarded."""
        self.tec = 0
        """Transmit error counter."""
        self.rec = 0
        """Receive error counter."""
        self.state = ErrorState.ERROR_ACTIVE
        self.ready_ns = 0
        """Time before which an error-passive controller may not send again (suspend transmission)."""
        self.recovery_left = 0
        """Number of sequences of 11 recessive bits until the controller recovers; 0 if it does not."""
        self.recovering_since_ns = 0

    @property
    def is_bus_off(self) -> bool:
        """True if the controller takes no part in the bus."""
        return self.state is ErrorState.BUS_OFF

    def enqueue(self, frame: Frame) -> bool:
        """Take a frame for sending. Return False if the queue is full or the controller is bus-off."""
        if len(self.queue) >= self.max_queued or self.state is ErrorState.BUS_OFF:
            self.refused += 1
            return False
        self.queue.append((priority(frame), frame))
        return True

    def count_sent(self) -> bool:
        """Count a frame that was sent without error. Return whether the error state changed."""
        self.tec = max(self.tec - 1, 0)
        return self._update()

    def count_received(self) -> bool:
        """Count a frame that was received without error. Return whether the error state changed."""
        self.rec = PASSIVE_LIMIT - 1 if self.rec >= PASSIVE_LIMIT else max(self.rec - 1, 0)
        return self._update()

    def count_send_error(self, *, is_unacknowledged: bool = False) -> bool:
        """Count an error of a frame that this controller sent. Return whether the error state changed.

        A missing acknowledgement does not count for a controller that is error-passive. A node that is alone
        on its bus therefore does not become bus-off.
        """
        if not (is_unacknowledged and self.state is ErrorState.ERROR_PASSIVE):
            self.tec += _TRANSMIT_ERROR
        return self._update()

    def count_receive_error(self) -> bool:
        """Count an error of a frame of another node. Return whether the error state changed."""
        self.rec = min(self.rec + 1, _MAX_REC)
        return self._update()

    def go_bus_off(self) -> None:
        """Leave the bus, as after too many errors. The frames that wait are discarded."""
        self.tec = max(self.tec, BUS_OFF_LIMIT)
        self._update()

    def begin_recovery(self, now_ns: int) -> None:
        """Begin to wait for the recessive bits after which the controller may send again."""
        self.recovery_left, self.recovering_since_ns = RECOVERY_SEQUENCES, now_ns

    def recover(self) -> None:
        """End bus-off: the controller is error-active, and both counters are 0."""
        self.tec = self.rec = self.recovery_left = 0
        self.state = ErrorState.ERROR_ACTIVE

    def _update(self) -> bool:
        """Set the error state from the counters. Only ``recover`` ends bus-off."""
        before = self.state
        if before is ErrorState.BUS_OFF:
            return False
        highest = max(self.tec, self.rec)
        if self.tec >= BUS_OFF_LIMIT:
            self.state = ErrorState.BUS_OFF
            self.refused += len(self.queue)
            self.queue.clear()
        elif highest >= PASSIVE_LIMIT:
            self.state = ErrorState.ERROR_PASSIVE
        elif highest >= WARNING_LIMIT:
            self.state = ErrorState.ERROR_WARNING
        else:
            self.state = ErrorState.ERROR_ACTIVE
        return self.state is not before

    def report(self, *, is_restarted: bool = False) -> Frame:
        """Return the error frame by which SocketCAN reports the present error state (linux/can/error.h)."""
        if is_restarted:
            return Frame(_ERROR_RESTARTED, bytes(8), is_error=True)
        if self.state is ErrorState.BUS_OFF:
            return Frame(_ERROR_BUS_OFF, bytes(8), is_error=True)
        flag = _ACTIVE
        is_of_sending = self.tec >= self.rec
        if self.state is ErrorState.ERROR_PASSIVE:
            flag = _TX_PASSIVE if is_of_sending else _RX_PASSIVE
        elif self.state is ErrorState.ERROR_WARNING:
            flag = _TX_WARNING if is_of_sending else _RX_WARNING
        return Frame(_ERROR_CONTROLLER, bytes((0, flag, 0, 0, 0, 0, self.tec, self.rec)), is_error=True)


def priority(frame: Frame) -> int:
    """Return the arbitration field of a frame as a number of 32 bits; the smallest one wins the bus.

    The bits are in their order on the wire. A data frame wins against a remote frame of its identifier, and
    an 11-bit identifier against a 29-bit one that begins with the same 11 bits.
    """
    if frame.is_extended:
        substitute_and_extension = 0b11 << 19
        return (frame.id >> 18) << 21 | substitute_and_extension | (frame.id & 0x3FFFF) << 1 | frame.is_remote
    return frame.id << 21 | frame.is_remote << 20
