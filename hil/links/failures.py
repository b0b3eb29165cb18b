"""Explain why a link failed, and what to do about it."""

from __future__ import annotations

import errno
import os
import termios

from hil.core.errors import LinkError

_NO_LINE = "no serial line; name the adapter's device, such as slcan:/dev/ttyACM0 (ls /dev/serial/by-id)"


def cause_of(error: BaseException | None) -> OSError | None:
    """Return the operating system's error that caused an error of python-can; None if there is none.

    pyserial gives the error of a line that it cannot configure as the context alone.
    """
    while error is not None:
        if isinstance(error, termios.error):
            return OSError(*error.args)
        if isinstance(error, OSError) and error.errno is not None:
            return error
        number = getattr(error, "error_code", None)
        if number is not None:
            return OSError(number, os.strerror(number))
        error = error.__cause__ or error.__context__
    return None


def failure(spec: str, what: str, cause: OSError | None, error: BaseException | None) -> LinkError:
    """Return an error that says what failed on the link ``spec``, why, and what to do.

    The reason is that of ``cause``, or the text of ``error`` if there is no cause.
    """
    reason = os.strerror(cause.errno) if cause and cause.errno else str(error)
    target = spec.rpartition(":")[2]
    remedy = {
        errno.ENETDOWN: f"bring it up: sudo ip link set {target} up",
        errno.ENODEV: f"the interface is gone, or is no CAN interface; {creation(target)}",
        errno.ENXIO: f"the interface is gone; {creation(target)}",
        errno.ENOENT: "is the adapter plugged in? See: ls /dev/serial/by-id",
        errno.ENOTTY: _NO_LINE,
        errno.EISDIR: _NO_LINE,
        errno.EACCES: "this user may not open it; sudo adduser $USER dialout, then log in again",
        errno.EBUSY: "another program uses it",
        errno.EAGAIN: "another program uses it",
        errno.EADDRNOTAVAIL: "is the loopback interface up? sudo ip link set lo up",
        errno.EADDRINUSE: "another program uses the port; choose another number",
        errno.EIO: "the adapter was unplugged, or the other end closed the line",
    }.get(cause.errno or 0 if cause else 0)
    return LinkError(f"{spec}: {what}: {reason}" + (f"; {remedy}" if remedy else ""))


def in_hil_vcan(interface: str) -> str:
    """Return the advice to use ``hil vcan``; empty for an interface that it does not have."""
    return "; or run the command under `hil vcan -- …`" if interface == "vcan0" else ""


def creation(interface: str) -> str:
    """Return how to make a SocketCAN interface that is missing."""
    if interface.startswith("vcan"):
        return (
            f"make it: sudo ip link add dev {interface} type vcan && sudo ip link set {interface} up"
            f"{in_hil_vcan(interface)}"
        )
    return (
        f"plug the adapter in, then: sudo ip link set {interface} up type can bitrate 500000 "
        "(`ip -br link` lists the interfaces)"
    )
