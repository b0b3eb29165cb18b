"""Options of a bus's socket: large buffers, and the number of messages that the kernel dropped."""

from __future__ import annotations

import socket
from typing import Final

_BUFFER_BYTES: Final = 1 << 20
"""Size of the send and receive buffers: room for one second of a busy bus with 1 Mbit/s."""
_SO_RCVBUFFORCE: Final = 33  # linux: asm-generic/socket.h
_SO_MEMINFO: Final = 55  # linux: asm-generic/socket.h
_SK_MEMINFO_DROPS: Final = 8  # linux: linux/sock_diag.h


def prepare(sock: socket.socket) -> None:
    """Make ``sock`` non-blocking and enlarge its buffers.

    A privileged process exceeds the host's limit net.core.rmem_max; any other gets what the limit allows.
    """
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_BYTES)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)


def dropped_datagrams(sock: socket.socket) -> int:
    """Return the number of messages that the kernel dropped because the receive buffer was full."""
    counters = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 64)
    return int.from_bytes(counters[_SK_MEMINFO_DROPS * 4 :][:4], "little")
