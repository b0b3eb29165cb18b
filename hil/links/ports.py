"""What a link needs of a bus: send one frame, take one waiting message. Neither call waits."""

from __future__ import annotations

from enum import Enum, auto
from typing import TYPE_CHECKING, NamedTuple, Protocol

from hil.core.frames import Frame
from hil.links.failures import cause_of
from hil.links.messages import frame_of

if TYPE_CHECKING:
    import can


class Arrival(NamedTuple):
    """A frame of another node."""

    frame: Frame
    stamp_ns: int
    """Instant of arrival, in nanoseconds since 1970."""


class Discarded(Enum):
    """A message that was taken from the bus and is no frame of another node."""

    OWN = auto()
    """A frame that this link sent."""
    UNREADABLE = auto()
    """A message that is not classic CAN, or corrupt."""


class Port(Protocol):
    """An open bus."""

    holds_messages: bool
    """True if messages may wait inside this object, so that ``select`` does not see them."""

    @property
    def refused(self) -> int:
        """Number of frames that an adapter refused after it had taken them."""

    def send(self, frame: Frame) -> None:
        """Hand ``frame`` to the bus. Raises OSError, with number EAGAIN or ENOBUFS if a queue is full."""

    def take(self) -> Arrival | Discarded | None:
        """Take the next message that waits, if one does. Raises OSError if the bus is gone."""

    def dropped(self) -> int:
        """Return the number of messages that arrived and were lost because the kernel's queue was full."""

    def fileno(self) -> int:
        """Return a descriptor for ``select``."""

    def close(self) -> None:
        """Close the bus."""


class MessagePort:
    """A bus of python-can. Its messages are converted to frames and back."""

    holds_messages = True

    def __init__(self, bus: can.BusABC, name: str) -> None:
        """``name`` marks own frames, for a bus that delivers them too."""
        from can import CanError, Message

        self.bus = bus
        """The bus of python-can."""
        self._name = name
        self._message = Message
        self._error = CanError

    @property
    def refused(self) -> int:
        """Number of frames that an adapter refused after it had taken them."""
        return getattr(self.bus, "refused", 0)

    def send(self, frame: Frame) -> None:
        """Hand ``frame`` to the bus. Raises OSError."""
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
            self.bus.send(message)
        except self._error as error:
            # python-can reports its own full buffer without an error number.
            raise cause_of(error) or BlockingIOError(str(error)) from None

    def take(self) -> Arrival | Discarded | None:
        """Take the next message that waits, if one does. Raises OSError if the bus is gone."""
        try:
            message = self.bus.recv(0)
        except self._error as error:
            cause = cause_of(error)
            if cause is not None:
                raise cause from None
            return Discarded.UNREADABLE
        if message is None:
            return None
        if message.channel == self._name:
            return Discarded.OWN
        frame = frame_of(message)
        return Discarded.UNREADABLE if frame is None else Arrival(frame, round(message.timestamp * 1e9))

    def dropped(self) -> int:
        """Return 0: such a bus has no queue in the kernel that drops messages."""
        return 0

    def fileno(self) -> int:
        """Return a descriptor for ``select``."""
        return self.bus.fileno()

    def close(self) -> None:
        """Close the bus."""
        self.bus.shutdown()
