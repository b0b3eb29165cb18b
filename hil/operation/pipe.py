"""Messages between the loop and the socket process.

They go over a pair of connected sockets that keep the boundaries of messages (``SOCK_SEQPACKET``). Neither
side waits for the other: a message that does not fit is dropped by its sender. The kernel's buffers are the
bound.
"""

from __future__ import annotations

import socket

import msgspec

from hil.core.controller_change import PreparedController
from hil.core.setpoint_change import PreparedSetpoint
from hil.operation.protocol import LogLine, LoopCall, Status

MAX_MESSAGE_BYTES = 160 * 1024
"""Largest message. It holds a request of the largest line."""
REQUEST_BUFFER_BYTES = 208 * 1024
"""Kernel's buffer for requests, the default limit of an unprivileged process."""
STATUS_BUFFER_BYTES = 32 * 1024
"""Kernel's buffer for what the loop sends. A server that has stopped is noticed after some seconds."""


class Asked(msgspec.Struct, frozen=True, array_like=True, tag="asked"):
    """A request for the loop."""

    number: int
    """Number that the reply repeats. It is never used twice, also not by a restarted server."""
    asked_by: str
    """User and process of the client, for the recording."""
    call: LoopCall
    prepared: PreparedController | None = None
    """The controller of the request, read and checked."""
    tables: tuple[PreparedSetpoint, ...] = ()
    """The tables of the request's setpoints, read and checked."""


class Replied(msgspec.Struct, frozen=True, array_like=True, tag="reply"):
    """The loop's reply to a request."""

    number: int
    accepted: bool
    text: str


class StatusNow(msgspec.Struct, frozen=True, array_like=True, tag="status"):
    """The loop's present status."""

    status: Status


class Logged(msgspec.Struct, frozen=True, array_like=True, tag="log"):
    """A log entry of the loop."""

    line: LogLine


FromLoop = Replied | StatusNow | Logged


class Facts(msgspec.Struct, frozen=True):
    """Facts about the daemon that the server needs to check requests."""

    hil: str
    """Version of the program."""
    bus: str
    rig: str
    """Text of the rig file."""
    event_check: str | None = None
    """``module:function`` that is given the text of an event and the rig; None on a real bus.

    It raises HilError for an event that cannot happen.
    """


def pipe() -> tuple[socket.socket, socket.socket]:
    """Return the loop's end and the server's end. Neither blocks."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end, size in ((ours, STATUS_BUFFER_BYTES), (theirs, REQUEST_BUFFER_BYTES)):
        end.setblocking(False)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, size)
    return ours, theirs
