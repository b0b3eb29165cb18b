"""UDP multicast inside this host passes the contract of links, and counts what it cannot read."""

import socket
import subprocess
import sys
from collections.abc import Iterator

import can
import msgpack
import pytest
from can.interfaces.udp_multicast.utils import pack_message
from support.back_to_back import BackToBack, Ends, ManyNodes
from support.link_contract import (
    KINDS,
    STRANGE_DATAGRAM,
    ErrorFrameContract,
    LinkContract,
    Pair,
    arrived,
    free_port,
    overflow,
)

from hil.core.frames import Frame
from hil.links import open_link
from hil.links.host_multicast import HostMulticastBus
from hil.links.messages import frame_of


class TestUdp(LinkContract, ErrorFrameContract):
    origin = "kernel"

    @pytest.fixture
    def port(self) -> int:
        return free_port()

    @pytest.fixture
    def pair(self, port: int) -> Iterator[Pair]:
        with open_link(f"udp:{port}") as one, open_link(f"udp:{port}") as other:
            yield one, other

    def test_the_buffers_are_larger_than_those_of_other_sockets(self, pair: Pair) -> None:
        with (
            socket.socket(fileno=socket.dup(pair[0].fileno())) as ours,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as usual,
        ):
            for buffer in (socket.SO_RCVBUF, socket.SO_SNDBUF):
                assert ours.getsockopt(socket.SOL_SOCKET, buffer) > usual.getsockopt(
                    socket.SOL_SOCKET, buffer
                )

    def test_frames_lost_in_a_full_queue_are_counted(self, pair: Pair) -> None:
        received, dropped = overflow(*pair)
        assert 0 < received < 100
        assert dropped == 100 - received

    def test_unreadable_datagrams_are_counted_and_discarded(self, pair: Pair, port: int) -> None:
        _, receiver = pair
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            for datagram in (b"", b"\x01", b"hello", b"\x81\xa2id\x01", STRANGE_DATAGRAM):
                stranger.sendto(datagram, ("239.74.163.2", port))
        pair[0].send(Frame(0x42))
        assert arrived(receiver) == Frame(0x42)
        assert (receiver.unreadable, receiver.dropped()) == (5, 0)

    def test_can_fd_frames_are_counted_and_discarded(self, pair: Pair, port: int) -> None:
        sender, receiver = pair
        with HostMulticastBus(port) as bus:
            bus.send(can.Message(arbitration_id=1, is_fd=True, data=bytes(64)))
        sender.send(Frame(0x42))
        assert arrived(receiver) == Frame(0x42)
        assert (receiver.unreadable, receiver.dropped()) == (1, 0)

    def test_python_can_reads_what_a_link_sends_and_a_link_what_python_can_sends(
        self, pair: Pair, port: int
    ) -> None:
        sender, receiver = pair
        with HostMulticastBus(port) as bus:
            for frame in KINDS:
                sender.send(frame)
                message = bus.recv(5)
                assert message is not None
                assert frame_of(message) == frame
                arrived(receiver)
                bus.send(message)
                assert bus.recv(5) is not None, "multicast delivers own messages too"
                assert arrived(receiver) == frame

    @pytest.mark.parametrize("frame", [Frame(0x123, bytes(8)), Frame(0x1ABCDEF0, b"\1", is_extended=True)])
    def test_a_datagram_has_the_bytes_of_python_can(self, pair: Pair, port: int, frame: Frame) -> None:
        with HostMulticastBus(port) as bus:
            pair[0].send(frame)
            datagram = bus.socket.recv(9000)
        (name,) = {value for value in msgpack.unpackb(datagram).values() if isinstance(value, str)}
        message = can.Message(
            arbitration_id=frame.id, data=frame.data, is_extended_id=frame.is_extended, channel=name
        )
        assert datagram == pack_message(message)

    def test_ports_separate_buses(self, pair: Pair) -> None:
        with open_link(f"udp:{free_port()}") as other_bus:
            pair[0].send(Frame(1))
            arrived(pair[1])
            assert other_bus.receive(0) is None

    def test_it_works_with_the_loopback_interface_alone(self) -> None:
        program = (
            "from hil.links import open_link; from hil.core.frames import Frame\n"
            "with open_link('udp:43113') as a, open_link('udp:43113') as b:\n"
            "    a.send(Frame(0x5A)); print(b.receive(5).frame)\n"
        )
        done = subprocess.run(
            [
                "unshare",
                "-rn",
                "sh",
                "-c",
                'ip link set lo up && exec "$@"',
                "-",
                sys.executable,
                "-c",
                program,
            ],
            capture_output=True,
            text=True,
        )
        assert (done.stdout, done.returncode) == ("05A#\n", 0), done.stderr

    def test_no_frame_leaves_the_host_and_none_from_outside_is_received(self) -> None:
        """A second interface has the default route and a python-can bus with the same group and port."""
        network = (
            "ip link set lo up && ip link add v0 type veth peer name v1 && ip link set v1 up && "
            "ip address add 198.51.100.1/24 dev v0 && ip link set v0 up && ip route add default dev v0"
        )
        program = (
            "import can; from hil.links import open_link; from hil.core.frames import Frame\n"
            "def sent(): return int(next(l for l in open('/proc/net/dev') if 'v0:' in l).split()[10])\n"
            "outside = can.Bus(interface='udp_multicast', channel='239.74.163.2', port=43113)\n"
            "before = sent()\n"
            "with open_link('udp:43113') as one, open_link('udp:43113') as other:\n"
            "    for _ in range(200): outside.send(can.Message(arbitration_id=0x666))\n"
            "    seen_outside = sent() - before\n"
            "    for _ in range(200): one.send(Frame(0x5A))\n"
            "    received = [other.receive(1).frame.id for _ in range(200)]\n"
            "    left = sent() - before - seen_outside\n"
            "    print(set(received), other.receive(0), seen_outside >= 200, left < 50)\n"
            "outside.shutdown()\n"
        )
        done = subprocess.run(
            ["unshare", "-rn", "sh", "-c", f'{network} && exec "$@"', "-", sys.executable, "-c", program],
            capture_output=True,
            text=True,
        )
        assert (done.stdout, done.returncode) == ("{90} None True True\n", 0), done.stderr

    def test_a_datagram_to_another_address_is_not_received(self, pair: Pair, port: int) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as direct:
            direct.sendto(b"unicast", ("127.0.0.1", port))
        pair[0].send(Frame(0x42))
        assert arrived(pair[1]) == Frame(0x42)
        assert pair[1].dropped() == 0


class TestUdpBackToBack(BackToBack, ManyNodes):
    @pytest.fixture
    def port(self) -> int:
        return free_port()

    @pytest.fixture
    def spec(self, port: int) -> str:
        return f"udp:{port}"

    @pytest.fixture
    def ends(self, port: int) -> Iterator[Ends]:
        with open_link(f"udp:{port}") as link, HostMulticastBus(port) as bus:
            yield link, bus
