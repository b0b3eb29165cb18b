"""SocketCAN passes the contract of links and reports the kernel's errors."""

import contextlib
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from can.interfaces.slcan import slcanBus
from can.interfaces.socketcan import SocketcanBus
from support.back_to_back import BackToBack, Ends, ManyNodes, Unplugging
from support.lawicel_adapters import Adapter, TwoAdapters
from support.link_contract import KINDS, ErrorFrameContract, LinkContract, Pair, arrived, overflow

from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.core.wire.frame_bits import bits_on_wire
from hil.links import open_link

RECEIVERS = Path("/proc/net/can/rcvlist_all")


def wait_for_receivers(count: int) -> None:
    deadline = time.monotonic() + 5
    while RECEIVERS.read_text().count(" vcan0 ") < count:
        assert time.monotonic() < deadline, RECEIVERS.read_text()


def wait_for_interface(name: str) -> None:
    """Wait until slcand has made an interface, and bring it up."""
    deadline = time.monotonic() + 5
    while subprocess.run(["ip", "link", "set", name, "up"], stderr=subprocess.DEVNULL).returncode:
        assert time.monotonic() < deadline, "slcand made no interface"


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)


@contextlib.contextmanager
def slcand_on(adapter: Adapter, name: str) -> Iterator[None]:
    """Make the adapter an interface of the kernel until the block ends."""
    slcand = subprocess.Popen(["slcand", "-F", "-o", "-c", "-s6", adapter.device, name])
    wait_for_interface(name)
    yield
    slcand.terminate()
    assert slcand.wait(timeout=5) == 0


class TestSocketCan(LinkContract, ErrorFrameContract):
    origin = "kernel"

    @pytest.fixture
    def pair(self) -> Iterator[Pair]:
        with open_link("vcan0") as one, open_link("socketcan:vcan0") as other:
            yield one, other

    def test_frames_lost_in_a_full_queue_are_counted(self, pair: Pair) -> None:
        received, dropped = overflow(*pair)
        assert 0 < received < 100
        assert dropped == 100 - received

    def test_candump_reads_what_a_link_sends(self, pair: Pair) -> None:
        with subprocess.Popen(
            ["candump", "-L", "-n", str(len(KINDS)), "vcan0"], stdout=subprocess.PIPE, text=True
        ) as candump:
            assert candump.stdout is not None
            wait_for_receivers(3)
            for frame in KINDS:
                pair[0].send(frame)
            seen = [line.split()[-1] for line in candump.stdout]
        assert seen == [str(frame) for frame in KINDS]

    def test_a_link_reads_what_cansend_sends(self, pair: Pair) -> None:
        for frame in KINDS:
            subprocess.run(["cansend", "vcan0", str(frame)], check=True)
            assert arrived(pair[0]) == frame


class TestKernelSlcan(LinkContract):
    """A serial adapter as an interface that slcand makes; the other link is another serial adapter."""

    origin = "kernel"

    @pytest.fixture
    def pair(self) -> Iterator[Pair]:
        with (
            TwoAdapters() as adapters,
            slcand_on(adapters.one, "slcan8"),
            open_link(f"slcan:{adapters.other.device}") as one,
            open_link("slcan8") as other,
        ):
            yield one, other


class TestSocketCanBackToBack(BackToBack, ManyNodes):
    @pytest.fixture
    def spec(self) -> str:
        return "vcan0"

    @pytest.fixture
    def ends(self) -> Iterator[Ends]:
        with open_link("vcan0") as link, SocketcanBus("vcan0") as bus:
            yield link, bus


class TestKernelSlcanBackToBack(BackToBack):
    """python-can at the serial line, the link at the kernel's interface."""

    @pytest.fixture
    def ends(self) -> Iterator[Ends]:
        with (
            TwoAdapters() as adapters,
            slcand_on(adapters.one, "slcan6"),
            slcanBus(adapters.other.device, bitrate=500_000, sleep_after_open=0) as bus,
            open_link("slcan6") as link,
        ):
            while not adapters.other.on_bus:
                bus.recv(0.01)
            yield link, bus


class TestInterfaceThatGoesDown(Unplugging):
    @pytest.fixture
    def pair(self) -> Iterator[Pair]:
        ip("link", "add", "dev", "vcan6", "type", "vcan")
        self.plug_in()
        with open_link("vcan6") as one, open_link("vcan6") as other:
            yield one, other
        ip("link", "delete", "vcan6")

    def unplug(self) -> None:
        ip("link", "set", "vcan6", "down")

    def plug_in(self) -> None:
        ip("link", "set", "vcan6", "up")


class TestInterfaceThatDisappears(Unplugging):
    """The interface is removed, as when a USB adapter is unplugged."""

    @pytest.fixture
    def pair(self) -> Iterator[Pair]:
        self.plug_in()
        with open_link("vcan5") as one, open_link("vcan5") as other:
            yield one, other
        ip("link", "delete", "vcan5")

    def unplug(self) -> None:
        ip("link", "delete", "vcan5")

    def plug_in(self) -> None:
        ip("link", "add", "dev", "vcan5", "type", "vcan")
        ip("link", "set", "vcan5", "up")


class TestKernelSlcanUnplugged(Unplugging):
    """The adapter is unplugged, slcand ends, and its interface disappears."""

    adapters: TwoAdapters
    slcand: contextlib.ExitStack

    @pytest.fixture
    def pair(self) -> Iterator[Pair]:
        with TwoAdapters() as adapters, contextlib.ExitStack() as slcand:
            type(self).adapters, type(self).slcand = adapters, slcand
            slcand.enter_context(slcand_on(adapters.one, "slcan5"))
            with open_link("slcan5") as one, open_link(f"slcan:{adapters.other.device}") as other:
                yield one, other

    def unplug(self) -> None:
        self.slcand.close()
        self.adapters.unplug(self.adapters.one)

    def plug_in(self) -> None:
        self.adapters.plug_in(self.adapters.one)
        self.slcand.enter_context(slcand_on(self.adapters.one, "slcan5"))


class TestInterface:
    @pytest.fixture
    def interface(self) -> Iterator[str]:
        ip("link", "add", "dev", "vcan7", "type", "vcan")
        ip("link", "set", "vcan7", "up")
        yield "vcan7"
        subprocess.run(["ip", "link", "delete", "vcan7"], stderr=subprocess.DEVNULL)

    def test_one_that_goes_down_is_a_link_error_with_the_remedy(self, interface: str) -> None:
        with open_link(interface) as link:
            ip("link", "set", interface, "down")
            with pytest.raises(LinkError) as caught:
                link.receive(5)
            assert str(caught.value) == (
                "vcan7: cannot receive: Network is down; bring it up: sudo ip link set vcan7 up"
            )
            with pytest.raises(LinkError, match="cannot send: Network is down"):
                link.send(Frame(1))

    def test_a_link_that_is_opened_again_works_when_the_interface_is_up_again(self, interface: str) -> None:
        with open_link(interface) as link, open_link(interface) as other:
            ip("link", "set", interface, "down")
            with pytest.raises(LinkError):
                link.receive(5)
            with pytest.raises(LinkError, match="cannot be opened: Network is down"):
                link.reopen()
            with pytest.raises(LinkError, match="closed"):
                link.send(Frame(1))
            ip("link", "set", interface, "up")
            link.reopen()
            other.reopen()
            assert link.send(Frame(0x42))
            assert arrived(other) == Frame(0x42)

    def test_one_that_is_down_is_a_link_error_with_the_remedy(self, interface: str) -> None:
        ip("link", "set", interface, "down")
        with pytest.raises(LinkError, match="cannot be opened: Network is down; bring it up"):
            open_link(interface)

    def test_one_that_disappears_is_a_link_error(self, interface: str) -> None:
        with open_link(interface) as link:
            ip("link", "delete", interface)
            with pytest.raises(LinkError, match="cannot receive"):
                link.receive(5)
            with pytest.raises(LinkError, match="cannot send"):
                link.send(Frame(1))

    def test_the_message_about_a_missing_one_says_how_to_make_it(self) -> None:
        with pytest.raises(LinkError) as caught:
            open_link("vcan9")
        assert str(caught.value) == (
            "vcan9: there is no interface vcan9; make it: sudo ip link add dev vcan9 type vcan && "
            "sudo ip link set vcan9 up"
        )

    def test_one_of_another_kind_is_a_link_error(self) -> None:
        with pytest.raises(LinkError, match="lo: cannot be opened: No such device"):
            open_link("lo")


def test_slcand_and_a_serial_link_are_two_ends_of_one_bus() -> None:
    with (
        TwoAdapters() as adapters,
        slcand_on(adapters.one, "slcan7"),
        open_link("slcan7") as one,
        open_link(f"slcan:{adapters.other.device}") as other,
    ):
        for frame in KINDS:
            one.send(frame)
            assert arrived(other) == frame
            other.send(frame)
            assert arrived(one) == frame
    assert b"S6" in adapters.one.commands


def test_the_length_of_frames_is_that_of_canbusload() -> None:
    """can-utils counts data bits for a remote frame that asks for data, although it carries none."""
    frames = [frame for frame in KINDS if not frame.is_remote or not frame.data]
    with (
        subprocess.Popen(
            ["canbusload", "-e", "vcan0@500000"], stdout=subprocess.PIPE, text=True
        ) as canbusload,
        open_link("vcan0") as link,
    ):
        assert canbusload.stdout is not None
        wait_for_receivers(2)
        for frame in frames:
            link.send(frame)
        total = (0, 0)
        while total[0] < len(frames):
            match = re.search(r"vcan0@500000 +(\d+) +(\d+)", canbusload.stdout.readline())
            if match is not None:
                total = (total[0] + int(match[1]), total[1] + int(match[2]))
        canbusload.terminate()
    assert total == (len(frames), sum(map(bits_on_wire, frames)))
