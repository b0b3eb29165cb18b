"""One gateway per bus: take the bus on this machine, listen, and refuse a bus that another gateway uses.

Two gateways that begin at the same time could both listen, hear nothing, and then begin both. Two rules
prevent that:

1. A gateway holds the bus on this machine from before it listens until it ends. What it holds is the name of
   an abstract Unix-domain socket (unix(7)). In a network namespace, the kernel gives a name to one process
   only, and frees it when that process ends. A SocketCAN interface belongs to such a namespace too.
2. On a bus that other machines can share, the time of listening has a random part. Whoever listens for
   longer hears the SYNC of the other one, unless the two times differ by less than a period. In that case,
   both gateways see each other's frames, and fault before either can be armed.
"""

from __future__ import annotations

import contextlib
import os
import random
import socket
import struct
from collections.abc import Iterator
from time import monotonic

from hil.core.errors import LinkError
from hil.core.foreign_frames import OWN_IDENTIFIERS
from hil.links import Link
from hil.shells.real_bus import is_real

MAX_FRAMES = 10_000
"""Largest number of frames that are read while listening."""
MARGIN = 1.5
"""The time of listening is at least this many intervals of the gateway's heartbeat."""
MAX_RANDOM_S = 0.4
"""Longest random part of the time of listening, in seconds. It is many periods."""
LOCK_PREFIX = "\0hil-gateway:"
"""Beginning of the names of abstract sockets that stand for a bus."""
MAX_NAME = 100
"""Longest name of an abstract socket that is used, in characters; Linux allows 107 bytes."""
_CREDENTIALS = struct.Struct("3i")
_randomness = random.SystemRandom()


@contextlib.contextmanager
def sole_gateway(link: Link, heartbeat_interval_s: float) -> Iterator[None]:
    """Hold the bus of ``link`` as its only gateway, after listening to it.

    Raises LinkError if another gateway holds it on this machine, or is heard. Nothing is sent.
    """
    with _held(link.spec):
        refuse_other_gateway(link, heartbeat_interval_s)
        yield


def refuse_other_gateway(link: Link, heartbeat_interval_s: float) -> None:
    """Listen for longer than a heartbeat interval. Raises LinkError if another gateway is heard.

    Nothing is sent, so that a gateway that controls an arm is not disturbed.
    """
    random_s = _randomness.uniform(0.0, MAX_RANDOM_S) if is_real(link.spec) else 0.0
    _listen(link, MARGIN * heartbeat_interval_s + random_s)


def refuse_gateway_that_was_heard(link: Link) -> None:
    """Read the frames that wait. Raises LinkError if another gateway has sent one of them.

    Call this right before the first frame is sent, if it took time to prepare for that.
    """
    _listen(link, 0.0)


def _listen(link: Link, duration_s: float) -> None:
    end_s = monotonic() + duration_s
    for _ in range(MAX_FRAMES):
        received = link.receive(max(end_s - monotonic(), 0.0))
        if received is None:
            return
        frame = received.frame
        is_plain = not (frame.is_extended or frame.is_remote or frame.is_error)
        if is_plain and frame.id in OWN_IDENTIFIERS:
            raise LinkError(
                f"{link.spec}: another gateway is on this bus: its {OWN_IDENTIFIERS[frame.id]} frame "
                f"(0x{frame.id:03X}) was heard. Nothing was sent. End the other one first; `hil shutdown` "
                "ends a daemon of this machine"
            )


@contextlib.contextmanager
def _held(spec: str) -> Iterator[None]:
    """Hold the name of a bus on this machine. Raises LinkError if another process holds it."""
    name = lock_name(spec)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as lock:
        try:
            lock.bind(name)
        except OSError:
            raise LinkError(
                f"{spec}: {_holder(name)} of this machine is the gateway of this bus. Nothing was sent. End "
                "it first; `hil shutdown` ends a daemon"
            ) from None
        lock.listen(0)  # so that others can ask the kernel which process holds it
        yield


def lock_name(spec: str) -> str:
    """Return the name of the abstract socket that stands for the bus ``spec``, however it is written."""
    name = spec.removeprefix("socketcan:")
    if name.startswith("inproc:"):
        name = f"{os.getpid()}:{name}"  # another process has another bus of this name
    if name.startswith("slcan:"):
        name = f"slcan:{os.path.realpath(name.removeprefix('slcan:').partition('@')[0])}"
    return f"{LOCK_PREFIX}{name}"[:MAX_NAME]


def _holder(name: str) -> str:
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        probe.connect(name)
        data = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        return f"process {_CREDENTIALS.unpack(data)[0]}"
    return "another process"
