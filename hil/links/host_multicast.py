"""A UDP multicast bus that stays inside this host.

python-can joins the multicast group on the interface that the routing table selects, and fails without a
route. This bus joins the group on the loopback interface. No frame leaves the host, and no frame from another
host is received. Another program that uses python-can with the same group and port receives its frames.
"""

from __future__ import annotations

import socket
from typing import Final

from can import BusABC, CanInitializationError, CanProtocol
from can.interfaces.udp_multicast.bus import SO_TIMESTAMPNS, GeneralPurposeUdpMulticastBus, UdpMulticastBus

GROUP: Final = UdpMulticastBus.DEFAULT_GROUP_IPv4
_LOOPBACK: Final = "127.0.0.1"
_IP_MULTICAST_ALL: Final = 49  # linux: linux/in.h


class HostMulticastBus(UdpMulticastBus):
    """A bus of all programs on this host that open the same ``port``."""

    def __init__(self, port: int) -> None:
        """Open the bus on UDP port ``port``. Raises CanInitializationError."""
        self._multicast = _LoopbackMulticast(GROUP, port, hop_limit=0)
        BusABC.__init__(self, GROUP)
        self._can_protocol = CanProtocol.CAN_FD  # accepts CAN FD, so that the link counts and discards it

    @property
    def socket(self) -> socket.socket:
        """Socket of this bus, to set and read its options."""
        return self._multicast._socket


class _LoopbackMulticast(GeneralPurposeUdpMulticastBus):
    def _create_socket(self, address_family: socket.AddressFamily) -> socket.socket:
        sock = socket.socket(address_family, socket.SOCK_DGRAM)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, self.hop_limit)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(_LOOPBACK))
            sock.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            sock.bind((self.group, self.port))
            membership = socket.inet_aton(self.group) + socket.inet_aton(_LOOPBACK)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        except OSError as error:
            sock.close()
            raise CanInitializationError(str(error), error.errno) from error
        self.timestamp_nanosecond = True
        return sock
