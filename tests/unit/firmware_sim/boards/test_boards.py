"""The boards as CANopen slaves, stepped by hand: states, PDOs, time-outs."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import pytest
from support.board_bench import (
    ADC_BOOT,
    CENTRED,
    DAC_BOOT,
    HEARTBEAT_NS,
    MS,
    PERIOD_NS,
    PRE_OPERATIONAL,
    RESET_COMMUNICATION,
    RESET_NODE,
    RIG,
    START,
    STOP,
    SYNC,
    Bench,
    HandPlant,
    command,
    emergency,
    gateway_heartbeat,
    nmt,
    with_dac,
)

from firmware_sim.boards.codec import decode_values, encode_values
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import HilError
from hil.core.frames import Frame


class TestNmt:
    def test_boot_up_then_pre_operational(self) -> None:
        bench = Bench()
        assert bench.booted == (ADC_BOOT, DAC_BOOT)
        assert bench.wait(HEARTBEAT_NS) == [Frame(0x710, b"\x7f"), Frame(0x720, b"\x7f")]

    def test_without_power_nothing_happens(self) -> None:
        plant = HandPlant()
        rig = SimulatedRig(RIG, plant)
        assert rig.next_deadline_ns > 10**18
        for frame in (nmt(START), SYNC, command((6, 6, 6), 0)):
            assert rig.receive(frame, 10**9) == ()
        assert rig.on_deadline(2 * 10**9) == ()
        assert plant.held == []

    @pytest.mark.parametrize(
        ("sent", "state"), [(START, 5), (STOP, 4), (PRE_OPERATIONAL, 127)], ids=["start", "stop", "pre-op"]
    )
    def test_commands_change_the_state_that_heartbeats_carry(self, sent: int, state: int) -> None:
        bench = Bench().started()
        assert bench.give(nmt(sent)) == []
        assert bench.wait(HEARTBEAT_NS) == [Frame(0x710, bytes((state,))), Frame(0x720, bytes((state,)))]

    @pytest.mark.parametrize(("node", "states"), [(0x10, (5, 127)), (0x20, (127, 5)), (0x30, (127, 127))])
    def test_a_command_reaches_the_node_it_names(self, node: int, states: tuple[int, int]) -> None:
        bench = Bench()
        bench.give(nmt(START, node))
        assert bench.wait(HEARTBEAT_NS) == [
            Frame(0x710, bytes((states[0],))),
            Frame(0x720, bytes((states[1],))),
        ]

    @pytest.mark.parametrize("reset", [RESET_NODE, RESET_COMMUNICATION])
    def test_a_reset_boots_anew_and_begins_the_heartbeats_anew(self, reset: int) -> None:
        bench = Bench().started()
        bench.wait(HEARTBEAT_NS // 2)
        assert bench.give(nmt(reset)) == [ADC_BOOT, DAC_BOOT]
        assert bench.wait(HEARTBEAT_NS - 1) == []
        assert bench.wait(1) == [Frame(0x710, b"\x7f"), Frame(0x720, b"\x7f")]

    @pytest.mark.parametrize("data", [b"", b"\x01", b"\x01\x00\x00", b"\x03\x00"])
    def test_what_is_no_command_changes_nothing(self, data: bytes) -> None:
        bench = Bench()
        assert bench.give(Frame(0x000, data)) == []
        assert bench.rig.adc.state == bench.rig.dac.state == 127

    def test_only_plain_data_frames_are_taken(self) -> None:
        bench = Bench()
        start = nmt(START)
        for kind in ("is_extended", "is_remote", "is_error"):
            assert bench.give(start._replace(**{kind: True})) == []
        assert bench.rig.adc.state == bench.rig.dac.state == 127

    def test_heartbeats_keep_their_beat_and_late_ones_are_not_caught_up(self) -> None:
        bench = Bench(heartbeat_ns=50 * MS)
        start_ns = bench.now_ns
        late_ns = start_ns + 230 * MS
        assert len(bench.rig.on_deadline(late_ns)) == 2
        assert bench.rig.next_deadline_ns == start_ns + 250 * MS


class TestAdc:
    def test_sync_is_answered_in_operational_only(self) -> None:
        bench = Bench()
        assert bench.give(SYNC) == []
        bench.give(nmt(START))
        assert [frame.id for frame in bench.give(SYNC)] == [0x190]
        bench.give(nmt(STOP))
        assert bench.give(SYNC) == []

    def test_samples_are_left_adjusted_12_bit_codes_of_the_plants_voltages(self) -> None:
        bench = Bench().started()
        bench.plant.volts = [0.0, 5.0, 10.0]
        (frame,) = bench.give(SYNC)
        assert decode_values(frame.data, protected=True) == ((0, 2048 << 3, 4095 << 3), 0)

    def test_resolution_is_the_constructors(self) -> None:
        bench = Bench(resolution_bits=15).started()
        bench.plant.volts = [10.0 / 32768, 5.0, 10.0]
        (frame,) = bench.give(SYNC)
        assert decode_values(frame.data, protected=True).counts == (1, 16384, 32767)

    def test_the_counter_rolls_and_a_reset_begins_it_anew(self) -> None:
        bench = Bench().started()
        counters = [bench.give(SYNC)[0].data[6] for _ in range(258)]
        assert counters == [*range(256), 0, 1]
        bench.give(nmt(RESET_NODE))
        bench.give(nmt(START))
        assert bench.give(SYNC)[0].data[6] == 0

    def test_unprotected_samples_are_six_bytes(self) -> None:
        rig = msgspec.structs.replace(RIG, adc=msgspec.structs.replace(RIG.adc, protected=False))
        (frame,) = Bench(rig).started().give(SYNC)
        assert decode_values(frame.data, protected=False).counts == (16384, 16384, 16384)

    def test_a_sync_with_a_counter_is_refused_with_emcy_8240_until_a_plain_one_comes(self) -> None:
        bench = Bench().started()
        refusals = bench.give(Frame(0x080, b"\x01"))
        assert [emergency(frame) for frame in refusals] == [(0x10, 0x8240, 0x11), (0x20, 0x8240, 0x11)]
        assert bench.give(Frame(0x080, b"\x02")) == []
        sample, *recoveries = bench.give(SYNC)
        assert sample.id == 0x190
        assert [emergency(frame) for frame in recoveries] == [(0x10, 0, 0), (0x20, 0, 0)]


class TestCommands:
    def test_at_sync_a_command_waits_for_the_next_sync(self) -> None:
        bench = Bench().started()
        bench.give(SYNC)
        assert bench.command(6.25, 5.0, 2.5) == []
        assert bench.valve_v == CENTRED
        bench.wait(PERIOD_NS)
        bench.give(SYNC)
        assert bench.valve_v == (6.25, 5.0, 2.5)

    def test_at_sync_the_last_command_wins(self) -> None:
        bench = Bench().started()
        bench.command(6.25, 5.0, 5.0)
        bench.command(7.5, 5.0, 5.0)
        bench.give(SYNC)
        assert bench.valve_v == (7.5, 5.0, 5.0)

    @pytest.mark.parametrize("apply", ["at sync", "at once"])
    def test_without_a_new_command_the_valves_hold_the_last(self, apply: str) -> None:
        bench = Bench(with_dac(apply=apply)).started()
        bench.period(6.25, 5.0, 2.5)
        for _ in range(4):
            bench.give(SYNC)
            assert bench.valve_v == (6.25, 5.0, 2.5)
            bench.wait(PERIOD_NS)

    def test_at_once_a_command_applies_as_it_comes(self) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.command(6.25, 5.0, 2.5)
        assert bench.valve_v == (6.25, 5.0, 2.5)

    def test_the_plant_sees_every_voltage_for_as_long_as_it_was_applied(self) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.give(SYNC)
        bench.wait(3 * MS)
        bench.command(6.25, 5.0, 5.0)
        bench.wait(8 * MS)
        bench.give(SYNC)
        bench.give(nmt(STOP))
        bench.wait(1 * MS)
        bench.rig.receive(nmt(START), bench.now_ns)
        bench.give(SYNC)
        assert bench.plant.held == [(3 * MS, CENTRED), (8 * MS, (6.25, 5.0, 5.0)), (1 * MS, CENTRED)]

    def test_bits_under_the_resolution_are_ignored(self) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.give(Frame(0x220, encode_values((16384 + 7, 16384 + 8, 32767), 0)))
        assert bench.valve_v == (5.0, 5.0 + 10 / 4096, 10 * 4095 / 4096)
        bench.give(Frame(0x220, encode_values((0, 7, 8), 1)))
        assert bench.valve_v == (0.0, 0.0, 10 / 4096)

    def test_not_operational_no_command_is_taken(self) -> None:
        bench = Bench(with_dac(apply="at once"))
        assert bench.command(6, 6, 6) == []
        assert bench.valve_v == CENTRED

    @pytest.mark.parametrize("sent", [STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION])
    def test_leaving_operational_centres_and_forgets_the_command_that_waits(self, sent: int) -> None:
        bench = Bench().started()
        bench.period(6.25, 5.0, 5.0)
        bench.period(7.5, 5.0, 5.0)
        assert bench.valve_v == (6.25, 5.0, 5.0)
        bench.give(nmt(sent))
        assert bench.valve_v == CENTRED
        assert bench.rig.next_deadline_ns == bench.rig.adc.next_deadline_ns, "the watchdog's is withdrawn"
        bench.give(nmt(START))
        bench.give(SYNC)
        assert bench.valve_v == CENTRED

    @pytest.mark.parametrize(
        ("bad", "code"),
        [
            (Frame(0x220, command((6, 6, 6), 1).data[:7]), 0x8210),
            (Frame(0x220, b""), 0x8210),
            (Frame(0x220, command((6, 6, 6), 1).data[:7] + b"\x00"), 0x8200),
            (command((6, 6, 6), 0), 0x8200),
            (command((6, 6, 6), 255), 0x8200),
            (command((6, 6, 6), 128), 0x8200),
            (Frame(0x220, encode_values((20000, -1, 20000), 1)), 0x8200),
        ],
        ids=["7 bytes", "empty", "CRC", "counter repeated", "counter back", "farthest back", "negative"],
    )
    def test_a_bad_command_is_rejected_and_told_once_until_a_good_one(self, bad: Frame, code: int) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.command(5.5, 5.5, 5.5)
        applied = bench.valve_v
        assert [emergency(frame) for frame in bench.give(bad)] == [(0x20, code, 0x11)]
        assert bench.give(bad) == []
        assert bench.valve_v == applied
        assert [emergency(frame) for frame in bench.command(6.25, 5.0, 5.0)] == [(0x20, 0, 0)]
        assert bench.valve_v == (6.25, 5.0, 5.0)

    def test_commands_may_be_lost_on_the_way(self) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.give(command((5.5, 5.5, 5.5), 0))
        assert bench.give(command((6.25, 5.0, 5.0), 127)) == []
        assert bench.valve_v == (6.25, 5.0, 5.0)

    def test_unprotected_commands_are_six_bytes_and_may_repeat(self) -> None:
        bench = Bench(with_dac(apply="at once", protected=False)).started()
        good = Frame(0x220, encode_values((20480, 16384, 16384), None))
        assert bench.give(good) == bench.give(good) == []
        assert bench.valve_v == (6.25, 5.0, 5.0)
        assert [emergency(frame)[1] for frame in bench.give(command((6, 6, 6), 1))] == [0x8210]

    def test_the_centre_is_the_rig_files(self) -> None:
        vertical = RIG.axes["vertical"]
        valve = msgspec.structs.replace(vertical.valve, centre_v=4.9)
        axes = RIG.axes | {"vertical": msgspec.structs.replace(vertical, valve=valve)}
        bench = Bench(msgspec.structs.replace(RIG, axes=axes))
        assert bench.valve_v == (4.9, 5.0, 5.0)
        bench.started().give(SYNC)
        bench.wait(PERIOD_NS)
        bench.give(SYNC)
        assert bench.plant.held == [(PERIOD_NS, (4.9, 5.0, 5.0))]


class TestWatchdog:
    def test_valves_centre_when_commands_stop_exactly_after_the_rig_files_periods(self) -> None:
        bench = Bench(with_dac(apply="at once", watchdog_periods=5)).started()
        bench.command(6.25, 5.0, 5.0)
        assert bench.wait(5 * PERIOD_NS - 1) == []
        assert bench.valve_v == (6.25, 5.0, 5.0)
        assert [emergency(frame) for frame in bench.wait(1)] == [(0x20, 0x8250, 0x11)]
        assert bench.valve_v == CENTRED

    def test_good_commands_every_period_keep_it_quiet_and_their_return_ends_it(self) -> None:
        bench = Bench().started()
        for _ in range(100):
            assert bench.period(6.25, 5.0, 5.0) == []
        for _ in range(5):
            bench.give(SYNC)
            bench.wait(PERIOD_NS)
        assert bench.valve_v == CENTRED
        assert [emergency(frame) for frame in bench.period(6.25, 5.0, 5.0)] == [(0x20, 0, 0)]
        bench.period(6.25, 5.0, 5.0)
        assert bench.valve_v == (6.25, 5.0, 5.0)

    def test_bad_commands_do_not_feed_it(self) -> None:
        bench = Bench(with_dac(apply="at once", watchdog_periods=3)).started()
        bench.command(6.25, 5.0, 5.0)
        for _ in range(3):
            bench.give(Frame(0x220, command((6, 6, 6), 77).data[:7] + b"\x00"))
            bench.wait(PERIOD_NS)
        assert bench.valve_v == CENTRED

    def test_commands_that_no_sync_applies_do_not_feed_it(self) -> None:
        bench = Bench(with_dac(watchdog_periods=3)).started()
        bench.period(6.25, 5.0, 5.0)
        bench.period(6.25, 5.0, 5.0)
        assert bench.valve_v == (6.25, 5.0, 5.0)
        for _ in range(4):
            bench.command(7.5, 5.0, 5.0)
            bench.wait(PERIOD_NS)
        assert bench.valve_v == CENTRED

    def test_it_waits_for_the_first_command(self) -> None:
        bench = Bench().started()
        frames = bench.wait(10**9)
        assert {frame.id for frame in frames} == {0x710, 0x720}

    def test_a_late_shell_cannot_let_a_command_in_after_the_time(self) -> None:
        bench = Bench(with_dac(apply="at once", watchdog_periods=2)).started()
        bench.command(6.25, 5.0, 5.0)
        bench.now_ns += 2 * PERIOD_NS + 1
        frames = bench.command(7.5, 5.0, 5.0)
        assert [emergency(frame)[1] for frame in frames] == [0x8250, 0]
        assert (2 * PERIOD_NS + 1, (6.25, 5.0, 5.0)) in bench.plant.held

    def test_a_command_at_its_very_instant_is_in_time(self) -> None:
        bench = Bench(with_dac(apply="at once", watchdog_periods=2)).started()
        bench.command(6.25, 5.0, 5.0)
        bench.now_ns += 2 * PERIOD_NS
        assert bench.command(7.5, 5.0, 5.0) == []
        assert bench.valve_v == (7.5, 5.0, 5.0)

    def test_after_it_any_counter_is_taken(self) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.give(command((6.25, 5.0, 5.0), 9))
        bench.wait(5 * PERIOD_NS)
        bench.give(command((6.25, 5.0, 5.0), 9))
        assert bench.valve_v == (6.25, 5.0, 5.0)


class TestGatewayHeartbeat:
    rig = with_dac(apply="at once", heartbeat_timeout_periods=27)

    def test_its_absence_centres_the_valves_exactly_in_time_though_commands_go_on(self) -> None:
        bench = Bench(self.rig).started()
        bench.give(gateway_heartbeat())
        for _ in range(26):
            assert bench.period(6.25, 5.0, 5.0) == []
        bench.give(SYNC)
        bench.command(6.25, 5.0, 5.0)
        bench.wait(PERIOD_NS - 1)
        assert bench.valve_v == (6.25, 5.0, 5.0)
        assert [emergency(frame) for frame in bench.wait(1)] == [(0x20, 0x8130, 0x11)]
        assert bench.valve_v == CENTRED
        assert bench.period(6.25, 5.0, 5.0) == []
        assert bench.valve_v == CENTRED

    def test_its_return_and_a_good_command_end_it(self) -> None:
        bench = Bench(self.rig).started()
        bench.give(gateway_heartbeat())
        bench.wait(27 * PERIOD_NS)
        assert [emergency(frame) for frame in bench.give(gateway_heartbeat())] == [(0x20, 0, 0)]
        assert bench.valve_v == CENTRED
        bench.command(6.25, 5.0, 5.0)
        assert bench.valve_v == (6.25, 5.0, 5.0)

    def test_no_error_is_told_when_the_last_of_two_has_ended(self) -> None:
        bench = Bench(self.rig).started()
        bench.give(gateway_heartbeat())
        bench.command(6.25, 5.0, 5.0)
        told = [emergency(frame)[1] for frame in bench.wait(27 * PERIOD_NS) if frame.id == 0x0A0]
        assert told == [0x8250, 0x8130]
        assert bench.give(gateway_heartbeat()) == []
        assert [emergency(frame)[1] for frame in bench.command(6.25, 5.0, 5.0)] == [0]

    def test_its_time_is_kept_when_nothing_else_wakes_the_board(self) -> None:
        bench = Bench(self.rig, heartbeat_ns=10**10).started()
        bench.give(gateway_heartbeat())
        assert bench.wait(27 * PERIOD_NS - 1) == []
        assert [emergency(frame)[1] for frame in bench.wait(1)] == [0x8130]

    @pytest.mark.parametrize("other", [Frame(0x701), Frame(0x701, b"\x05\x05"), Frame(0x702, b"\x05")])
    def test_other_frames_are_no_heartbeat_of_the_gateway(self, other: Frame) -> None:
        bench = Bench(self.rig).started()
        bench.give(gateway_heartbeat())
        bench.wait(26 * PERIOD_NS)
        bench.give(other)
        told = [emergency(frame)[1] for frame in bench.wait(PERIOD_NS) if frame.id == 0x0A0]
        assert told == [0x8130]

    def test_a_gateway_that_sends_none_is_not_waited_for(self) -> None:
        bench = Bench(self.rig).started()
        for _ in range(60):
            assert bench.period(6.25, 5.0, 5.0) == []
        assert bench.valve_v == (6.25, 5.0, 5.0)

    @pytest.mark.parametrize("reset", [RESET_NODE, RESET_COMMUNICATION])
    def test_a_reset_waits_for_the_first_anew(self, reset: int) -> None:
        bench = Bench(self.rig).started()
        bench.give(gateway_heartbeat())
        bench.give(nmt(reset))
        assert {frame.id for frame in bench.wait(10**9)} == {0x710, 0x720}

    def test_a_stopped_board_tells_nothing(self) -> None:
        bench = Bench(self.rig).started()
        bench.give(gateway_heartbeat())
        bench.give(nmt(STOP))
        assert {frame.id for frame in bench.wait(10**9)} == {0x710, 0x720}


class TestThePlant:
    def test_it_keeps_up_when_nobody_sends_sync_any_more(self) -> None:
        bench = Bench().started()
        bench.give(SYNC)
        bench.wait(10**9)
        assert bench.plant.held == [(HEARTBEAT_NS, CENTRED)] * 10

    def test_its_time_begins_with_the_first_sample(self) -> None:
        bench = Bench()
        bench.wait(10**10)
        bench.give(SYNC)  # nobody samples yet
        bench.wait(10**9)
        bench.started().give(SYNC)
        assert bench.plant.held == []
        bench.wait(PERIOD_NS)
        bench.give(SYNC)
        assert bench.plant.held == [(PERIOD_NS, CENTRED)]

    def test_its_time_begins_with_a_valve_that_moves_before_any_sample(self) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.command(6.25, 5.0, 5.0)
        bench.wait(MS)
        bench.command(5.0, 5.0, 5.0)
        assert bench.plant.held == [(MS, (6.25, 5.0, 5.0))]

    def test_a_clock_that_stands_still_or_goes_back_does_not_move_it(self) -> None:
        bench = Bench().started()
        bench.give(SYNC)
        bench.now_ns -= 5 * MS
        bench.give(SYNC)
        assert bench.plant.held == []

    def test_its_failure_passes_through_to_the_shell(self) -> None:
        class Diverging(HandPlant):
            def advance(self, duration_ns: int, valve_v: Sequence[float]) -> None:
                raise HilError("vertical: position 3.2 m exceeds 0.15 m")

        rig = SimulatedRig(RIG, Diverging())
        rig.start(0)
        rig.receive(nmt(START), 0)
        rig.receive(SYNC, 0)
        with pytest.raises(HilError, match="exceeds"):
            rig.receive(SYNC, PERIOD_NS)
