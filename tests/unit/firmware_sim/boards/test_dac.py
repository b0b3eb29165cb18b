"""The valve board: commands, watchdog, and the watch over the gateway's heartbeat."""

from __future__ import annotations

import msgspec
import pytest
from support.board_bench import (
    MS,
    PRE_OPERATIONAL,
    RESET_COMMUNICATION,
    RESET_NODE,
    RIG,
    START,
    STOP,
    SYNC,
    Bench,
    command,
    emergency,
    gateway_heartbeat,
    nmt,
    pdo,
    with_dac,
)
from support.constants import CENTRED, PERIOD_NS

from hil.core.frames import Frame


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
    def test_without_a_new_command_the_valves_hold_the_last_one(self, apply: str) -> None:
        bench = Bench(with_dac(apply=apply)).started()
        bench.period(6.25, 5.0, 2.5)
        for _ in range(4):
            bench.give(SYNC)
            assert bench.valve_v == (6.25, 5.0, 2.5)
            bench.wait(PERIOD_NS)

    def test_at_once_a_command_applies_when_it_arrives(self) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.command(6.25, 5.0, 2.5)
        assert bench.valve_v == (6.25, 5.0, 2.5)

    def test_the_plant_gets_each_voltage_for_its_duration(self) -> None:
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

    def test_bits_below_the_resolution_are_ignored(self) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.give(pdo(0x220, (16384 + 7, 16384 + 8, 32767), 0))
        assert bench.valve_v == (5.0, 5.0 + 10 / 4096, 10 * 4095 / 4096)
        bench.give(pdo(0x220, (0, 7, 8), 1))
        assert bench.valve_v == (0.0, 0.0, 10 / 4096)

    def test_a_board_that_is_not_operational_ignores_commands(self) -> None:
        bench = Bench(with_dac(apply="at once"))
        assert bench.command(6, 6, 6) == []
        assert bench.valve_v == CENTRED

    @pytest.mark.parametrize("sent", [STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION])
    def test_leaving_operational_centres_the_valves_and_drops_the_pending_command(self, sent: int) -> None:
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
            (pdo(0x220, (20000, -1, 20000), 1), 0x8200),
        ],
        ids=[
            "7 bytes",
            "empty",
            "CRC",
            "counter repeated",
            "counter back by 1",
            "counter back by 128",
            "negative",
        ],
    )
    def test_a_bad_command_is_rejected_and_reported_once_until_a_good_one(
        self, bad: Frame, code: int
    ) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.command(5.5, 5.5, 5.5)
        applied = bench.valve_v
        assert [emergency(frame) for frame in bench.give(bad)] == [(0x20, code, 0x11)]
        assert bench.give(bad) == []
        assert bench.valve_v == applied
        assert [emergency(frame) for frame in bench.command(6.25, 5.0, 5.0)] == [(0x20, 0, 0)]
        assert bench.valve_v == (6.25, 5.0, 5.0)

    def test_a_gap_in_the_counter_is_accepted(self) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.give(command((5.5, 5.5, 5.5), 0))
        assert bench.give(command((6.25, 5.0, 5.0), 127)) == []
        assert bench.valve_v == (6.25, 5.0, 5.0)

    def test_unprotected_commands_have_six_bytes_and_may_repeat(self) -> None:
        bench = Bench(with_dac(apply="at once", protected=False)).started()
        good = pdo(0x220, (20480, 16384, 16384), None)
        assert bench.give(good) == bench.give(good) == []
        assert bench.valve_v == (6.25, 5.0, 5.0)
        assert [emergency(frame)[1] for frame in bench.give(command((6, 6, 6), 1))] == [0x8210]

    def test_the_rig_file_sets_the_centre(self) -> None:
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
    def test_valves_centre_exactly_after_the_watchdog_time(self) -> None:
        bench = Bench(with_dac(apply="at once", watchdog_timeout_s=5 * 0.0112)).started()
        bench.command(6.25, 5.0, 5.0)
        assert bench.wait(5 * PERIOD_NS - 1) == []
        assert bench.valve_v == (6.25, 5.0, 5.0)
        assert [emergency(frame) for frame in bench.wait(1)] == [(0x20, 0x8250, 0x11)]
        assert bench.valve_v == CENTRED

    def test_regular_commands_prevent_it_and_a_good_command_ends_it(self) -> None:
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

    def test_bad_commands_do_not_restart_it(self) -> None:
        bench = Bench(with_dac(apply="at once", watchdog_timeout_s=3 * 0.0112)).started()
        bench.command(6.25, 5.0, 5.0)
        for _ in range(3):
            bench.give(Frame(0x220, command((6, 6, 6), 77).data[:7] + b"\x00"))
            bench.wait(PERIOD_NS)
        assert bench.valve_v == CENTRED

    def test_commands_that_no_sync_applies_do_not_restart_it(self) -> None:
        bench = Bench(with_dac(watchdog_timeout_s=3 * 0.0112)).started()
        bench.period(6.25, 5.0, 5.0)
        bench.period(6.25, 5.0, 5.0)
        assert bench.valve_v == (6.25, 5.0, 5.0)
        for _ in range(4):
            bench.command(7.5, 5.0, 5.0)
            bench.wait(PERIOD_NS)
        assert bench.valve_v == CENTRED

    def test_it_starts_with_the_first_command(self) -> None:
        bench = Bench().started()
        frames = bench.wait(10**9)
        assert {frame.id for frame in frames} == {0x710, 0x720}

    def test_a_command_after_the_watchdog_time_does_not_hide_that_it_expired(self) -> None:
        bench = Bench(with_dac(apply="at once", watchdog_timeout_s=2 * 0.0112)).started()
        bench.command(6.25, 5.0, 5.0)
        bench.now_ns += 2 * PERIOD_NS + 1
        frames = bench.command(7.5, 5.0, 5.0)
        assert [emergency(frame)[1] for frame in frames] == [0x8250, 0]
        assert (2 * PERIOD_NS + 1, (6.25, 5.0, 5.0)) in bench.plant.held

    def test_a_command_at_the_instant_of_the_watchdog_is_in_time(self) -> None:
        bench = Bench(with_dac(apply="at once", watchdog_timeout_s=2 * 0.0112)).started()
        bench.command(6.25, 5.0, 5.0)
        bench.now_ns += 2 * PERIOD_NS
        assert bench.command(7.5, 5.0, 5.0) == []
        assert bench.valve_v == (7.5, 5.0, 5.0)

    def test_after_it_any_counter_is_accepted(self) -> None:
        bench = Bench(with_dac(apply="at once")).started()
        bench.give(command((6.25, 5.0, 5.0), 9))
        bench.wait(5 * PERIOD_NS)
        bench.give(command((6.25, 5.0, 5.0), 9))
        assert bench.valve_v == (6.25, 5.0, 5.0)


class TestGatewayHeartbeat:
    rig = with_dac(apply="at once", heartbeat_timeout_s=27 * 0.0112)

    def test_its_absence_centres_the_valves_although_commands_continue(self) -> None:
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

    def test_valves_move_again_after_a_heartbeat_and_a_good_command(self) -> None:
        bench = Bench(self.rig).started()
        bench.give(gateway_heartbeat())
        bench.wait(27 * PERIOD_NS)
        assert [emergency(frame) for frame in bench.give(gateway_heartbeat())] == [(0x20, 0, 0)]
        assert bench.valve_v == CENTRED
        bench.command(6.25, 5.0, 5.0)
        assert bench.valve_v == (6.25, 5.0, 5.0)

    def test_emcy_no_error_is_sent_when_the_last_of_two_errors_has_ended(self) -> None:
        bench = Bench(self.rig).started()
        bench.give(gateway_heartbeat())
        bench.command(6.25, 5.0, 5.0)
        reported = [emergency(frame)[1] for frame in bench.wait(27 * PERIOD_NS) if frame.id == 0x0A0]
        assert reported == [0x8250, 0x8130]
        assert bench.give(gateway_heartbeat()) == []
        assert [emergency(frame)[1] for frame in bench.command(6.25, 5.0, 5.0)] == [0]

    def test_its_timeout_is_a_deadline_of_the_board(self) -> None:
        bench = Bench(self.rig, heartbeat_ns=10**10).started()
        bench.give(gateway_heartbeat())
        assert bench.wait(27 * PERIOD_NS - 1) == []
        assert [emergency(frame)[1] for frame in bench.wait(1)] == [0x8130]

    @pytest.mark.parametrize("other", [Frame(0x701), Frame(0x701, b"\x05\x05"), Frame(0x702, b"\x05")])
    def test_other_frames_do_not_count_as_the_gateways_heartbeat(self, other: Frame) -> None:
        bench = Bench(self.rig).started()
        bench.give(gateway_heartbeat())
        bench.wait(26 * PERIOD_NS)
        bench.give(other)
        reported = [emergency(frame)[1] for frame in bench.wait(PERIOD_NS) if frame.id == 0x0A0]
        assert reported == [0x8130]

    def test_its_absence_is_no_error_before_the_first_one(self) -> None:
        bench = Bench(self.rig).started()
        for _ in range(60):
            assert bench.period(6.25, 5.0, 5.0) == []
        assert bench.valve_v == (6.25, 5.0, 5.0)

    @pytest.mark.parametrize("reset", [RESET_NODE, RESET_COMMUNICATION])
    def test_its_absence_is_no_error_after_a_reset(self, reset: int) -> None:
        bench = Bench(self.rig).started()
        bench.give(gateway_heartbeat())
        bench.give(nmt(reset))
        assert {frame.id for frame in bench.wait(10**9)} == {0x710, 0x720}

    def test_a_stopped_board_sends_no_emcy(self) -> None:
        bench = Bench(self.rig).started()
        bench.give(gateway_heartbeat())
        bench.give(nmt(STOP))
        assert {frame.id for frame in bench.wait(10**9)} == {0x710, 0x720}
