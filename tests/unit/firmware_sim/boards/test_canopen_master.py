"""The ``canopen`` library as the master of the boards, over multicast (``tests/vcan``: over SocketCAN)."""

from __future__ import annotations

import socket

import can
import pytest
from support.canopen_master import CanopenMasterContract

from hil.links.host_multicast import HostMulticastBus


class TestOverMulticast(CanopenMasterContract):
    @pytest.fixture(scope="class")
    @classmethod
    def port(cls) -> int:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("", 0))
            return int(probe.getsockname()[1])

    @pytest.fixture(scope="class")
    @classmethod
    def spec(cls, port: int) -> str:
        return f"udp:{port}"

    @pytest.fixture(scope="class")
    @classmethod
    def bus(cls, port: int) -> can.BusABC:
        return HostMulticastBus(port)
