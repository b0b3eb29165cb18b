"""The modelled CAN bus: bit times, arbitration, queues, error frames and counters, bus-off, recovery."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.frames import Frame
from hil.core.wire.frame_bits import bits_on_wire
from hil.links.bus_model.bus import NEVER, CanBus
from hil.links.bus_model.controller import Controller, ErrorState, priority

BIT_NS = 2_000
"""One bit at 500 kbit/s."""


class Bench:
    """A bus with three nodes, and what has arrived."""

    def __init__(self, bit_rate: int = 500_000, nodes: int = 3) -> None:
        self.bus = CanBus(bit_rate)
        self.nodes = [Controller(f"node {number}") for number in range(nodes)]
        for node in self.nodes:
            self.bus.add(node, 0)
        self.now_ns = 0
        self.arrived: list[tuple[int, Frame]] = []
        self.changes: list[tuple[int, str, ErrorState]] = []

    def send(self, node: int, *frames: Frame) -> list[bool]:
        return [self.bus.send(self.nodes[node], frame, self.now_ns) for frame in frames]

    def run(self, until_ns: int = NEVER - 1) -> list[Frame]:
        """Advance, and return the frames that arrived."""
        before = len(self.arrived)
        while self.bus.next_event_ns <= until_ns:
            assert self.bus.next_event_ns >= self.now_ns, "time does not go back"
            self.now_ns = self.bus.next_event_ns
            frame, sender, changed = self.bus.advance(self.now_ns)
            if frame is not None:
                assert sender in self.nodes
                self.arrived.append((self.now_ns, frame))
            self.changes += [(self.now_ns, node.name, node.state) for node in changed]
        self.now_ns = max(self.now_ns, until_ns) if until_ns < NEVER - 1 else self.now_ns
        return [frame for _, frame in self.arrived[before:]]

    def destroy(self, count: int, bit: int = 20, sender: str = "") -> None:
        """Destroy the next frames, or those of one sender."""
        left = [count]

        def disturbance(name: str, _bits: int) -> int | None:
            if sender not in ("", name) or left[0] == 0:
                return None
            left[0] -= 1
            return bit

        self.bus.disturbances.append(disturbance)


class TestTimes:
    def test_a_frame_arrives_at_its_last_bit_and_the_next_one_begins_after_three_more(self) -> None:
        bench = Bench()
        first, second = Frame(0x190, bytes(8)), Frame(0x191, b"\x55")
        bench.send(0, first, second)
        bench.run()
        end_ns = (bits_on_wire(first) - 3) * BIT_NS
        assert bench.arrived == [
            (end_ns, first),
            (end_ns + bits_on_wire(second) * BIT_NS, second),
        ]
        assert bench.bus.busy_ns == (bits_on_wire(first) + bits_on_wire(second)) * BIT_NS

    @pytest.mark.parametrize("bit_rate", [10_000, 83_333, 125_000, 800_000, 1_000_000])
    def test_times_scale_with_the_bit_rate(self, bit_rate: int) -> None:
        bench = Bench(bit_rate)
        bench.send(0, Frame(0))
        bench.run()
        (time_ns, _) = bench.arrived[0]
        assert time_ns == -(-(53 - 3) * 1_000_000_000 // bit_rate)

    def test_a_bus_without_frames_has_no_event(self) -> None:
        bench = Bench()
        assert bench.bus.next_event_ns == NEVER
        bench.send(0, Frame(0))
        bench.run()
        assert bench.bus.next_event_ns == NEVER
        assert not bench.bus.is_busy


class TestArbitration:
    @pytest.mark.parametrize(
        ("wins", "loses"),
        [
            (Frame(0x080), Frame(0x081)),
            (Frame(0x080), Frame(0x080, is_remote=True)),
            (Frame(0x080), Frame(0x080 << 18, is_extended=True)),
            (Frame(0x080, is_remote=True), Frame(0x080 << 18, is_extended=True)),
            (Frame(0x080 << 18, is_extended=True), Frame(0x081)),
            (Frame(0x080 << 18, is_extended=True), Frame(0x080 << 18, is_extended=True, is_remote=True)),
            (Frame(5, is_extended=True, is_remote=True), Frame(6, is_extended=True)),
        ],
        ids=str,
    )
    def test_the_dominant_bits_win_whoever_sends_first(self, wins: Frame, loses: Frame) -> None:
        bench = Bench()
        bench.send(0, loses)
        bench.send(1, wins)
        assert bench.run() == [wins, loses]

    def test_a_frame_on_the_wire_is_not_interrupted(self) -> None:
        bench = Bench()
        bench.send(0, Frame(0x700, bytes(8)))
        bench.run(until_ns=10 * BIT_NS)
        bench.send(1, Frame(0x001))
        assert [frame.id for frame in bench.run()] == [0x700, 0x001]

    def test_a_queue_is_first_in_first_out_whatever_the_priority(self) -> None:
        bench = Bench()
        bench.send(0, Frame(0x700), Frame(0x001))
        bench.send(1, Frame(0x600))
        assert [frame.id for frame in bench.run()] == [0x600, 0x700, 0x001]

    @settings(max_examples=60, deadline=None)
    @given(st.lists(st.integers(0, 0x7FF), min_size=1, max_size=8, unique=True))
    def test_frames_of_many_nodes_arrive_by_identifier(self, identifiers: list[int]) -> None:
        bench = Bench(nodes=len(identifiers))
        for node, identifier in enumerate(identifiers):
            bench.send(node, Frame(identifier))
        if len(identifiers) > 1:  # a single node would not be acknowledged
            assert [frame.id for frame in bench.run()] == sorted(identifiers)

    def test_the_priority_orders_frames_as_their_bits_on_the_wire(self) -> None:
        source = random.Random(5)
        for _ in range(500):
            one, other = (
                Frame(source.randrange(2**29) if extended else source.randrange(2**11), b"", extended, remote)
                for extended, remote in [(source.random() < 0.5, source.random() < 0.5) for _ in range(2)]
            )
            bits = [arbitration_bits(frame) for frame in (one, other)]
            assert (priority(one) < priority(other)) == (bits[0] < bits[1])


def arbitration_bits(frame: Frame) -> str:
    """Return the arbitration field as text of 0 and 1; a dominant bit is 0."""
    remote = str(int(frame.is_remote))
    if frame.is_extended:
        return f"{frame.id >> 18:011b}11{frame.id & 0x3FFFF:018b}{remote}"
    return f"{frame.id:011b}{remote}0"


class TestQueues:
    def test_a_full_queue_refuses_frames_and_counts_them(self) -> None:
        bench = Bench()
        assert bench.send(0, *(Frame(number) for number in range(12))) == [True] * 10 + [False] * 2
        assert bench.nodes[0].refused == 2
        assert len(bench.run()) == 10

    def test_a_frame_leaves_the_queue_when_it_was_sent(self) -> None:
        bench = Bench()
        bench.send(0, *(Frame(number) for number in range(10)))
        bench.run(until_ns=60 * BIT_NS)
        assert bench.send(0, Frame(0), Frame(0)) == [True, False]


class TestErrors:
    def test_a_destroyed_frame_is_repeated_after_the_error_frame(self) -> None:
        bench = Bench()
        bench.destroy(1, bit=30)
        bench.send(0, Frame(0x190, bytes(8)))
        bench.run()
        (time_ns, frame) = bench.arrived[0]
        assert frame == Frame(0x190, bytes(8))
        assert time_ns == (30 + 20 + 3 + bits_on_wire(frame) - 3) * BIT_NS
        assert bench.bus.error_frames == 1

    def test_an_error_adds_8_for_the_sender_and_1_for_receivers_and_a_good_frame_subtracts_1(self) -> None:
        bench = Bench()
        bench.destroy(2)
        bench.send(0, Frame(1))
        bench.run()
        sender, *receivers = bench.nodes
        assert (sender.tec, sender.rec) == (15, 0)
        assert [(node.tec, node.rec) for node in receivers] == [(0, 1), (0, 1)]

    def test_another_node_of_higher_priority_sends_before_the_repetition(self) -> None:
        bench = Bench()
        bench.destroy(1)
        bench.send(0, Frame(0x100))
        bench.run(until_ns=BIT_NS)
        bench.send(1, Frame(0x001))
        assert [frame.id for frame in bench.run()] == [0x001, 0x100]

    def test_states_follow_the_counters_up_to_bus_off(self) -> None:
        bench = Bench()
        bench.nodes[0].restarts = False
        bench.destroy(1000, sender="node 0")
        bench.send(0, Frame(1))
        bench.run()
        states = [state for _, name, state in bench.changes if name == "node 0"]
        assert states == [ErrorState.ERROR_WARNING, ErrorState.ERROR_PASSIVE, ErrorState.BUS_OFF]
        assert bench.bus.error_frames == 32, "256 in steps of 8"
        assert bench.nodes[0].tec == 256
        assert bench.nodes[1].rec == 32
        assert bench.send(0, Frame(2)) == [False]
        assert bench.nodes[0].refused == 2, "the frame that was being sent, and the new one"

    def test_an_error_passive_sender_waits_eight_bits_more(self) -> None:
        bench = Bench()
        bench.destroy(16)
        bench.send(0, Frame(0x100), Frame(0x101))
        bench.run()
        assert bench.nodes[0].tec == 126
        times = [time_ns for time_ns, _ in bench.arrived]
        error_ns = (20 + 20 + 3) * BIT_NS
        frame_ns = bits_on_wire(Frame(0x100)) * BIT_NS
        assert times[0] == 16 * error_ns + 8 * BIT_NS + frame_ns - 3 * BIT_NS
        # 128 - 1 is error-active again
        assert times[1] - times[0] == bits_on_wire(Frame(0x101)) * BIT_NS

    def test_another_node_sends_during_that_wait_even_with_lower_priority(self) -> None:
        bench = Bench()
        bench.destroy(16, sender="node 0")
        bench.send(0, Frame(0x100))
        bench.run(until_ns=(16 * 43 + 1) * BIT_NS)
        bench.send(1, Frame(0x700))
        assert [frame.id for frame in bench.run()] == [0x700, 0x100]

    def test_a_receiver_that_was_passive_is_active_after_a_good_frame(self) -> None:
        bench = Bench()
        bench.nodes[1].rec = 200
        bench.bus.remove(bench.nodes[1], 0)
        bench.bus.add(bench.nodes[1], 0)
        bench.send(0, Frame(1))
        bench.run()
        assert bench.nodes[1].rec == 127
        assert bench.nodes[1].state is ErrorState.ERROR_WARNING

    def test_a_node_that_is_alone_repeats_for_ever_and_becomes_passive_but_not_bus_off(self) -> None:
        bench = Bench(nodes=1)
        bench.send(0, Frame(0x100))
        bench.run(until_ns=1_000_000_000)
        assert bench.arrived == []
        assert bench.nodes[0].tec == 128
        assert bench.nodes[0].state is ErrorState.ERROR_PASSIVE
        assert len(bench.nodes[0].queue) == 1

    def test_its_attempts_end_at_the_acknowledgement_that_is_missing(self) -> None:
        bench = Bench(nodes=1)
        bench.send(0, Frame(0x100))
        attempt = bits_on_wire(Frame(0x100)) - 11 + 14 + 3
        passive = attempt + 8
        end_ns = (16 * attempt + 10 * passive - 3) * BIT_NS
        bench.run(until_ns=end_ns - 1)
        assert bench.bus.error_frames == 25
        bench.run(until_ns=end_ns)
        assert bench.bus.error_frames == 26

    def test_its_frame_is_sent_when_another_node_joins(self) -> None:
        bench = Bench(nodes=1)
        bench.send(0, Frame(0x100))
        bench.run(until_ns=10_000_000)
        other = Controller("other")
        bench.bus.add(other, bench.now_ns)
        assert bench.run() == [Frame(0x100)]

    def test_a_node_that_leaves_destroys_its_frame_and_the_others_count_an_error(self) -> None:
        bench = Bench()
        bench.send(0, Frame(0x100))
        bench.run(until_ns=10 * BIT_NS)
        bench.bus.remove(bench.nodes[0], bench.now_ns)
        bench.send(1, Frame(0x200))
        assert bench.run() == [Frame(0x200)]
        assert bench.arrived[0][0] == (10 + 20 + 3 + bits_on_wire(Frame(0x200)) - 3) * BIT_NS
        assert bench.nodes[2].rec == 0, "one error and one good frame"
        assert len(bench.nodes[0].queue) == 1, "it waits for the bus to come back"


class TestRecovery:
    def bus_off(self, *, restarts: bool) -> Bench:
        bench = Bench()
        bench.nodes[0].restarts = restarts
        bench.destroy(32, sender="node 0")
        bench.send(0, Frame(1))
        bench.run(until_ns=next_bus_off_ns())
        assert bench.nodes[0].is_bus_off
        return bench

    def test_an_idle_bus_takes_128_times_11_bits(self) -> None:
        bench = self.bus_off(restarts=True)
        off_ns = bench.changes[-1][0]
        bench.run()
        time_ns, name, state = bench.changes[-1]
        assert (name, state) == ("node 0", ErrorState.ERROR_ACTIVE)
        assert time_ns - off_ns == (3 + 128 * 11) * BIT_NS
        assert (bench.nodes[0].tec, bench.nodes[0].rec) == (0, 0)
        assert bench.send(0, Frame(2)) == [True]
        assert bench.run() == [Frame(2)]

    def test_on_a_busy_bus_each_frame_counts_once(self) -> None:
        bench = self.bus_off(restarts=True)
        while bench.nodes[0].is_bus_off:
            bench.send(1, Frame(0x100))
            bench.run(until_ns=bench.bus.next_event_ns)
        sent = len(bench.arrived)
        assert sent == 128

    def test_idle_time_between_frames_counts_too(self) -> None:
        bench = self.bus_off(restarts=True)
        bench.run(until_ns=bench.now_ns + 64 * 11 * BIT_NS)
        bench.send(1, Frame(0x100))
        bench.run()
        off_ns, back_ns = (time_ns for time_ns, _, _ in bench.changes[-2:])
        waited_bits = (back_ns - off_ns) // BIT_NS
        assert (
            128 * 11 + bits_on_wire(Frame(0x100)) - 11
            <= waited_bits
            <= 128 * 11 + bits_on_wire(Frame(0x100)) + 11
        )

    def test_a_controller_that_does_not_restart_waits_for_it(self) -> None:
        bench = self.bus_off(restarts=False)
        bench.run(until_ns=bench.now_ns + 1_000_000_000)
        assert bench.nodes[0].is_bus_off
        bench.bus.restart(bench.nodes[0], bench.now_ns)
        begun_ns = bench.now_ns
        bench.run()
        assert bench.changes[-1] == (begun_ns + 128 * 11 * BIT_NS, "node 0", ErrorState.ERROR_ACTIVE)

    def test_a_restart_of_a_controller_that_works_has_no_effect(self) -> None:
        bench = Bench()
        bench.bus.restart(bench.nodes[0], 0)
        assert bench.bus.next_event_ns == NEVER

    def test_a_node_without_others_on_the_bus_is_not_acknowledged_by_one_that_is_bus_off(self) -> None:
        bench = Bench(nodes=2)
        bench.bus.take_off(bench.nodes[1], 0)
        bench.send(0, Frame(1))
        bench.run(until_ns=1_000_000)
        assert bench.arrived == []
        assert bench.bus.error_frames > 1

    def test_a_controller_that_is_taken_off_destroys_its_frame_and_discards_its_queue(self) -> None:
        bench = Bench()
        bench.send(0, Frame(1), Frame(2))
        bench.run(until_ns=5 * BIT_NS)
        bench.bus.take_off(bench.nodes[0], bench.now_ns)
        assert bench.run() == []
        assert bench.nodes[0].refused == 2
        assert bench.bus.error_frames == 1


def next_bus_off_ns() -> int:
    """Return the time of 32 destroyed frames: 16 of an active sender, 16 of a passive one."""
    return (32 * 43 + 16 * 8) * BIT_NS


node_numbers = st.integers(0, 2)
steps = st.lists(
    st.tuples(
        node_numbers,
        st.integers(0, 0x7FF),
        st.binary(max_size=8),
        st.integers(0, 500_000),
        st.booleans(),
    ),
    max_size=40,
)


@settings(max_examples=80, deadline=None)
@given(steps, st.integers(0, 5))
def test_frames_overlap_never_and_none_is_lost_or_doubled(
    sends: list[tuple[int, int, bytes, int, bool]], errors: int
) -> None:
    """Whatever is sent when, and whatever is destroyed."""
    bench = Bench()
    bench.destroy(errors)
    taken: list[list[Frame]] = [[], [], []]
    for number, (node, identifier, data, wait_ns, is_extended) in enumerate(sends):
        frame = Frame(identifier, data[:6] + number.to_bytes(2, "little"), is_extended)
        if bench.send(node, frame) == [True]:
            taken[node].append(frame)
        bench.run(until_ns=bench.now_ns + wait_ns)
    bench.run()
    everything = [frame for _, frame in bench.arrived]
    for frames in taken:
        assert [frame for frame in everything if frame in frames] == frames, "each node's order is kept"
    assert len(everything) == sum(map(len, taken))
    for (before_ns, _), (after_ns, frame) in zip(bench.arrived, bench.arrived[1:], strict=False):
        assert after_ns - before_ns >= bits_on_wire(frame) * BIT_NS
