"""Who is at the other end of a connection to the daemon's socket, and may operate it."""

from __future__ import annotations

import contextlib
import os
import pwd
import socket
import struct
from pathlib import Path
from typing import NamedTuple

from hil.core.printable import printable

_CREDENTIALS = struct.Struct("3i")


class Peer(NamedTuple):
    """A client, as the kernel knows it."""

    process_id: int
    user_id: int

    def __str__(self) -> str:
        return f"{_user(self.user_id)} ({_program(self.process_id)}, process {self.process_id})"


def check_peer(connection: socket.socket) -> tuple[Peer, str | None]:
    """Return who is at the other end, and why it is not served, if so."""
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    process_id, user_id, _ = _CREDENTIALS.unpack(data)
    peer = Peer(process_id, user_id)
    if user_id in (0, os.getuid()):
        return peer, None
    owner = _user(os.getuid())
    return peer, f"user {_user(user_id)} may not operate this daemon, which belongs to {owner}"


def _user(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"uid {uid}"


def _program(pid: int) -> str:
    """Return the name that a program has given itself, without characters that could act on a terminal."""
    with contextlib.suppress(OSError):
        name = Path(f"/proc/{pid}/comm").read_text(errors="replace").rstrip("\n")
        return "".join("?" if c in "(),:" else c for c in printable(name))
    return "unknown program"
