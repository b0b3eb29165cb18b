"""The ``canopen`` library, an independent master, drives the simulated boards over SocketCAN."""

from __future__ import annotations

import can
import pytest
from support.canopen_master import CanopenMasterContract


@pytest.mark.vcan
class TestOverSocketCan(CanopenMasterContract):
    @pytest.fixture(scope="class")
    @classmethod
    def spec(cls) -> str:
        return "vcan0"

    @pytest.fixture(scope="class")
    @classmethod
    def bus(cls, spec: str) -> can.BusABC:
        return can.Bus(interface="socketcan", channel=spec)
