"""Open a bus by its name."""

from __future__ import annotations

import os
import re
import socket
from typing import TYPE_CHECKING, Final, Literal

from hil.core.errors import LinkError
from hil.links.failures import cause_of, creation, failure, in_hil_vcan
from hil.links.ports import MessagePort, Port
from hil.links.sockets import prepare

if TYPE_CHECKING:
    import can

    from hil.links.socket_ports import SocketBus

Origin = Literal["hardware", "kernel", "user"]
"""Clock of a time stamp.

``hardware``: the adapter's. ``kernel``: the host's, when the kernel queued the frame. ``user``: the host's,
when this program read the frame.
"""

BUS_FORMS: Final = """\
  vcan0, can0, …               a SocketCAN interface (also socketcan:can0)
  slcan:/dev/ttyACM0[@115200]  a serial adapter that speaks the Lawicel protocol
  udp:43113                    UDP multicast inside this host, by port number"""
"""Forms of a bus's name, for help texts and messages.

``inproc:NAME``, a bus of all links in this process, is for tests and Python programs only: on a command line
no other node can join it.
"""

_DEFAULT_BAUD: Final = 115_200
DEFAULT_BIT_RATE: Final = 500_000
"""Bit rate of a bus behind a serial adapter, in bit/s, if the caller names none."""
_PORTS: Final = range(1024, 65536)


def check_name(spec: str) -> None:
    """Raise LinkError if ``spec`` has the form of no bus. Nothing is opened."""
    if not re.fullmatch(r"(socketcan:)?[\w.-]{1,15}|slcan:/.+|udp:\d{1,9}|inproc:.+", spec, re.ASCII):
        raise _no_bus(spec)


def _no_bus(spec: str) -> LinkError:
    return LinkError(f"{spec!r} names no bus. Use one of these forms:\n{BUS_FORMS}")


def open_port(spec: str, bit_rate: int | None = None) -> tuple[Port, Origin]:
    """Open the bus that ``spec`` names; return it with the clock of its time stamps. Raises LinkError.

    A serial adapter is set to ``bit_rate`` in bit/s; None means ``DEFAULT_BIT_RATE``. Other buses have their
    own.
    """
    import logging

    logging.getLogger("can").addHandler(logging.NullHandler())  # failures are reported by LinkError alone
    name = os.urandom(8).hex()  # marks own frames, which some buses deliver too
    scheme, colon, rest = spec.partition(":")
    if not colon:
        scheme, rest = "socketcan", spec
    if scheme == "socketcan" and re.fullmatch(r"[\w.-]{1,15}", rest, re.ASCII):
        from hil.links.socket_ports import CanSocketPort

        return CanSocketPort(_open_socketcan(spec, rest)), "kernel"
    if scheme == "slcan" and (match := re.fullmatch(r"(/[^@]+)(?:@(\d{4,7}))?", rest)):
        baud = int(match[2] or _DEFAULT_BAUD)
        return MessagePort(_open_slcan(spec, match[1], baud, bit_rate or DEFAULT_BIT_RATE), name), "user"
    if scheme == "udp" and re.fullmatch(r"\d{1,9}", rest, re.ASCII) and int(rest) in _PORTS:
        from hil.links.host_multicast import GROUP
        from hil.links.socket_ports import MulticastPort

        return MulticastPort(_open_udp(spec, int(rest)), (GROUP, int(rest)), name), "kernel"
    if scheme == "inproc" and rest:
        from hil.links.in_process import InProcessBus

        return MessagePort(InProcessBus(rest), name), "user"
    raise _no_bus(spec)


def _open_socketcan(spec: str, interface: str) -> SocketBus:
    try:
        socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        raise LinkError(
            f"{spec}: this kernel has no SocketCAN ({error.strerror}); load its module: sudo modprobe can-raw"
            f"{in_hil_vcan(interface)}"
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
    pending_error = bus.socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if pending_error:  # the interface is down
        bus.shutdown()
        raise failure(spec, "cannot be opened", OSError(pending_error, os.strerror(pending_error)), None)
    prepare(bus.socket)
    return bus


def _open_udp(spec: str, port: int) -> SocketBus:
    from can import CanError

    from hil.links.host_multicast import HostMulticastBus

    try:
        bus = HostMulticastBus(port)
    except (CanError, OSError) as error:
        raise failure(spec, "cannot be opened", cause_of(error), error) from None
    prepare(bus.socket)
    return bus


def _open_slcan(spec: str, device: str, baud: int, bit_rate: int) -> can.BusABC:
    from can import CanError

    from hil.links.lawicel import BIT_RATES, LawicelBus

    if bit_rate not in BIT_RATES:
        *most, last = map(str, BIT_RATES)
        raise LinkError(
            f"{spec}: a serial adapter cannot be set to {bit_rate} bit/s: the bit rates of the Lawicel "
            f"protocol are {', '.join(most)} and {last} bit/s; change bus.bit_rate in the rig file, or use a "
            "SocketCAN adapter"
        )
    try:
        return LawicelBus(device, baud, bit_rate)
    except (CanError, OSError, ValueError) as error:
        raise failure(spec, "cannot be opened", cause_of(error), error) from None
