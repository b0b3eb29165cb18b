"""Links: one bus or serial line each, all through python-can, opened from a text such as ``vcan0``.

Lives here: the :class:`Link` that the shells use, and :func:`open_link`. The buses that python-can's own
do not serve well enough are in the modules beside; python-can itself is imported by the first open.
Does not live here: what the frames mean.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import select
import socket
import time
from types import TracebackType
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, Self

from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.links.failures import cause_of, creation, failure

if TYPE_CHECKING:
    import can

Origin = Literal["hardware", "kernel", "user"]

FORMS: Final = """\
  vcan0, can0, …               a SocketCAN interface (also socketcan:can0)
  slcan:/dev/ttyACM0[@115200]  a serial adapter that speaks the Lawicel protocol
  udp:43113                    UDP multicast inside this host, by port number
  inproc:NAME                  inside this process"""

LAST_ID: Final = 0x7FF
LAST_EXTENDED_ID: Final = 0x1FFF_FFFF
MOST_DISCARDED: Final = 32
"""Messages that a call discards beyond its time limit: own frames, say, before the one that waits."""

_FARTHEST_S: Final = 1e12
"""No stamp lies farther from 1970; nor does one that is no number."""
_BUFFER_BYTES: Final = 1 << 20
_SO_RCVBUFFORCE: Final = 33
_SO_MEMINFO: Final = 55
_SK_MEMINFO_DROPS: Final = 8
_FULL: Final = {errno.EAGAIN, errno.ENOBUFS, None}
"""Reasons why a frame was not taken that pass by themselves; python-can's "buffer full" has no number."""


class Received(NamedTuple):
    """A frame with the instant of its arrival, in nanoseconds since 1970.

    ``origin`` is the clock behind ``stamp_ns``: the adapter's (``hardware``), the kernel's when it queued
    the frame (``kernel``), or this program's when it read the frame (``user``).
    """

    frame: Frame
    stamp_ns: int
    origin: Origin


class Link:
    """An open bus. Sends without waiting, receives with a time limit, never hears its own frames."""

    def __init__(self, spec: str, bus: can.BusABC, origin: Origin) -> None:
        """``spec`` names the link in errors; ``bus`` is owned from here on."""
        from can import CanError, Message

        self.spec = spec
        self._bus: can.BusABC | None = bus
        self.stamp_origin: Origin = origin
        """Of every frame that this link receives."""
        self.unreadable = 0
        """What arrived and was no sound classic frame, since the link was opened."""
        self._full = 0
        self._dropped_before = 0
        self._name = os.urandom(8).hex()
        self._message = Message
        self._error = CanError

    def send(self, frame: Frame) -> bool:
        """Hand ``frame`` to the bus; False: a full queue refused it, which is counted, never waited for.

        Raises LinkError when the bus is gone.
        """
        bus = self._opened()
        message = self._message(
            arbitration_id=frame.id,
            data=frame.data,
            is_extended_id=frame.is_extended,
            is_remote_frame=frame.is_remote,
            is_error_frame=frame.is_error,
            channel=self._name,
        )
        try:
            bus.send(message)
        except self._error as error:
            cause = cause_of(error)
            if (cause and cause.errno) not in _FULL:
                raise failure(self.spec, "cannot send", cause, error) from None
            self._full += 1
            return False
        return True

    def receive(self, timeout_s: float) -> Received | None:
        """The next frame, or None when none came within ``timeout_s`` seconds (0: do not wait).

        Own frames and unreadable ones are discarded, but never for longer than that and ``MOST_DISCARDED``
        more: what babbles on the bus does not keep the caller. None is given only after a look when the time
        was up: a stall hides no frame. Raises LinkError when the bus is gone.
        """
        bus = self._opened()
        end = time.monotonic() + timeout_s
        discarded_late = 0
        while discarded_late < MOST_DISCARDED:
            left = end - time.monotonic()
            try:
                message = bus.recv(0)
            except self._error as error:
                cause = cause_of(error)
                if cause is not None:
                    raise failure(self.spec, "cannot receive", cause, error) from None
                self.unreadable += 1
            else:
                if message is None:
                    if left <= 0:
                        return None
                    select.select([bus], [], [], left)
                    continue
                if message.channel != self._name:
                    if _is_sound(message):
                        return Received(_frame(message), round(message.timestamp * 1e9), self.stamp_origin)
                    self.unreadable += 1
            if time.monotonic() >= end:
                discarded_late += 1
        return None

    @property
    def send_failures(self) -> int:
        """Frames that a full queue or the adapter refused, since the link was opened."""
        return self._full + getattr(self._bus, "refused", 0)

    def dropped(self) -> int:
        """Frames that arrived and were lost because the kernel's queue was full."""
        bus = self._opened()
        if not hasattr(bus, "socket"):
            return self._dropped_before
        raw = bus.socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 64)
        return self._dropped_before + int.from_bytes(raw[_SK_MEMINFO_DROPS * 4 :][:4], "little")

    def reopen(self) -> None:
        """Leave the bus and join it again; counts go on. Raises LinkError, and is then closed."""
        with contextlib.suppress(LinkError, OSError):
            self._dropped_before = self.dropped()
        self._full = self.send_failures
        self.close()
        again = open_link(self.spec)
        self._bus, again._bus = again._bus, None

    def fileno(self) -> int:
        """For select: readable when frames came. Then call ``receive(0)`` until it returns None."""
        return self._opened().fileno()

    def close(self) -> None:
        """Leave the bus; closing twice is no error."""
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.shutdown()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _opened(self) -> can.BusABC:
        if self._bus is None:
            raise LinkError(f"{self.spec}: the link is closed")
        return self._bus


def open_link(spec: str) -> Link:
    """Open the bus that ``spec`` names; the forms are in ``FORMS``. Raises LinkError."""
    import logging

    logging.getLogger("can").addHandler(logging.NullHandler())  # what went wrong is said here, once
    scheme, colon, rest = spec.partition(":")
    if not colon:
        scheme, rest = "socketcan", spec
    if scheme == "socketcan" and re.fullmatch(r"[\w.-]{1,15}", rest, re.ASCII):
        return _open_socketcan(spec, rest)
    if scheme == "slcan" and (match := re.fullmatch(r"(/[^@]+)(?:@(\d{4,7}))?", rest)):
        return _open_slcan(spec, match[1], int(match[2] or 115200))
    if scheme == "udp" and rest.isascii() and rest.isdigit() and 1024 <= int(rest) <= 65535:
        return _open_udp(spec, int(rest))
    if scheme == "inproc" and rest:
        from hil.links.in_process import InProcessBus

        return Link(spec, InProcessBus(rest), "user")
    raise LinkError(f"{spec!r} names no bus. A bus is one of\n{FORMS}")


def _open_socketcan(spec: str, interface: str) -> Link:
    try:
        socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        raise LinkError(
            f"{spec}: this kernel has no SocketCAN ({error.strerror}); run the command under "
            "`hil vcan -- …`, or load the module: sudo modprobe can-raw"
        ) from None
    try:
        socket.if_nametoindex(interface)
    except OSError:
        raise LinkError(f"{spec}: there is no interface {interface}; {creation(interface)}") from None
    from can.interfaces.socketcan import SocketcanBus

    try:
        bus = SocketcanBus(interface)
    except OSError as error:
        raise failure(spec, "cannot be opened", error, error) from None
    down = bus.socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if down:
        bus.shutdown()
        raise failure(spec, "cannot be opened", OSError(down, os.strerror(down)), None)
    _size_buffers(bus.socket)
    return Link(spec, bus, "kernel")


def _open_udp(spec: str, port: int) -> Link:
    from can import CanError

    from hil.links.host_multicast import HostMulticastBus

    try:
        bus = HostMulticastBus(port)
    except (CanError, OSError) as error:
        raise failure(spec, "cannot be opened", cause_of(error), error) from None
    _size_buffers(bus.socket)
    return Link(spec, bus, "kernel")


def _open_slcan(spec: str, device: str, baud: int) -> Link:
    from can import CanError

    from hil.links.lawicel import LawicelBus

    try:
        bus = LawicelBus(device, baud)
    except (CanError, OSError, ValueError) as error:
        raise failure(spec, "cannot be opened", cause_of(error), error) from None
    return Link(spec, bus, "user")


def _is_sound(message: can.Message) -> bool:
    """Whether it is a classic frame whose every part has its type and range: a stranger may send anything."""
    identifier, data = message.arbitration_id, message.data
    highest = LAST_EXTENDED_ID if message.is_extended_id or message.is_error_frame else LAST_ID
    return (
        not message.is_fd
        and isinstance(identifier, int)
        and 0 <= identifier <= highest
        and len(data) <= 8
        and (bool(message.is_remote_frame) or len(data) == message.dlc)
        and isinstance(message.timestamp, int | float)
        and abs(message.timestamp) < _FARTHEST_S
    )


def _frame(message: can.Message) -> Frame:
    return Frame(
        int(message.arbitration_id),
        bytes(message.data),
        bool(message.is_extended_id),
        bool(message.is_remote_frame),
        bool(message.is_error_frame),
    )


def _size_buffers(sock: socket.socket) -> None:
    """Room for a second of a busy 1 Mbit/s bus; without the right to force it, what the host allows."""
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_BYTES)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
