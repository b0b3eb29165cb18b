"""Ports that use a bus's socket directly, without python-can's messages.

python-can opens and configures the sockets. For each frame it makes three to five system calls and a message
object of eleven attributes; a port makes one system call. The frames on the bus are the same.
"""

from __future__ import annotations

import socket
from struct import Struct
from typing import Final, Protocol

import msgspec

from hil.core.frames import Frame
from hil.links.messages import MAX_DATA_BYTES, MAX_EXTENDED_ID, MAX_STANDARD_ID
from hil.links.ports import Arrival, Discarded
from hil.links.sockets import dropped_datagrams

_TIMESPEC: Final = Struct("@ll")
"""Time stamp of SO_TIMESTAMPNS: seconds and nanoseconds since 1970."""
_ANCILLARY_BYTES: Final = socket.CMSG_SPACE(_TIMESPEC.size)

_CAN_FRAME: Final = Struct("=IB3x8s")
"""``struct can_frame`` of linux/can.h: identifier with flags, length, data."""
_EXTENDED: Final = 0x8000_0000  # linux/can.h: CAN_EFF_FLAG
_REMOTE: Final = 0x4000_0000  # linux/can.h: CAN_RTR_FLAG
_ERROR: Final = 0x2000_0000  # linux/can.h: CAN_ERR_FLAG

_MAX_DATAGRAM_BYTES: Final = 9000
"""Largest datagram that is read whole; that of a frame has about 200 bytes."""


class SocketBus(Protocol):
    """A bus of python-can with a socket of its own."""

    @property
    def socket(self) -> socket.socket:
        """Socket that is not blocking and stamps what it receives (SO_TIMESTAMPNS)."""

    def shutdown(self) -> None:
        """Close the bus."""


class _SocketPort:
    """What the ports of both kinds of sockets have in common."""

    holds_messages = False
    refused = 0
    """Number of frames that an adapter refused after it had taken them. A socket refuses at once."""

    def __init__(self, bus: SocketBus) -> None:
        self._bus = bus
        self._socket = bus.socket

    def dropped(self) -> int:
        """Return the number of messages that arrived and were lost because the kernel's queue was full."""
        return dropped_datagrams(self._socket)

    def fileno(self) -> int:
        """Return a descriptor for ``select``."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()


class CanSocketPort(_SocketPort):
    """A SocketCAN interface. The kernel does not deliver own frames."""

    def send(self, frame: Frame) -> None:
        """Hand ``frame`` to the bus. Raises OSError, with number EAGAIN or ENOBUFS if a queue is full."""
        identifier, data, is_extended, is_remote, is_error = frame
        if is_extended:
            identifier |= _EXTENDED
        if is_remote:
            identifier |= _REMOTE
        if is_error:
            identifier |= _ERROR
        self._socket.send(_CAN_FRAME.pack(identifier, len(data), data))

    def take(self) -> Arrival | Discarded | None:
        """Take the next frame that waits, if one does. Raises OSError if the interface is down or gone."""
        try:
            message, ancillary, _, _ = self._socket.recvmsg(_CAN_FRAME.size, _ANCILLARY_BYTES)
        except BlockingIOError:
            return None
        if len(message) != _CAN_FRAME.size or not ancillary:
            return Discarded.UNREADABLE
        word, length, data = _CAN_FRAME.unpack(message)
        is_extended, is_remote = word & _EXTENDED != 0, word & _REMOTE != 0
        frame = Frame(
            word & (MAX_EXTENDED_ID if is_extended else MAX_STANDARD_ID),
            bytes(min(length, MAX_DATA_BYTES)) if is_remote else data[:length],
            is_extended,
            is_remote,
            word & _ERROR != 0,
        )
        seconds, nanoseconds = _TIMESPEC.unpack(ancillary[0][2])
        return Arrival(frame, seconds * 1_000_000_000 + nanoseconds)


class _Datagram(msgspec.Struct, forbid_unknown_fields=True):
    """The attributes of a python-can message in its order and with its defaults, as it sends them by UDP."""

    timestamp: float = 0.0
    arbitration_id: int = 0
    is_extended_id: bool = True
    is_remote_frame: bool = False
    is_error_frame: bool = False
    channel: int | str | None = None
    dlc: int | None = None
    data: bytes | None = None
    is_fd: bool = False
    bitrate_switch: bool = False
    error_state_indicator: bool = False
    is_rx: bool = True

    def frame(self) -> Frame | None:
        """Return the frame; None if it is not classic CAN, or corrupt."""
        is_long = self.is_extended_id or self.is_error_frame
        data: bytes | None = self.data or b""
        if self.is_remote_frame:  # has a length and no data
            length = 0 if self.dlc is None else self.dlc
            data = bytes(length) if 0 <= length <= MAX_DATA_BYTES else None
        elif self.dlc not in (None, len(self.data or b"")):
            data = None
        if (
            data is None
            or len(data) > MAX_DATA_BYTES
            or self.is_fd
            or not 0 <= self.arbitration_id <= (MAX_EXTENDED_ID if is_long else MAX_STANDARD_ID)
        ):
            return None
        return Frame(
            self.arbitration_id, data, self.is_extended_id, self.is_remote_frame, self.is_error_frame
        )


class MulticastPort(_SocketPort):
    """UDP multicast. Each datagram is one message of python-can in MessagePack."""

    def __init__(self, bus: SocketBus, destination: tuple[str, int], name: str) -> None:
        """Datagrams go to ``destination``, group and port. ``name`` marks own frames."""
        super().__init__(bus)
        self._destination = destination
        self._name = name
        self._mark = name.encode()
        self._pack = msgspec.msgpack.Encoder().encode
        self._unpack = msgspec.msgpack.Decoder(_Datagram).decode

    def send(self, frame: Frame) -> None:
        """Hand ``frame`` to the bus. Raises OSError, with number EAGAIN or ENOBUFS if a queue is full."""
        identifier, data, is_extended, is_remote, is_error = frame
        self._socket.sendto(
            self._pack(
                {
                    "timestamp": 0.0,
                    "arbitration_id": identifier,
                    "is_extended_id": is_extended,
                    "is_remote_frame": is_remote,
                    "is_error_frame": is_error,
                    "channel": self._name,
                    "dlc": len(data),
                    "data": b"" if is_remote else data,
                    "is_fd": False,
                    "bitrate_switch": False,
                    "error_state_indicator": False,
                }
            ),
            self._destination,
        )

    def take(self) -> Arrival | Discarded | None:
        """Take the next datagram that waits, if one does. Raises OSError if the socket has failed."""
        try:
            datagram, ancillary, _, _ = self._socket.recvmsg(_MAX_DATAGRAM_BYTES, _ANCILLARY_BYTES)
        except BlockingIOError:
            return None
        if self._mark in datagram:
            return Discarded.OWN
        try:
            frame = self._unpack(datagram).frame()
        except (msgspec.DecodeError, UnicodeDecodeError):
            return Discarded.UNREADABLE
        if frame is None or not ancillary:
            return Discarded.UNREADABLE
        seconds, nanoseconds = _TIMESPEC.unpack(ancillary[0][2])
        return Arrival(frame, seconds * 1_000_000_000 + nanoseconds)
