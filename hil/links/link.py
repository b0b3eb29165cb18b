"""An open bus, as the gateway and the simulated boards use it."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import time
from types import TracebackType
from typing import TYPE_CHECKING, Final, NamedTuple, Self

from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.links.failures import cause_of, failure
from hil.links.messages import frame_of
from hil.links.opening import Origin, open_bus
from hil.links.sockets import dropped_datagrams

if TYPE_CHECKING:
    import can

MAX_DISCARDED_AFTER_TIMEOUT: Final = 32
"""Largest number of messages that one call of ``receive`` discards after its timeout.

It must exceed the number of own frames that may wait before a frame of another node.
"""

_TRANSIENT_ERRORS: Final = {errno.EAGAIN, errno.ENOBUFS, None}
"""Error numbers of a full queue. python-can reports its own full buffer without a number."""


class Received(NamedTuple):
    """A frame with the instant of its arrival."""

    frame: Frame
    stamp_ns: int
    """Instant of arrival, in nanoseconds since 1970."""
    origin: Origin
    """Clock that gave ``stamp_ns``."""


class Link:
    """An open bus. It sends without waiting, receives with a timeout, and never receives its own frames."""

    def __init__(self, spec: str, bus: can.BusABC, origin: Origin) -> None:
        """Take over ``bus``, which ``spec`` names. ``origin`` is the clock of its time stamps."""
        from can import CanError, Message

        self.spec = spec
        """Name by which the bus was opened; error messages begin with it."""
        self._bus: can.BusABC | None = bus
        self.stamp_origin: Origin = origin
        """Clock of the time stamps of all frames that this link receives."""
        self.unreadable = 0
        """Number of messages since the link was opened that were not classic CAN, or corrupt."""
        self._refused_by_queue = 0
        self._dropped_before = 0
        self._name = os.urandom(8).hex()  # marks own frames, which multicast delivers too
        self._message = Message
        self._error = CanError

    def send(self, frame: Frame) -> bool:
        """Hand ``frame`` to the bus. Returns False if a full queue refuses it; does not wait for room.

        ``send_failures`` counts the refused frames. Raises LinkError if the bus is gone.
        """
        bus = self._open_bus()
        message = self._message(
            arbitration_id=frame.id,
            data=frame.data,
            dlc=len(frame.data),
            is_extended_id=frame.is_extended,
            is_remote_frame=frame.is_remote,
            is_error_frame=frame.is_error,
            channel=self._name,
        )
        try:
            bus.send(message)
        except self._error as error:
            cause = cause_of(error)
            if (cause and cause.errno) not in _TRANSIENT_ERRORS:
                raise failure(self.spec, "cannot send", cause, error) from None
            self._refused_by_queue += 1
            return False
        return True

    def receive(self, timeout_s: float) -> Received | None:
        """Return the next frame, or None if none arrives within ``timeout_s`` seconds. 0 does not wait.

        The call discards own frames and unreadable messages. After the timeout it discards at most
        ``MAX_DISCARDED_AFTER_TIMEOUT`` more, so that a node that sends without pause cannot hold the caller.
        It returns None only after it has looked again when the time was up: a frame that arrived while this
        process was stalled is still returned. Raises LinkError if the bus is gone.
        """
        bus = self._open_bus()
        end = time.monotonic() + timeout_s
        discarded_after_timeout = 0
        while discarded_after_timeout < MAX_DISCARDED_AFTER_TIMEOUT:
            left_s = end - time.monotonic()
            try:
                message = bus.recv(0)
            except self._error as error:
                cause = cause_of(error)
                if cause is not None:
                    raise failure(self.spec, "cannot receive", cause, error) from None
                self.unreadable += 1
            else:
                if message is None:
                    if left_s <= 0:
                        return None
                    select.select([bus], [], [], left_s)
                    continue
                if message.channel != self._name:
                    frame = frame_of(message)
                    if frame is not None:
                        return Received(frame, round(message.timestamp * 1e9), self.stamp_origin)
                    self.unreadable += 1
            if time.monotonic() >= end:
                discarded_after_timeout += 1
        return None

    @property
    def send_failures(self) -> int:
        """Number of frames since the link was opened that a full queue or the adapter refused."""
        return self._refused_by_queue + getattr(self._bus, "refused", 0)

    def dropped(self) -> int:
        """Return the number of frames that arrived and were lost because the kernel's queue was full."""
        bus = self._open_bus()
        if not hasattr(bus, "socket"):
            return self._dropped_before
        return self._dropped_before + dropped_datagrams(bus.socket)

    def reopen(self) -> None:
        """Close the bus and open it again; the counters continue.

        Raises LinkError if it cannot be opened. The link is closed then.
        """
        with contextlib.suppress(LinkError, OSError):
            self._dropped_before = self.dropped()
        self._refused_by_queue = self.send_failures
        self.close()
        self._bus, self.stamp_origin = open_bus(self.spec)

    def fileno(self) -> int:
        """Return a descriptor for ``select``, which is readable when messages wait.

        Call ``receive(0)`` until it returns None before selecting again.
        """
        return self._open_bus().fileno()

    def close(self) -> None:
        """Close the bus. Closing twice is no error."""
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.shutdown()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _open_bus(self) -> can.BusABC:
        if self._bus is None:
            raise LinkError(f"{self.spec}: the link is closed")
        return self._bus


def open_link(spec: str) -> Link:
    """Open the bus that ``spec`` names, in one of the forms of ``BUS_FORMS``. Raises LinkError."""
    return Link(spec, *open_bus(spec))
