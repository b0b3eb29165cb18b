"""The links that need no kernel CAN. SocketCAN passes the same contract in tests/vcan."""

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator

import can
import msgpack
import pytest
from can.interfaces.udp_multicast.utils import pack_message
from hypothesis import given
from hypothesis import strategies as st
from support.lawicel_adapters import TwoAdapters
from support.link_contract import ErrorFramesToo, LinkContract, Pair, arrived

from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.links import (
    FORMS,
    LAST_EXTENDED_ID,
    LAST_ID,
    MOST_DISCARDED,
    Link,
    Received,
    open_link,
)


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
            for strange in (b"", b"\x01", b"hello", b"\x81\xa2id\x01", STRANGE_IDENTIFIER):
                stranger.sendto(strange, ("239.74.163.2", port))
        pair[0].send(Frame(0x42))
        assert arrived(receiver) == Frame(0x42)
        assert (receiver.unreadable, receiver.dropped()) == (5, 0)

    def test_can_fd_frames_are_counted_and_skipped(self, pair: Pair) -> None:
        import can

        sender, receiver = pair
        sender._opened().send(can.Message(arbitration_id=1, is_fd=True, data=bytes(64)))
        sender.send(Frame(0x42))
        assert arrived(receiver) == Frame(0x42)
        assert (receiver.unreadable, receiver.dropped()) == (1, 0)

    def test_ports_separate_buses(self, pair: Pair) -> None:
        with open_link(f"udp:{free_port()}") as apart:
            pair[0].send(Frame(1))
            arrived(pair[1])
            assert apart.receive(0) is None

    def test_works_where_only_the_loopback_interface_is_up(self) -> None:
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

    def test_nothing_leaves_the_host_and_nothing_from_outside_is_heard(self) -> None:
        """A second interface carries the default route and a python-can bus of the same group and port."""
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
            b"t-10105\rt810105\rT2000000000\rr8000\r"
        )
        pair[0].send(Frame(0x42))
        assert arrived(receiver) == Frame(0x42)
        assert (receiver.unreadable, receiver.dropped()) == (9, 0)

    def test_an_unplugged_adapter_is_a_link_error(self, pair: Pair, adapters: TwoAdapters) -> None:
        link, _ = pair
        adapters.unplug(adapters.one)
        with pytest.raises(LinkError, match=r"slcan:/dev/pts/\d+: cannot receive: .*unplugged"):
            link.receive(5)
        with pytest.raises(LinkError, match=r"cannot send: .*unplugged"):
            link.send(Frame(1))

    def test_opened_anew_it_goes_on_and_so_do_its_counts(self, pair: Pair, adapters: TwoAdapters) -> None:
        sender, receiver = pair
        adapters.other.outgoing.append(b"t12\r")
        adapters.one.on_bus = False
        assert sender.send(Frame(1))
        assert sender.receive(0.5) is None
        assert receiver.receive(0.5) is None
        for link in pair:
            link.reopen()
        assert sender.send(Frame(0x42))
        assert arrived(receiver) == Frame(0x42)
        assert (sender.send_failures, receiver.unreadable) == (1, 1)
        adapters.unplug(adapters.one)
        with pytest.raises(LinkError):
            sender.reopen()
        with pytest.raises(LinkError, match="closed"):
            sender.send(Frame(1))

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


class Babbling:
    """A bus on which a message is read in ``takes_s``, and the next waits already."""

    def __init__(self, message: can.Message | Exception, takes_s: float) -> None:
        self.message, self.takes_s = message, takes_s
        self.now_s = 100.0
        self.read = 0

    def recv(self, _timeout_s: float) -> can.Message | None:
        self.read += 1
        self.now_s += self.takes_s
        if isinstance(self.message, Exception):
            raise self.message
        return self.message


OWN = "own"
DISCARDED = [
    can.CanOperationError("not a Lawicel frame"),
    can.Message(arbitration_id=1, is_fd=True, data=bytes(64)),
    can.Message(arbitration_id=-1),
    can.Message(arbitration_id=1, channel=OWN),
]
"""A message of each kind that a link discards."""


class TestDiscarded:
    @pytest.fixture
    def clock(self, monkeypatch: pytest.MonkeyPatch) -> Callable[[Babbling], Link]:
        def link_to(bus: Babbling) -> Link:
            monkeypatch.setattr("hil.links.time.monotonic", lambda: bus.now_s)
            link = Link("test", bus, "user")  # type: ignore[arg-type]
            link._name = OWN
            return link

        return link_to

    @pytest.mark.parametrize("message", DISCARDED, ids=str)
    @pytest.mark.parametrize("timeout_s", [0.0, 0.011])
    def test_a_call_returns_in_time_whatever_babbles(
        self, clock: Callable[[Babbling], Link], message: can.Message | Exception, timeout_s: float
    ) -> None:
        bus = Babbling(message, takes_s=20e-6)
        link = clock(bus)
        assert link.receive(timeout_s) is None
        assert timeout_s <= bus.now_s - 100.0 <= timeout_s + (MOST_DISCARDED + 1) * 20e-6
        is_own = isinstance(message, can.Message) and message.channel == OWN
        assert link.unreadable == (0 if is_own else bus.read)

    def test_own_frames_do_not_hide_what_waits_behind_them(self, clock: Callable[[Babbling], Link]) -> None:
        """A gateway that is late asks with no time to wait: the answer behind its own SYNC must come."""
        bus = Babbling(DISCARDED[-1], takes_s=20e-6)
        link = clock(bus)
        own_frames = MOST_DISCARDED - 1

        def recv(timeout_s: float) -> can.Message | None:
            return Babbling.recv(bus, timeout_s) if bus.read < own_frames else can.Message(arbitration_id=2)

        bus.recv = recv  # type: ignore[method-assign]
        received = link.receive(0)
        assert received is not None
        assert received.frame == Frame(2, is_extended=True)


def test_a_stall_after_the_last_look_hides_no_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """Boards that were kept waiting must hear what came meanwhile before they serve what is due."""
    bus = Babbling(can.Message(arbitration_id=2), takes_s=0.0)
    looks: list[can.Message | None] = [can.Message(arbitration_id=2), None]

    def recv(_timeout_s: float) -> can.Message | None:
        bus.now_s += 0.040  # the machine stalls, and the frame comes
        return looks.pop()

    bus.recv = recv  # type: ignore[method-assign]
    monkeypatch.setattr("hil.links.time.monotonic", lambda: bus.now_s)
    monkeypatch.setattr("hil.links.select.select", lambda *_: None)
    received = Link("test", bus, "user").receive(0.011)  # type: ignore[arg-type]
    assert received is not None
    assert received.frame == Frame(2, is_extended=True)


WHOLE_LINES = [b"t19084000400040001A5", b"t710105", b"T1ABCDEF02AABB", b"r1230", b"R1ABCDEF00"]
ANY_LINE = st.one_of(
    st.binary(max_size=40),
    st.text("0123456789abcdefABCDEFtTrR+-_ .", max_size=30).map(str.encode),
    st.builds(
        lambda line, place, byte: line[:place] + byte + line[place + 1 :],
        st.sampled_from(WHOLE_LINES), st.integers(0, 20), st.binary(max_size=2),
    ),
)  # fmt: skip
ANYTHING = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**63), 2**64 - 1), st.floats(), st.text(max_size=4),
    st.binary(max_size=70), st.lists(st.integers(-1, 256), max_size=9),
)  # fmt: skip
MESSAGE_KEYS = [
    "arbitration_id", "is_extended_id", "is_remote_frame", "is_error_frame", "channel", "dlc", "data",
    "is_fd", "bitrate_switch", "error_state_indicator", "timestamp", "check", "is_rx",
]  # fmt: skip
STRANGE_IDENTIFIER = msgpack.packb(
    {"arbitration_id": 1.5, "data": b"", "dlc": 0, "is_extended_id": False}, use_bin_type=True
)


def assert_sound(received: Received) -> None:
    """What the gateway may be given, and a recording can hold."""
    frame = received.frame
    assert 0 <= frame.id <= (LAST_EXTENDED_ID if frame.is_extended or frame.is_error else LAST_ID)
    assert [type(value) for value in frame] == [int, bytes, bool, bool, bool]
    assert len(frame.data) <= 8
    assert type(received.stamp_ns) is int


@pytest.fixture(scope="module")
def serial_line() -> Iterator[tuple[Link, int]]:
    with TwoAdapters() as adapters, open_link(f"slcan:{adapters.one.device}") as link:
        adapters.pause()
        yield link, adapters.one.line
        adapters.resume()


@pytest.fixture(scope="module")
def multicast() -> Iterator[tuple[Link, Callable[[bytes], None]]]:
    port = free_port()
    with (
        open_link(f"udp:{port}") as link,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        yield link, lambda data: stranger.sendto(data, ("239.74.163.2", port)) and None


class TestWhateverArrives:
    """Nothing but sound frames comes out of a link, and nothing is raised."""

    @given(lines=st.lists(ANY_LINE, max_size=8))
    def test_on_a_serial_line(self, serial_line: tuple[Link, int], lines: list[bytes]) -> None:
        link, line = serial_line
        os.write(line, b"".join(text + b"\r" for text in lines) + b"\rt7ED0\r")
        while (received := link.receive(5)) is not None and received.frame != Frame(0x7ED):
            assert_sound(received)
        assert received is not None, "the last frame was not received"

    @given(
        datagrams=st.lists(
            st.one_of(
                st.binary(max_size=80),
                st.dictionaries(st.sampled_from(MESSAGE_KEYS), ANYTHING).map(msgpack.packb),
            ),
            max_size=8,
        )
    )
    def test_on_udp(self, multicast: tuple[Link, Callable[[bytes], None]], datagrams: list[bytes]) -> None:
        link, send = multicast
        for datagram in [*datagrams, pack_message(can.Message(arbitration_id=0x7ED, is_extended_id=False))]:
            send(datagram)
        while (received := link.receive(5)) is not None and received.frame != Frame(0x7ED):
            assert_sound(received)
        assert received is not None, "the last frame was not received"


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
