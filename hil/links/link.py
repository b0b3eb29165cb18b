"""An open bus, as the gateway and the simulated boards use it."""

from __future__ import annotations

import contextlib
import errno
import select
import time
from types import TracebackType
from typing import Final, NamedTuple, Self

from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.links.failures import failure
from hil.links.opening import Origin, open_port
from hil.links.ports import Discarded, Port

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

    def __init__(self, spec: str, port: Port, origin: Origin, bit_rate: int | None = None) -> None:
        """Take over ``port``, the bus that ``spec`` names. ``origin`` is the clock of its time stamps.

        ``bit_rate`` is what the bus was opened with, see :func:`open_link`.
        """
        self.spec = spec
        """Name by which the bus was opened; error messages begin with it."""
        self._port: Port | None = port
        self._bit_rate = bit_rate
        self.stamp_origin: Origin = origin
        """Clock of the time stamps of all frames that this link receives."""
        self.unreadable = 0
        """Number of messages since the link was opened that were not classic CAN, or corrupt."""
        self._refused_by_queue = 0
        self._dropped_before = 0

    def send(self, frame: Frame) -> bool:
        """Hand ``frame`` to the bus. Returns False if a full queue refuses it; does not wait for room.

        ``send_failures`` counts the refused frames. Raises LinkError if the bus is gone.
        """
        port = self._open_port()
        try:
            port.send(frame)
        except OSError as error:
            if error.errno not in _TRANSIENT_ERRORS:
                raise failure(self.spec, "cannot send", error, error) from None
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
        port = self._open_port()
        end_s = time.monotonic() + timeout_s if timeout_s > 0 else 0.0
        is_over = timeout_s <= 0
        if not is_over and not port.holds_messages:
            is_over = not select.select([port], [], [], timeout_s)[0]
        discarded_after_timeout = 0
        while discarded_after_timeout < MAX_DISCARDED_AFTER_TIMEOUT:
            try:
                arrival = port.take()
            except OSError as error:
                raise failure(self.spec, "cannot receive", error, error) from None
            if arrival is None:
                if is_over:
                    return None
                left_s = end_s - time.monotonic()
                is_over = left_s <= 0 or not select.select([port], [], [], left_s)[0]
            elif isinstance(arrival, Discarded):
                self.unreadable += arrival is Discarded.UNREADABLE
                is_over = is_over or time.monotonic() >= end_s
                discarded_after_timeout += is_over
            else:
                return Received(*arrival, self.stamp_origin)
        return None

    @property
    def send_failures(self) -> int:
        """Number of frames since the link was opened that a full queue or the adapter refused."""
        return self._refused_by_queue + (self._port.refused if self._port is not None else 0)

    def dropped(self) -> int:
        """Return the number of frames that arrived and were lost because the kernel's queue was full."""
        return self._dropped_before + self._open_port().dropped()

    def reopen(self) -> None:
        """Close the bus and open it again; the counters continue.

        Raises LinkError if it cannot be opened. The link is closed then.
        """
        with contextlib.suppress(LinkError, OSError):
            self._dropped_before = self.dropped()
        self._refused_by_queue = self.send_failures
        self.close()
        self._port, self.stamp_origin = open_port(self.spec, self._bit_rate)

    def fileno(self) -> int:
        """Return a descriptor for ``select``, which is readable when messages wait.

        Call ``receive(0)`` until it returns None before selecting again.
        """
        return self._open_port().fileno()

    def close(self) -> None:
        """Close the bus. Closing twice is no error."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _open_port(self) -> Port:
        if self._port is None:
            raise LinkError(f"{self.spec}: the link is closed")
        return self._port


def open_link(spec: str, bit_rate: int | None = None) -> Link:
    """Open the bus that ``spec`` names, in one of the forms of ``BUS_FORMS``. Raises LinkError.

    ``bit_rate``, in bit/s, is that of a bus behind a serial adapter (slcan); None means 500 kbit/s. Other
    buses have a bit rate of their own.
    """
    return Link(spec, *open_port(spec, bit_rate), bit_rate)
