"""What a link does on any bus: the contract on a bus inside this process, timeouts, discarded messages."""

from collections.abc import Callable, Iterator

import can
import pytest
from can.interfaces.virtual import VirtualBus
from support.back_to_back import BackToBack, Ends, ManyNodes
from support.link_contract import ErrorFrameContract, LinkContract, Pair

from hil.core.frames import Frame
from hil.links import Link, open_link
from hil.links.link import MAX_DISCARDED_AFTER_TIMEOUT
from hil.links.ports import MessagePort


class TestInProcess(LinkContract, ErrorFrameContract):
    origin = "user"

    @pytest.fixture
    def pair(self) -> Iterator[Pair]:
        with open_link("inproc:contract") as one, open_link("inproc:contract") as other:
            yield one, other

    def test_names_separate_buses(self) -> None:
        with open_link("inproc:a") as one, open_link("inproc:b") as other:
            one.send(Frame(1))
            assert other.receive(0) is None


class TestInProcessBackToBack(BackToBack, ManyNodes):
    @pytest.fixture
    def spec(self) -> str:
        return "inproc:many"

    @pytest.fixture
    def ends(self) -> Iterator[Ends]:
        with open_link("inproc:back to back") as link, VirtualBus("back to back") as bus:
            yield link, bus


class BusyBus:
    """A bus on which a message always waits. Reading one takes ``takes_s`` seconds."""

    def __init__(self, message: can.Message | Exception, takes_s: float) -> None:
        self.message, self.takes_s = message, takes_s
        self.now_s = 100.0
        self.read_count = 0

    def recv(self, _timeout_s: float) -> can.Message | None:
        self.read_count += 1
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
"""One message of each kind that a link discards."""


class TestDiscarded:
    @pytest.fixture
    def link_to(self, monkeypatch: pytest.MonkeyPatch) -> Callable[[BusyBus], Link]:
        def open_bus(bus: BusyBus) -> Link:
            monkeypatch.setattr("hil.links.link.time.monotonic", lambda: bus.now_s)
            return Link("test", MessagePort(bus, OWN), "user")  # type: ignore[arg-type]

        return open_bus

    @pytest.mark.parametrize("message", DISCARDED, ids=str)
    @pytest.mark.parametrize("timeout_s", [0.0, 0.011])
    def test_a_call_returns_at_its_timeout_on_a_busy_bus(
        self, link_to: Callable[[BusyBus], Link], message: can.Message | Exception, timeout_s: float
    ) -> None:
        bus = BusyBus(message, takes_s=20e-6)
        link = link_to(bus)
        assert link.receive(timeout_s) is None
        assert timeout_s <= bus.now_s - 100.0 <= timeout_s + (MAX_DISCARDED_AFTER_TIMEOUT + 1) * 20e-6
        is_own = isinstance(message, can.Message) and message.channel == OWN
        assert link.unreadable == (0 if is_own else bus.read_count)

    def test_a_frame_behind_own_frames_is_received(self, link_to: Callable[[BusyBus], Link]) -> None:
        """A late gateway calls with a timeout of 0 and must receive the answer that waits behind its SYNC."""
        bus = BusyBus(DISCARDED[-1], takes_s=20e-6)
        link = link_to(bus)
        own_frames = MAX_DISCARDED_AFTER_TIMEOUT - 1

        def recv(timeout_s: float) -> can.Message | None:
            if bus.read_count < own_frames:
                return BusyBus.recv(bus, timeout_s)
            return can.Message(arbitration_id=2)

        bus.recv = recv  # type: ignore[method-assign]
        received = link.receive(0)
        assert received is not None
        assert received.frame == Frame(2, is_extended=True)


def test_a_frame_that_arrives_during_a_stall_is_received(monkeypatch: pytest.MonkeyPatch) -> None:
    """The boards must receive what came while they were stalled, before they serve what is due."""
    bus = BusyBus(can.Message(arbitration_id=2), takes_s=0.0)
    reads: list[can.Message | None] = [can.Message(arbitration_id=2), None]

    def recv(_timeout_s: float) -> can.Message | None:
        bus.now_s += 0.040  # the process is stalled, and a frame arrives
        return reads.pop()

    bus.recv = recv  # type: ignore[method-assign]
    monkeypatch.setattr("hil.links.link.time.monotonic", lambda: bus.now_s)
    monkeypatch.setattr("hil.links.link.select.select", lambda *_: None)
    received = Link("test", MessagePort(bus, OWN), "user").receive(0.011)  # type: ignore[arg-type]
    assert received is not None
    assert received.frame == Frame(2, is_extended=True)
