"""The links that need no kernel CAN. SocketCAN passes the same contract in tests/vcan."""

import socket
import subprocess
import sys
from collections.abc import Iterator

import pytest
from support.lawicel_adapters import TwoAdapters
from support.link_contract import ErrorFramesToo, LinkContract, Pair, arrived

from hil.errors import LinkError
from hil.frames import Frame
from hil.links import FORMS, open_link


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


class TestInProcess(LinkContract, ErrorFramesToo):
    origin = "user"

    @pytest.fixture
    def pair(self) -> Iterator[Pair]:
        with open_link("inproc:contract") as one, open_link("inproc:contract") as other:
            yield one, other

    def test_names_separate_buses(self) -> None:
        with open_link("inproc:a") as one, open_link("inproc:b") as other:
            one.send(Frame(1))
            assert other.receive(0) is None


class TestUdp(LinkContract, ErrorFramesToo):
    origin = "kernel"

    @pytest.fixture
    def port(self) -> int:
        return free_port()

    @pytest.fixture
    def pair(self, port: int) -> Iterator[Pair]:
        with open_link(f"udp:{port}") as one, open_link(f"udp:{port}") as other:
            yield one, other

    def test_there_is_more_room_for_a_burst_than_sockets_have_by_themselves(self, pair: Pair) -> None:
        with (
            socket.socket(fileno=socket.dup(pair[0].fileno())) as ours,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as usual,
        ):
            for buffer in (socket.SO_RCVBUF, socket.SO_SNDBUF):
                assert ours.getsockopt(socket.SOL_SOCKET, buffer) > usual.getsockopt(
                    socket.SOL_SOCKET, buffer
                )

    def test_frames_lost_in_a_full_queue_are_counted(self, pair: Pair) -> None:
        sender, receiver = pair
        with socket.socket(fileno=socket.dup(receiver.fileno())) as same:
            same.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 0)
        for number in range(100):
            sender.send(Frame(number))
        heard = 0
        while receiver.receive(0):
            heard += 1
        assert 0 < heard < 100
        assert receiver.dropped() == 100 - heard

    def test_strange_datagrams_are_counted_and_skipped(self, pair: Pair, port: int) -> None:
        _, receiver = pair
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            for strange in (b"", b"\x01", b"hello", b"\x81\xa2id\x01"):
                stranger.sendto(strange, ("239.74.163.2", port))
        pair[0].send(Frame(0x42))
        assert arrived(receiver) == Frame(0x42)
        assert receiver.dropped() == 4

    def test_can_fd_frames_are_counted_and_skipped(self, pair: Pair) -> None:
        import can

        sender, receiver = pair
        sender._opened().send(can.Message(arbitration_id=1, is_fd=True, data=bytes(64)))
        sender.send(Frame(0x42))
        assert arrived(receiver) == Frame(0x42)
        assert receiver.dropped() == 1

    def test_ports_separate_buses(self, pair: Pair) -> None:
        with open_link(f"udp:{free_port()}") as apart:
            pair[0].send(Frame(1))
            arrived(pair[1])
            assert apart.receive(0) is None

    def test_works_where_only_the_loopback_interface_is_up(self) -> None:
        program = (
            "from hil.links import open_link; from hil.frames import Frame\n"
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

    def test_nothing_leaves_the_host_and_nothing_from_outside_is_heard(self) -> None:
        """A second interface carries the default route and a python-can bus of the same group and port."""
        network = (
            "ip link set lo up && ip link add v0 type veth peer name v1 && ip link set v1 up && "
            "ip address add 198.51.100.1/24 dev v0 && ip link set v0 up && ip route add default dev v0"
        )
        program = (
            "import can; from hil.links import open_link; from hil.frames import Frame\n"
            "def sent(): return int(next(l for l in open('/proc/net/dev') if 'v0:' in l).split()[10])\n"
            "outside = can.Bus(interface='udp_multicast', channel='239.74.163.2', port=43113)\n"
            "before = sent()\n"
            "with open_link('udp:43113') as one, open_link('udp:43113') as other:\n"
            "    for _ in range(200): outside.send(can.Message(arbitration_id=0x666))\n"
            "    seen_outside = sent() - before\n"
            "    for _ in range(200): one.send(Frame(0x5A))\n"
            "    heard = [other.receive(1).frame.id for _ in range(200)]\n"
            "    left = sent() - before - seen_outside\n"
            "    print(set(heard), other.receive(0), seen_outside >= 200, left < 50)\n"
            "outside.shutdown()\n"
        )
        done = subprocess.run(
            ["unshare", "-rn", "sh", "-c", f'{network} && exec "$@"', "-", sys.executable, "-c", program],
            capture_output=True,
            text=True,
        )
        assert (done.stdout, done.returncode) == ("{90} None True True\n", 0), done.stderr

    def test_a_datagram_to_another_address_is_not_heard(self, pair: Pair, port: int) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as direct:
            direct.sendto(b"unicast", ("127.0.0.1", port))
        pair[0].send(Frame(0x42))
        assert arrived(pair[1]) == Frame(0x42)
        assert pair[1].dropped() == 0


class TestSlcan(LinkContract):
    origin = "user"

    @pytest.fixture
    def adapters(self) -> Iterator[TwoAdapters]:
        with TwoAdapters() as adapters:
            yield adapters

    @pytest.fixture
    def pair(self, adapters: TwoAdapters) -> Iterator[Pair]:
        with (
            open_link(f"slcan:{adapters.one.device}") as one,
            open_link(f"slcan:{adapters.other.device}") as other,
        ):
            yield one, other

    def test_sets_the_bit_rate_and_goes_on_the_bus_and_off(self, adapters: TwoAdapters) -> None:
        adapter = adapters.one
        with open_link(f"slcan:{adapter.device}@230400"):
            assert adapter.commands == [b"C", b"S6", b"O"]
            assert adapter.on_bus

    def test_frames_that_the_adapter_refuses_are_counted(self, pair: Pair, adapters: TwoAdapters) -> None:
        sender, _ = pair
        adapters.one.on_bus = False
        sender.send(Frame(1))
        assert sender.receive(0.5) is None
        assert sender.send_failures == 1

    def test_a_full_line_is_counted_and_frames_stay_whole(self, pair: Pair, adapters: TwoAdapters) -> None:
        sender, receiver = pair
        adapters.pause()
        taken = []
        for number in range(10_000):
            failures = sender.send_failures
            sender.send(Frame(number & 0x7FF, number.to_bytes(8, "little")))
            if sender.send_failures == failures:
                taken.append(number)
        assert 100 < len(taken) < 10_000
        adapters.resume()
        numbers = []
        while len(numbers) < len(taken):
            assert sender.receive(0) is None
            frame = arrived(receiver)
            numbers.append(int.from_bytes(frame.data, "little"))
            assert frame.id == numbers[-1] & 0x7FF
        assert numbers == taken
        assert receiver.receive(0.1) is None
        assert receiver.dropped() == 0

    def test_a_frame_that_the_line_took_in_part_is_finished_without_another(
        self, pair: Pair, adapters: TwoAdapters
    ) -> None:
        sender, receiver = pair
        adapters.pause()
        number = 0
        while not sender._bus._unsent:  # type: ignore[union-attr]
            failures = sender.send_failures
            while sender.send_failures == failures:
                sender.send(Frame(0x100, bytes(number % 8)))  # of changing length, to end within a frame
                number += 1
            adapters.resume()
            while receiver.receive(0.2) is not None:
                pass
            adapters.pause()
        adapters.resume()
        last = Frame(0x100, bytes((number - 2) % 8))
        assert sender.receive(0) is None
        assert arrived(receiver) == last
        assert not sender._bus._unsent  # type: ignore[union-attr]

    def test_noise_is_counted_and_skipped(self, pair: Pair, adapters: TwoAdapters) -> None:
        _, receiver = pair
        adapters.other.outgoing.append(
            b"t12\rtXYZ0\rt1238AABB\rT12\r\xff\xfe\rt\xff\rV1013\r" + bytes(300) + b"\r"
        )
        pair[0].send(Frame(0x42))
        assert arrived(receiver) == Frame(0x42)
        assert receiver.dropped() == 5

    def test_an_unplugged_adapter_is_a_link_error(self, pair: Pair, adapters: TwoAdapters) -> None:
        link, _ = pair
        adapters.unplug(adapters.one)
        with pytest.raises(LinkError, match=r"slcan:/dev/pts/\d+: cannot receive: .*unplugged"):
            link.receive(5)
        with pytest.raises(LinkError, match=r"cannot send: .*unplugged"):
            link.send(Frame(1))

    def test_a_device_that_does_not_answer_is_a_link_error(
        self, adapters: TwoAdapters, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("hil.links.lawicel._BOOT_S", 0.1)
        adapters.one.deaf_to = 1000
        with pytest.raises(LinkError, match="does not answer"):
            open_link(f"slcan:{adapters.one.device}")

    def test_an_adapter_that_restarts_on_opening_is_waited_for(self, adapters: TwoAdapters) -> None:
        adapters.one.deaf_to = 2
        with open_link(f"slcan:{adapters.one.device}"):
            assert adapters.one.on_bus

    def test_an_adapter_without_500_kbit_s_is_a_link_error(self, adapters: TwoAdapters) -> None:
        adapters.one.refused.add(b"S6")
        with pytest.raises(LinkError, match="refused 500 kbit/s"):
            open_link(f"slcan:{adapters.one.device}")

    def test_an_adapter_has_one_user(self, pair: Pair, adapters: TwoAdapters) -> None:
        with pytest.raises(LinkError, match="another program uses it"):
            open_link(f"slcan:{adapters.one.device}")


NO_BUSES = [
    "",
    "udp:",
    "udp:x",
    "udp:65536",
    "udp:1023",
    "can0:1",
    "inproc:",
    "socketcan:",
    "can 0",
    "slcan:",
]
NO_BUSES += [
    "a name too long for Linux",
    "slcan:",
    "slcan:ttyACM0",
    "slcan:/dev/ttyACM0@fast",
    "serial:/dev/x",
]


@pytest.mark.parametrize("spec", NO_BUSES)
def test_a_spec_that_names_no_bus_is_answered_with_the_forms(spec: str) -> None:
    with pytest.raises(LinkError) as caught:
        open_link(spec)
    assert str(caught.value) == f"{spec!r} names no bus. A bus is one of\n{FORMS}"


@pytest.mark.parametrize("port", [1024, 65535])
def test_the_first_and_the_last_port_are_buses(port: int) -> None:
    with open_link(f"udp:{port}") as link:
        assert link.spec == f"udp:{port}"


def test_a_missing_serial_device_says_where_to_look() -> None:
    with pytest.raises(LinkError) as caught:
        open_link("slcan:/dev/ttyNONE")
    assert str(caught.value) == (
        "slcan:/dev/ttyNONE: cannot be opened: No such file or directory; "
        "is the adapter plugged in? See: ls /dev/serial/by-id"
    )


def test_a_device_that_is_no_serial_line_is_a_link_error() -> None:
    with pytest.raises(LinkError, match=r"^slcan:/dev/null: cannot be opened: "):
        open_link("slcan:/dev/null")


def test_links_cost_nothing_before_the_first_is_opened() -> None:
    program = "import sys, hil.links; print('can' in sys.modules, 'serial' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "False False\n"
