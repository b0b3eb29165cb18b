"""The contract of every link. A test class of one kind of link inherits it and provides ``pair``."""

import os
import select
import socket
import threading
import time

import msgpack
import pytest

from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.links import Link

Pair = tuple[Link, Link]

STRANGE_DATAGRAM = msgpack.packb(
    {"arbitration_id": 1.5, "data": b"", "dlc": 0, "is_extended_id": False}, use_bin_type=True
)
"""A datagram that python-can decodes into a message whose identifier is no integer."""

DATA = bytes(range(0xF8, 0x100))
KINDS = [
    *(Frame(0x123, DATA[:length]) for length in range(9)),
    *(Frame(0x1ABCDEF0, DATA[:length], is_extended=True) for length in range(9)),
    Frame(0x000),
    Frame(0x7FF, b"\x00"),
    Frame(0x000, b"\r\a", is_extended=True),
    Frame(0x1FFFFFFF, DATA, is_extended=True),
    Frame(0x321, is_remote=True),
    Frame(0x321, bytes(8), is_remote=True),
    Frame(0x321, bytes(3), is_extended=True, is_remote=True),
]


class LinkContract:
    """Tests for two links, ``pair``, on one bus."""

    origin: str
    """Clock that the link's time stamps must name."""

    def test_frames_of_every_kind_arrive_unaltered_and_in_order(self, pair: Pair) -> None:
        sender, receiver = pair
        for frame in KINDS:
            sender.send(frame)
        assert [arrived(receiver) for _ in KINDS] == KINDS
        assert receiver.receive(0) is None
        assert receiver.dropped() == 0
        assert sender.send_failures == 0

    def test_both_directions(self, pair: Pair) -> None:
        one, other = pair
        other.send(Frame(0x001, b"from other"[:8]))
        one.send(Frame(0x002, b"from one"[:8]))
        assert arrived(one) == Frame(0x001, b"from oth")
        assert arrived(other) == Frame(0x002, b"from one")

    def test_own_frames_are_not_received(self, pair: Pair) -> None:
        sender, receiver = pair
        for frame in KINDS:
            sender.send(frame)
        for _ in KINDS:
            arrived(receiver)
        receiver.send(Frame(0x7E5))
        assert arrived(sender) == Frame(0x7E5), "the first frame received is the other's"
        assert sender.receive(0) is None

    def test_frames_lost_in_a_burst_are_counted(self, pair: Pair) -> None:
        """It is sent from one processor: the loopback interface may reorder what two processors queue."""
        sender, receiver = pair
        count = 5000
        processors = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {min(processors)})
        for number in range(count):
            sender.send(Frame(0x100, number.to_bytes(8, "little")))
        os.sched_setaffinity(0, processors)
        numbers, end = [], time.monotonic() + 30
        while len(numbers) + sender.send_failures + receiver.dropped() < count and time.monotonic() < end:
            assert sender.receive(0) is None, "it also writes the rest of a frame that a line took in part"
            received = receiver.receive(0.1)
            if received is not None:
                numbers.append(int.from_bytes(received.frame.data, "little"))
        assert numbers == sorted(set(numbers))
        assert len(numbers) >= 100
        assert len(numbers) + sender.send_failures + receiver.dropped() == count

    def test_receive_returns_at_its_timeout(self, pair: Pair) -> None:
        _, receiver = pair
        start = time.monotonic()
        assert receiver.receive(0) is None
        at_once = time.monotonic()
        assert receiver.receive(0.05) is None
        end = time.monotonic()
        assert at_once - start < 0.5
        assert 0.05 <= end - at_once < 0.5

    def test_receive_wakes_when_a_frame_arrives(self, pair: Pair) -> None:
        near, far = pair
        rounds = 100

        def echo() -> None:
            for _ in range(rounds):
                far.send(arrived(far))

        thread = threading.Thread(target=echo, daemon=True)
        thread.start()
        times_s = []
        for number in range(rounds):
            start = time.perf_counter()
            near.send(Frame(number))
            assert arrived(near) == Frame(number)
            times_s.append(time.perf_counter() - start)
        thread.join()
        assert sorted(times_s)[rounds // 2] < 0.005, "a poll every few milliseconds would take longer"

    def test_stamps_lie_within_the_call_and_name_their_clock(self, pair: Pair) -> None:
        sender, receiver = pair
        start = time.time_ns()
        sender.send(Frame(0x10))
        received = receiver.receive(1)
        end = time.time_ns()
        assert received is not None
        rounding_ns = 1000  # python-can keeps time stamps as floats
        assert start - rounding_ns <= received.stamp_ns <= end + rounding_ns
        assert received.origin == self.origin

    def test_its_descriptor_is_readable_while_frames_wait(self, pair: Pair) -> None:
        sender, receiver = pair
        assert not select.select([receiver], [], [], 0)[0]
        sender.send(Frame(0x10))
        assert select.select([receiver], [], [], 1)[0]
        arrived(receiver)
        assert not select.select([receiver], [], [], 0)[0]

    def test_a_link_that_is_opened_again_works_and_keeps_its_counters(self, pair: Pair) -> None:
        one, other = pair
        one.send(Frame(0x001))
        assert arrived(other) == Frame(0x001)
        counters = (one.send_failures, one.dropped(), one.unreadable)
        one.reopen()
        assert (one.send_failures, one.dropped(), one.unreadable) == counters
        for sender, receiver in ((one, other), (other, one)):
            sender.send(Frame(0x002, b"back"))
            assert arrived(receiver) == Frame(0x002, b"back")
        assert one.receive(0) is None, "own frames from before are not received"

    def test_frames_of_both_directions_keep_their_order_while_both_send(self, pair: Pair) -> None:
        one, other = pair
        numbers: dict[Link, list[int]] = {one: [], other: []}
        for number in range(200):
            for sender, receiver in ((one, other), (other, one)):
                sender.send(Frame(0x100, number.to_bytes(2, "little")))
                numbers[receiver].append(int.from_bytes(arrived(receiver).data, "little"))
        assert numbers[one] == numbers[other] == list(range(200))

    def test_closing_twice_is_no_error_and_later_use_is_one(self, pair: Pair) -> None:
        link, _ = pair
        link.close()
        link.close()
        for use in (lambda: link.send(Frame(1)), lambda: link.receive(0), link.dropped, link.fileno):
            with pytest.raises(LinkError, match="closed"):
                use()

    def test_a_with_statement_closes(self, pair: Pair) -> None:
        with pair[0] as link:
            link.send(Frame(1))
        with pytest.raises(LinkError, match="closed"):
            link.send(Frame(1))


class ErrorFrameContract:
    """Tests for links that carry error frames too."""

    def test_error_frames_are_delivered_as_such(self, pair: Pair) -> None:
        sender, receiver = pair
        bus_off = Frame(0x040, bytes(8), is_error=True)
        sender.send(bus_off)
        assert arrived(receiver) == bus_off


def arrived(link: Link) -> Frame:
    received = link.receive(5)
    assert received is not None, "no frame within 5 s"
    return received.frame


def free_port() -> int:
    """Return a UDP port that no program uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def overflow(sender: Link, receiver: Link) -> tuple[int, int]:
    """Send 100 frames into a receive buffer that is too small; return how many arrived and were dropped."""
    with socket.socket(fileno=socket.dup(receiver.fileno())) as same:
        same.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 0)
    for number in range(100):
        sender.send(Frame(number))
    arrived_count = 0
    while receiver.receive(0):
        arrived_count += 1
    return arrived_count, receiver.dropped()
