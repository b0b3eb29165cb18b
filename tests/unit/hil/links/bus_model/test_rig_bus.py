"""The modelled bus of a rig: who receives what, and what the faults of the bus do."""

from __future__ import annotations

from hil.core.frames import Frame
from hil.links.bus_model.bus import NEVER
from hil.links.bus_model.controller import ErrorState
from hil.links.bus_model.rig_bus import RigBus

SYNC, SAMPLE, READ_BACK, FOREIGN = Frame(0x080), Frame(0x190, bytes(8)), Frame(0x1A0, bytes(8)), Frame(0x300)
RECOVERY_NS = 128 * 11 * 2_000
BUS_OFF, RESTARTED = Frame(0x040, bytes(8), is_error=True), Frame(0x100, bytes(8), is_error=True)


class Bench:
    """The bus, its clock, and what has arrived at both sides."""

    def __init__(self) -> None:
        self.bus = RigBus(500_000)
        self.now_ns = 0
        self.at_gateway: list[Frame] = []
        self.at_boards: list[Frame] = []

    def run(self, duration_ns: int = 10_000_000) -> None:
        end_ns = self.now_ns + duration_ns
        while self.bus.next_event_ns <= end_ns:
            assert self.bus.next_event_ns >= self.now_ns
            self.now_ns = self.bus.next_event_ns
            arrived = self.bus.advance(self.now_ns)
            self.at_gateway += arrived.at_gateway
            self.at_boards += arrived.at_boards
        self.now_ns = end_ns

    def unplug(self) -> None:
        self.bus.unplug(self.now_ns)

    def plug(self) -> None:
        self.bus.plug(self.now_ns)

    def send(self, *frames: Frame) -> list[bool]:
        return [self.bus.send_from_gateway(frame, self.now_ns) for frame in frames]


def test_each_side_receives_what_the_other_sends() -> None:
    bench = Bench()
    bench.send(SYNC)
    bench.bus.send_from_board(SAMPLE, 0)
    bench.run()
    assert (bench.at_boards, bench.at_gateway) == ([SYNC], [SAMPLE])


def test_both_sides_receive_foreign_frames() -> None:
    bench = Bench()
    bench.bus.send_foreign(FOREIGN, 0)
    bench.run()
    assert bench.at_boards == bench.at_gateway == [FOREIGN]


def test_the_node_id_says_which_board_sends() -> None:
    bench = Bench()
    bench.bus.send_from_board(SAMPLE, 0)
    bench.bus.send_from_board(READ_BACK, 0)
    assert (len(bench.bus.adc.queue), len(bench.bus.dac.queue)) == (1, 1)


def test_figures_count_frames_and_time() -> None:
    bench = Bench()
    bench.bus.disturbances.append(lambda _sender, bits: None if bench.bus.error_frames else bits // 2)
    bench.send(SYNC)
    bench.run()
    assert (bench.bus.frames, bench.bus.error_frames, bench.bus.bit_rate) == (1, 1, 500_000)
    assert bench.bus.busy_ns == (51 + 51 // 2 + 20 + 3) * 2_000


class TestUnplugged:
    def test_nothing_passes_and_the_gateway_becomes_passive_and_refuses_frames(self) -> None:
        bench = Bench()
        bench.unplug()
        assert bench.send(*[SYNC] * 12) == [True] * 10 + [False] * 2
        bench.bus.send_from_board(SAMPLE, 0)
        bench.bus.send_foreign(FOREIGN, 0)
        bench.run()
        assert bench.at_boards == [FOREIGN]
        assert [frame.data[1] for frame in bench.at_gateway] == [0x08, 0x20], "warning, then passive"
        assert bench.bus.gateway.state is ErrorState.ERROR_PASSIVE

    def test_the_frames_that_waited_pass_afterwards(self) -> None:
        bench = Bench()
        bench.unplug()
        bench.send(SYNC)
        bench.run()
        bench.plug()
        bench.run()
        assert bench.at_boards == [SYNC]

    def test_two_faults_at_a_time_need_two_ends(self) -> None:
        bench = Bench()
        bench.unplug()
        bench.unplug()
        bench.plug()
        bench.send(SYNC)
        bench.run()
        assert bench.at_boards == []
        bench.plug()
        bench.run()
        assert bench.at_boards == [SYNC]

    def test_a_frame_on_the_wire_does_not_arrive(self) -> None:
        bench = Bench()
        bench.send(SYNC)
        bench.run(duration_ns=20_000)
        bench.unplug()
        bench.run()
        assert bench.at_boards == []
        assert bench.bus.adc.rec == 1

    def test_unplugging_again_begins_anew(self) -> None:
        bench = Bench()
        for _ in range(3):
            bench.unplug()
            bench.send(SYNC)
            bench.run(duration_ns=100_000)
            bench.plug()
            bench.run()
        assert bench.at_boards == [SYNC] * 3


class TestBusOff:
    def test_the_gateway_receives_a_report_and_refuses_frames_until_it_has_recovered(self) -> None:
        bench = Bench()
        assert bench.bus.take_gateway_off(0) == BUS_OFF
        assert bench.send(SYNC) == [False]
        bench.run(duration_ns=10 * RECOVERY_NS)
        assert bench.send(SYNC) == [False], "it does not restart by itself"
        bench.bus.restart(bench.now_ns)
        bench.run(duration_ns=RECOVERY_NS)
        assert bench.at_gateway == [RESTARTED]
        assert bench.send(SYNC) == [True]

    def test_a_second_fault_of_this_kind_changes_nothing(self) -> None:
        bench = Bench()
        for _ in range(2):
            assert bench.bus.take_gateway_off(0) == BUS_OFF
        bench.bus.restart(0)
        bench.run(duration_ns=RECOVERY_NS)
        assert bench.send(SYNC) == [True]

    def test_boards_go_on_without_the_gateway(self) -> None:
        bench = Bench()
        bench.bus.take_gateway_off(0)
        bench.bus.send_from_board(SAMPLE, 0)
        bench.run()
        assert bench.bus.frames == 1
        assert bench.at_gateway == [], "a controller that is bus-off receives nothing"

    def test_errors_of_its_frames_make_the_gateway_bus_off(self) -> None:
        bench = Bench()
        bench.bus.disturbances.append(lambda sender, _bits: 20 if sender == "gateway" else None)
        bench.send(SYNC)
        bench.run()
        assert bench.at_gateway[-1] == BUS_OFF
        assert bench.bus.next_event_ns == NEVER

    def test_a_board_recovers_by_itself(self) -> None:
        bench = Bench()
        disturbance = bench.bus.disturbances
        disturbance.append(lambda sender, _bits: 20 if sender == "adc" else None)
        bench.bus.send_from_board(SAMPLE, 0)
        bench.run(duration_ns=4_000_000)
        disturbance.clear()
        bench.run()
        bench.bus.send_from_board(SAMPLE, bench.now_ns)
        bench.run()
        assert bench.at_gateway[-1] == SAMPLE
