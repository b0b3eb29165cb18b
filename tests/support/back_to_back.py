"""A link of this project and a bus of python-can on one cable: each receives what the other sends.

A test class of one kind of link inherits :class:`BackToBack` and provides ``ends``. It checks what python-can
promises of two buses on one cable: content in both directions, time stamps, periodic sending, many senders.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

import can
import pytest

from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.links import Link, Received, open_link
from hil.links.messages import frame_of
from support.link_contract import KINDS, arrived

Ends = tuple[Link, can.BusABC]


def message(frame: Frame) -> can.Message:
    """Return the message of python-can for a frame."""
    return can.Message(
        arbitration_id=frame.id,
        data=None if frame.is_remote else frame.data,
        dlc=len(frame.data),
        is_extended_id=frame.is_extended,
        is_remote_frame=frame.is_remote,
        check=True,
    )


def heard(bus: can.BusABC, wanted: Frame) -> Frame | None:
    """Return the next frame that python-can receives, without what it receives of its own."""
    end = time.monotonic() + 5
    while (left := end - time.monotonic()) > 0:
        received = bus.recv(left)
        if received is not None and (frame := frame_of(received)) == wanted:
            return frame
    return None


def received(link: Link) -> Received:
    """Return what the link receives next, with its time stamp."""
    result = link.receive(5)
    assert result is not None, "no frame within 5 s"
    return result


class BackToBack:
    """Tests for a link and a bus of python-can, ``ends``, on one bus."""

    def test_frames_of_every_kind_pass_in_both_directions(self, ends: Ends) -> None:
        link, bus = ends
        for frame in KINDS:
            assert link.send(frame)
            assert heard(bus, frame) == frame
            other = frame._replace(id=frame.id ^ 1)
            bus.send(message(other))
            assert arrived(link) == other
            assert link.receive(0) is None

    def test_nothing_is_received_if_nothing_was_sent(self, ends: Ends) -> None:
        link, bus = ends
        assert link.receive(0.1) is None
        assert bus.recv(0.1) is None

    def test_time_stamps_differ_by_the_time_between_two_frames(self, ends: Ends) -> None:
        link, bus = ends
        stamps, times = [], []
        for number in range(2):
            times.append(time.time_ns())
            bus.send(message(Frame(number)))
            stamps.append(received(link).stamp_ns)
            assert link.receive(0.2) is None
        assert abs((stamps[1] - stamps[0]) - (times[1] - times[0])) < 150_000_000
        assert stamps[1] - stamps[0] >= 190_000_000

    def test_time_stamps_are_absolute_and_finer_than_a_second(self, ends: Ends) -> None:
        link, bus = ends
        stamps = []
        for number in range(3):
            bus.send(message(Frame(number)))
            result = received(link)
            assert abs(result.stamp_ns - time.time_ns()) < 1_000_000_000
            stamps.append(result.stamp_ns)
        assert any(stamp % 1_000_000_000 for stamp in stamps)
        assert stamps == sorted(stamps)

    def test_a_periodic_task_sends_for_its_duration_only(self, ends: Ends) -> None:
        link, bus = ends
        frame = Frame(0x123, b"\x01\x02")
        bus.send_periodic(message(frame), period=0.02, duration=0.2)
        stamps = [received(link).stamp_ns]
        while (result := link.receive(0.5)) is not None:
            assert result.frame == frame
            stamps.append(result.stamp_ns)
        assert 2 <= len(stamps) <= 12
        assert stamps[-1] - stamps[0] < 0.35e9

    def test_a_notifier_of_python_can_hears_the_link(self, ends: Ends) -> None:
        link, bus = ends
        listener = can.BufferedReader()
        notifier = can.Notifier(bus, [listener], timeout=0.1)
        try:
            assert link.send(Frame(0x42, b"\x07"))
            found = listener.get_message(5)
        finally:
            notifier.stop()
        assert found is not None
        assert (found.arbitration_id, bytes(found.data)) == (0x42, b"\x07")


class ManyNodes:
    """Tests for buses that more than two nodes can join. A test class provides ``spec``, the bus' name."""

    @pytest.fixture
    def join(self, spec: str) -> Iterator[Callable[[], Link]]:
        with contextlib.ExitStack() as stack:
            yield lambda: stack.enter_context(open_link(spec))

    def test_each_node_receives_a_copy_of_its_own(self, join: Callable[[], Link]) -> None:
        sender, *receivers = (join() for _ in range(4))
        frame = Frame(0x300, b"\x02\x01\x03")
        sender.send(frame)
        copies = [arrived(receiver) for receiver in receivers]
        assert copies == [frame] * 3
        assert all(receiver.receive(0) is None for receiver in receivers)

    def test_frames_of_many_senders_arrive_all_and_each_senders_in_order(
        self, join: Callable[[], Link]
    ) -> None:
        receiver, *senders = (join() for _ in range(6))
        count = 40
        for number in range(count):
            for place, sender in enumerate(senders):
                assert sender.send(Frame(0x100 + place, number.to_bytes(2, "little")))
        numbers: dict[int, list[int]] = {}
        for _ in range(count * len(senders)):
            frame = arrived(receiver)
            numbers.setdefault(frame.id, []).append(int.from_bytes(frame.data, "little"))
        assert numbers == {0x100 + place: list(range(count)) for place in range(len(senders))}

    def test_a_node_that_leaves_does_not_disturb_the_others(self, join: Callable[[], Link]) -> None:
        one, other, leaving = (join() for _ in range(3))
        leaving.send(Frame(1))
        leaving.close()
        one.send(Frame(2))
        assert [arrived(other), arrived(other)] == [Frame(1), Frame(2)]


class Unplugging:
    """Tests for links whose bus can be gone.

    A test class provides ``pair``, two links of which the first one loses its bus, and :meth:`unplug` and
    :meth:`plug_in`.
    """

    def unplug(self) -> None:
        """Take the bus of the first link away."""
        raise NotImplementedError

    def plug_in(self) -> None:
        """Give it back."""
        raise NotImplementedError

    def test_a_link_without_its_bus_raises_an_error_that_names_it(self, pair: tuple[Link, Link]) -> None:
        link, _ = pair
        self.unplug()
        with pytest.raises(LinkError, match=f"{link.spec}: cannot receive: "):
            link.receive(5)
        with pytest.raises(LinkError, match=f"{link.spec}: cannot send: "):
            link.send(Frame(1))
        with pytest.raises(LinkError, match=link.spec):
            link.reopen()
        with pytest.raises(LinkError, match=f"{link.spec}: the link is closed"):
            link.receive(0)
        self.plug_in()

    def test_a_link_works_again_when_its_bus_is_back(self, pair: tuple[Link, Link]) -> None:
        link, other = pair
        link.send(Frame(1))
        assert arrived(other) == Frame(1)
        counters = (link.send_failures, link.dropped(), link.unreadable)
        self.unplug()
        with pytest.raises(LinkError):
            link.receive(5)
        with pytest.raises(LinkError):
            link.reopen()
        self.plug_in()
        link.reopen()
        with contextlib.suppress(LinkError):
            other.receive(0)  # an interface that went down reports it once
        other.reopen()
        for sender, receiver in ((link, other), (other, link)):
            assert sender.send(Frame(0x42, b"back"))
            assert arrived(receiver) == Frame(0x42, b"back")
        assert (link.send_failures, link.dropped(), link.unreadable) == counters
