"""The serial device with real bytes, through pyserial and the slcan interface of python-can."""

from __future__ import annotations

import os
import select
import termios
from collections.abc import Iterator

import can
import pytest
import serial
from can.interfaces.slcan import slcanBus

from firmware_sim.serial_device import SerialDevice
from hil.core.frames import Frame


@pytest.fixture
def device() -> Iterator[SerialDevice]:
    device = SerialDevice()
    yield device
    device.close()


@pytest.fixture
def bus(device: SerialDevice) -> Iterator[can.BusABC]:
    with slcanBus(device.path, bitrate=500_000, sleep_after_open=0) as bus:
        assert device.receive(0) is None  # handles the commands with which python-can opened the channel
        bus.flush()
        yield bus


FRAMES = [
    Frame(0x190, bytes(range(8))),
    Frame(0x000, b"\x01\x00"),
    Frame(0x080),
    Frame(0x1ABCDEF0, b"\r\a\r", is_extended=True),
]


def message(frame: Frame) -> can.Message:
    return can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=frame.is_extended)


@pytest.mark.parametrize("frame", FRAMES, ids=str)
def test_frames_from_the_host_reach_the_bus(device: SerialDevice, bus: can.BusABC, frame: Frame) -> None:
    bus.send(message(frame))
    received = device.receive(5)
    assert received is not None
    assert received.frame == frame


@pytest.mark.parametrize("frame", FRAMES, ids=str)
def test_frames_from_the_bus_reach_the_host(device: SerialDevice, bus: can.BusABC, frame: Frame) -> None:
    device.send(frame)
    received = bus.recv(5)
    assert received is not None
    assert (received.arbitration_id, bytes(received.data), received.is_extended_id) == frame[:3]


def test_bursts_arrive_complete_and_in_order(device: SerialDevice, bus: can.BusABC) -> None:
    for _ in range(5):
        burst = [Frame(number, bytes(4)) for number in range(100)]
        for frame in burst:
            bus.send(message(frame))
        received = [device.receive(5) for _ in burst]
        assert [r.frame for r in received if r] == burst


def test_the_adapter_answers_version_and_serial_number(device: SerialDevice) -> None:
    with serial.Serial(device.path, timeout=5) as host:
        host.write(b"\r\rV\rN\r")
        assert device.receive(0) is None
        assert host.read(14) == b"\r\rV1013\rNSIM1\r"


def test_hosts_can_open_the_device_one_after_another(device: SerialDevice) -> None:
    for number in range(3):
        with serial.Serial(device.path, timeout=5) as host:
            host.write(b"C\rS6\rO\rt%03X0\r" % number)
            received = device.receive(5)
            assert received is not None
            assert received.frame == Frame(number)


def test_a_host_that_never_reads_loses_frames_and_gets_the_overrun_flag(device: SerialDevice) -> None:
    with serial.Serial(device.path, timeout=5) as host:
        host.write(b"S6\rO\r")
        assert device.receive(0) is None
        sent = 2000
        for number in range(sent):
            device.send(Frame(number & 0x7FF, bytes(8)))
        lines: list[bytes] = []
        while device.receive(0) is None and select.select([host], [], [], 0)[0]:
            lines += host.read(host.in_waiting).split(b"\r")
        host.write(b"F\r")
        assert device.receive(0) is None
        assert host.read(4) == b"F01\r"
    frames = b"\r".join(lines).replace(b"\r", b"").count(b"t")
    assert 100 < frames < sent


def test_receive_returns_none_after_its_timeout(device: SerialDevice) -> None:
    assert device.receive(0.01) is None


def test_close_hangs_up_the_line_of_the_host() -> None:
    device = SerialDevice()
    host = os.open(device.path, os.O_RDWR | os.O_NOCTTY)
    device.close()
    assert os.read(host, 1) == b""
    with pytest.raises(termios.error):
        termios.tcgetattr(host)
    os.close(host)
