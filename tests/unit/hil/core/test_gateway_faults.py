"""What goes wrong around the gateway core: rejected samples, silence, late calls, restarts, strangers.

Every one has its effect, to the period, and an event that explains it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from support.gateway_bench import (
    ADC_BOOT,
    ADC_UP,
    AXES,
    DAC_BOOT,
    DAC_UP,
    SYNC,
    Bench,
    HandGateway,
    commands,
    faults,
    hand,
    make_gateway,
    make_rig,
    sample_frame,
    texts,
)

from firmware_sim.boards.faults import AdcFaults, DacFaults
from hil.core.controller_file import PidLaw, TransferFunctionLaw
from hil.core.frames import Frame
from hil.core.gateway import BUS_OFF, COMMANDS_TO_BOARDS, MOST_REPORTED
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import LogEntry, Output, Severity
from hil.core.sample_guard import FIRST_ANSWER_PERIODS
from hil.core.wire import codec

PERIOD_NS = 11_200_000
CENTRED = (5.0, 5.0, 5.0)
GATEWAY_HEARTBEAT = Frame(0x701, b"\x05")
TIMEOUT_PERIODS = 27
LIVE_STATES = [LifeCycleState.OFFLINE, LifeCycleState.READY, LifeCycleState.ARMED, LifeCycleState.RUNNING]


def emergency(identifier: int, code: int, register: int = 0x11) -> Frame:
    return Frame(identifier, codec.encode_emcy_adc(code, register, 0, 0))


def error_frame(error_class: int) -> Frame:
    return Frame(error_class, bytes(8), is_error=True)


BAD_SAMPLES: dict[str, tuple[Callable[[int], Frame], str]] = {
    "length": (lambda counter: Frame(0x190, bytes(6)), "TPDO1_ADC has 6 bytes, not 8 (rig: adc.protected)"),
    "crc": (lambda counter: Frame(0x190, bytes(8)), "TPDO1_ADC: CRC 0x00, computed 0x"),
    "repeated": (lambda counter: sample_frame(CENTRED, counter - 1), "TPDO1_ADC: counter 0 repeated"),
    "low": (lambda counter: sample_frame((5.0, 0.05, 5.0), counter), "horizontal: potentiometer 0.050 V"),
    "high": (lambda counter: sample_frame((5.0, 5.0, 9.95), counter), "rotation: potentiometer 9.950 V"),
}


class TestRejectedSamples:
    """Every guard takes a running gateway's command away, says why, and once."""

    @pytest.mark.parametrize("kind", BAD_SAMPLES)
    def test_no_command_and_one_report(self, kind: str) -> None:
        build, said = BAD_SAMPLES[kind]
        gateway = hand(LifeCycleState.RUNNING)
        gateway.deadline()
        frame = build(gateway.counter)
        for number in (1, 2, 3):
            output = gateway.give(frame)
            assert output.frames == ()
            assert output.cycle is None
            assert gateway.core.rejected_frames == number
            if number == 1:
                (event,) = output.log
                assert (event.severity, event.source) == (Severity.WARNING, "guard")
                assert event.text.startswith(f"rejected: {said}")
            else:
                assert output.log == ()
        assert gateway.state is LifeCycleState.RUNNING

    @pytest.mark.parametrize("kind", BAD_SAMPLES)
    def test_a_good_one_after_it_is_controlled(self, kind: str) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.deadline()
        gateway.give(BAD_SAMPLES[kind][0](gateway.counter))
        gateway.lose_sample()
        gateway.deadline()
        assert len(commands(gateway.sample())) == 1
        gateway.deadline()
        bad = gateway.give(BAD_SAMPLES["length"][0](0))
        assert len(bad.log) == 1  # reported anew

    @pytest.mark.parametrize("kind", BAD_SAMPLES)
    def test_nothing_but_bad_ones_is_a_fault_that_tells_the_cause(self, kind: str) -> None:
        build, said = BAD_SAMPLES[kind]
        gateway = hand(LifeCycleState.RUNNING)
        for _ in range(3):
            assert gateway.deadline().log == ()
            frame = build(gateway.counter)
            gateway.give(frame)
            if kind != "repeated":
                gateway.counter += 1
        output = gateway.deadline()
        assert gateway.state is LifeCycleState.FAULT
        (text,) = faults(output)
        assert text.startswith(
            f"adc: no good sample for 3 periods, limit 3 (rig: adc.stale_after_periods); last: {said}"
        )

    def test_a_late_sample_is_no_sample(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.deadline()
        output = gateway.sample(after_ns=PERIOD_NS + 1)
        assert output.frames == ()
        assert texts(output) == [
            "guard: rejected: TPDO1_ADC: 11.20 ms after SYNC exceeds 11.2 ms (rig: loop.period_s)"
        ]
        gateway.deadline()
        assert len(commands(gateway.sample(after_ns=PERIOD_NS))) == 1

    def test_skipped_counters_are_counted_and_told_moderately(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        reports = []
        for _ in range(40):
            gateway.deadline()
            gateway.lose_sample()
            gateway.deadline()
            gateway.give(ADC_UP, DAC_UP)
            output = gateway.sample()
            assert len(commands(output)) == 1
            reports += texts(output)
        assert gateway.core.lost_samples == 40
        assert reports == [
            f"guard: TPDO1_ADC: counter skipped 1, {number} so far" for number in (*range(1, 9), 16, 32)
        ]

    def test_a_skip_is_told_with_a_rejection_too(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        for _ in range(2):
            gateway.deadline()
            gateway.lose_sample()
        gateway.deadline()
        output = gateway.sample((0.0, 5.0, 5.0))
        assert [text.split(" outside")[0] for text in texts(output)] == [
            "guard: TPDO1_ADC: counter skipped 2, 2 so far",
            "guard: rejected: vertical: potentiometer 0.000 V",
        ]


class TestStaleness:
    @pytest.mark.parametrize("limit", [1, 2, 3, 7])
    @pytest.mark.parametrize("state", [LifeCycleState.ARMED, LifeCycleState.RUNNING])
    def test_the_limit_is_exact_to_the_period(self, limit: int, state: LifeCycleState) -> None:
        gateway = hand(state, adc__stale_after_periods=str(limit))
        gateway.period()
        for _ in range(limit):
            gateway.deadline()
            assert gateway.state is state
        output = gateway.deadline()
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output) == [
            f"adc: no good sample for {limit} periods, limit {limit} (rig: adc.stale_after_periods); "
            "last: no TPDO1_ADC came"
        ]
        assert gateway.core.fault_reason == faults(output)[0]

    def test_a_good_sample_begins_the_count_anew(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        for _ in range(20):
            gateway.deadline()
            gateway.give(ADC_UP, DAC_UP)
            gateway.lose_sample()
            gateway.deadline()
            gateway.lose_sample()
            gateway.deadline()
            gateway.sample()
        assert gateway.state is LifeCycleState.RUNNING

    def test_ready_falls_back_to_offline(self) -> None:
        gateway = hand(LifeCycleState.READY)
        gateway.deadline()
        gateway.deadline()
        gateway.deadline()
        output = gateway.deadline()
        assert gateway.state is LifeCycleState.OFFLINE
        assert [event.severity for event in output.log] == [Severity.WARNING, Severity.INFO]
        assert texts(output)[1] == "life cycle: ready -> offline (boards lost)"
        gateway.periods(FIRST_ANSWER_PERIODS + 2)  # the board has missed four SYNCs
        assert gateway.state is LifeCycleState.READY

    def test_until_then_the_board_holds(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.period()
        for _ in range(3):
            output = gateway.deadline()
            assert [frame for frame in output.frames if frame != GATEWAY_HEARTBEAT] == [SYNC]

    def test_the_fault_leaves_before_sync_and_the_next_after_it(self) -> None:
        """A board that applies commands at SYNC centres in this very period."""
        gateway = hand(LifeCycleState.RUNNING)
        for _ in range(3):
            gateway.deadline()
        output = gateway.deadline()
        assert [frame.id for frame in output.frames if frame != GATEWAY_HEARTBEAT] == [0x220, 0x080, 0x220]
        assert commands(output) == [CENTRED, CENTRED]

    def test_the_valves_of_a_hung_adc_board_are_centred_in_time(self) -> None:
        bench = Bench(make_rig(), setpoints="step:0.1@0").run()
        bench.periods(5)
        assert max(bench.boards.dac.valve_v) > 6.0
        bench.boards.adc.faults = AdcFaults(hung=True)
        for _ in range(3):
            bench.period()
            assert max(bench.boards.dac.valve_v) > 5.5
        bench.period()
        assert bench.gateway.state is LifeCycleState.FAULT
        assert bench.boards.dac.valve_v == CENTRED

    def test_the_cycles_of_a_fault_tell_the_centre(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.period()
        for _ in range(6):
            gateway.deadline()
        states = [LifeCycleState(cycle.state) for cycle in gateway.told.cycles[-5:]]
        command_v = [cycle.axes[0].command_v for cycle in gateway.told.cycles[-5:]]
        assert states == [LifeCycleState.RUNNING] * 3 + [LifeCycleState.FAULT] * 2
        assert command_v == pytest.approx([6.0, 6.0, 6.0, 5.0, 5.0])

    def test_in_fault_silence_is_not_told_again(self) -> None:
        gateway = hand(LifeCycleState.READY)
        gateway.core.link_failed("x")
        events = [event for _ in range(TIMEOUT_PERIODS + 10) for event in gateway.deadline().log]
        assert events == []

    def test_while_offline_nothing_is_counted(self) -> None:
        gateway = hand()
        for _ in range(50):
            assert gateway.deadline().log == ()
        assert gateway.state is LifeCycleState.OFFLINE


class TestLateDeadlines:
    def test_a_late_wake_within_the_period_is_served_and_the_next_is_not_moved(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        due_ns = gateway.core.next_deadline_ns
        output = gateway.deadline(late_ns=PERIOD_NS - 1)
        assert output.log == ()
        assert gateway.core.next_deadline_ns == due_ns + PERIOD_NS
        assert gateway.core.missed_periods == 0

    @pytest.mark.parametrize("skipped", [1, 2])
    def test_missed_periods_are_skipped_counted_and_told(self, skipped: int) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.period()
        due_ns = gateway.core.next_deadline_ns
        output = gateway.deadline(late_ns=skipped * PERIOD_NS)
        assert output.frames.count(SYNC) == 1
        assert texts(output) == [f"loop: woke {skipped * 11.2:.1f} ms late: {skipped} periods skipped"]
        assert gateway.core.next_deadline_ns == due_ns + (skipped + 1) * PERIOD_NS
        assert gateway.core.missed_periods == skipped
        cycle = gateway.sample().cycle
        assert cycle is not None
        assert (cycle.number, cycle.deadline_ns) == (2 + skipped, due_ns + skipped * PERIOD_NS)

    def test_they_are_never_caught_up(self) -> None:
        gateway = hand(LifeCycleState.READY)
        gateway.deadline(late_ns=10 * PERIOD_NS + 5)
        assert gateway.core.next_deadline_ns == gateway.now_ns - 5 + PERIOD_NS

    def test_an_early_call_is_no_missed_period(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        due_ns = gateway.core.next_deadline_ns
        output = gateway.deadline(late_ns=-3_000_000)
        assert output.log == ()
        assert gateway.core.next_deadline_ns == due_ns + PERIOD_NS
        assert gateway.core.missed_periods == 0

    @pytest.mark.parametrize(("skipped", "is_fault"), [(2, False), (3, True)])
    def test_a_stall_as_long_as_the_staleness_limit_is_a_fault(self, skipped: int, is_fault: bool) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.period()
        output = gateway.deadline(late_ns=skipped * PERIOD_NS)
        assert (gateway.state is LifeCycleState.FAULT) == is_fault
        assert faults(output) == is_fault * [
            "adc: no good sample for 3 periods, limit 3 (rig: adc.stale_after_periods); "
            "last: the loop itself missed 3 deadlines"
        ]

    def test_skipped_and_silent_periods_add_up(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.deadline()
        gateway.deadline()  # one period without a sample
        gateway.deadline(late_ns=PERIOD_NS)  # another, and one skipped
        assert gateway.state is LifeCycleState.FAULT

    def test_the_setpoint_follows_the_deadlines_over_a_skip(self) -> None:
        rig = make_rig()
        gateway = HandGateway(rig, make_gateway(rig, setpoints="ladder:0.01,0.02,0.03,0.04@0/0.0112"))
        gateway.to(LifeCycleState.RUNNING)
        gateway.period()
        gateway.deadline(late_ns=2 * PERIOD_NS)
        cycle = gateway.sample().cycle
        assert cycle is not None
        assert cycle.axes[0].setpoint == 0.04


class TestVeryLateWake:
    """Over half a period late, the next SYNC would follow too soon."""

    def test_the_period_passes_without_sync_and_is_told(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.period()
        output = gateway.deadline(late_ns=PERIOD_NS // 2 + 1)
        assert SYNC not in output.frames
        assert texts(output) == ["loop: woke 5.6 ms late: this period passes without SYNC"]
        assert gateway.core.missed_periods == 1
        assert SYNC in gateway.deadline().frames
        assert len(commands(gateway.sample())) == 1

    def test_half_a_period_is_served(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.period()
        assert SYNC in gateway.deadline(late_ns=PERIOD_NS // 2).frames
        assert gateway.core.missed_periods == 0

    @pytest.mark.parametrize("trigger", [Trigger.STOP, None])
    def test_a_command_that_centres_does_not_wait(self, trigger: Trigger | None) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.period()
        if trigger:
            gateway.operate(trigger)
        else:
            gateway.core.link_failed("test")
        assert SYNC in gateway.deadline(late_ns=PERIOD_NS - 1).frames

    def test_a_late_command_gives_the_next_no_more_room(self) -> None:
        """At 100 V/s: 1.12 V a period, and for 0.6 of a period 0.672 V."""
        gateway = hand(
            LifeCycleState.RUNNING, **{f"axes__{name}__valve__max_rate_v_s": "100.0" for name in AXES}
        )
        core = gateway.core._loops._axes
        for axis in core:
            axis.law.output = lambda r, y: 4.0  # type: ignore[method-assign]
        gateway.period()
        gateway.deadline(late_ns=0)
        (late,) = commands(gateway.sample(after_ns=5_480_000))
        assert late == pytest.approx((7.24,) * 3, abs=1e-3)
        gateway.deadline()
        (after,) = commands(gateway.sample(after_ns=1_000_000))
        assert after == pytest.approx((7.24 + 0.672,) * 3, abs=1e-3)


class TestHeartbeatLoss:
    @pytest.mark.parametrize("board", ["adc", "dac"])
    @pytest.mark.parametrize("state", [LifeCycleState.ARMED, LifeCycleState.RUNNING])
    def test_either_board_is_a_fault_exactly_after_its_time(self, board: str, state: LifeCycleState) -> None:
        gateway = hand(state)
        other = DAC_UP if board == "adc" else ADC_UP
        gateway.deadline()
        gateway.give(ADC_UP, DAC_UP)
        gateway.sample()
        for _ in range(TIMEOUT_PERIODS):
            gateway.deadline()
            gateway.give(other)
            gateway.sample()
            assert gateway.state is state
        output = gateway.deadline()
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output) == [
            f"{board}: no heartbeat for 314 ms, limit 302 ms (rig: {board}.heartbeat_timeout_s)"
        ]
        assert commands(output) == [CENTRED, CENTRED]
        assert output.frames[0].id == codec.RPDO1_DAC

    @pytest.mark.parametrize("board", ["adc", "dac"])
    def test_each_has_its_own_time(self, board: str) -> None:
        gateway = hand(LifeCycleState.READY, **{f"{board}__heartbeat_timeout_s": "0.1344"})
        for _ in range(12):
            gateway.deadline()
            gateway.sample()
            assert gateway.state is LifeCycleState.READY
        output = gateway.deadline()
        assert gateway.state is LifeCycleState.OFFLINE
        assert texts(output)[0].startswith(f"{board}: no heartbeat for ")

    def test_ready_comes_back_with_the_heartbeat(self) -> None:
        gateway = hand(LifeCycleState.READY)
        for _ in range(TIMEOUT_PERIODS + 1):
            gateway.deadline()
            gateway.give(ADC_UP)
            gateway.sample()
        assert gateway.state is LifeCycleState.OFFLINE
        gateway.period()
        assert gateway.state is LifeCycleState.READY

    def test_a_silent_simulated_board_is_a_fault(self) -> None:
        bench = Bench(make_rig()).run()
        bench.boards.dac.faults = DacFaults(silent_heartbeat=True)
        bench.periods(40)
        assert bench.gateway.state is LifeCycleState.FAULT
        assert bench.gateway.fault_reason is not None
        assert bench.gateway.fault_reason.startswith("dac: no heartbeat for ")
        assert bench.boards.dac.valve_v == CENTRED


class TestBoardRestart:
    @pytest.mark.parametrize("boot", [ADC_BOOT, DAC_BOOT])
    def test_while_running_it_is_a_fault_at_once_and_the_board_is_started(self, boot: Frame) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.periods(3)
        output = gateway.give(boot)
        board, node = ("adc", 0x10) if boot == ADC_BOOT else ("dac", 0x20)
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output) == [f"{board}: left operational: boot-up"]
        assert [frame.id for frame in output.frames] == [codec.RPDO1_DAC, codec.NMT]
        assert commands(output) == [CENTRED]
        assert output.frames[1].data == bytes((1, node))

    @pytest.mark.parametrize("nmt_state", [4, 127, 3])
    def test_leaving_operational_is_a_fault_too(self, nmt_state: int) -> None:
        gateway = hand(LifeCycleState.ARMED)
        assert faults(gateway.give(Frame(codec.HEARTBEAT_DAC, bytes((nmt_state,)))))
        assert gateway.state is LifeCycleState.FAULT

    def test_in_ready_it_goes_offline_and_comes_back(self) -> None:
        gateway = hand(LifeCycleState.READY)
        gateway.give(DAC_BOOT)
        assert gateway.state is LifeCycleState.OFFLINE
        gateway.period()
        assert gateway.state is LifeCycleState.READY

    @pytest.mark.parametrize("is_announced", [True, False])
    def test_its_counter_may_begin_anew(self, is_announced: bool) -> None:
        """Whether the boot-up message came, or the board was first missed and then came back."""
        gateway = hand(LifeCycleState.READY)
        gateway.period()
        last = gateway.counter - 1
        if not is_announced:
            for _ in range(TIMEOUT_PERIODS + 2):
                gateway.deadline()
                gateway.give(DAC_UP)
        gateway.give(ADC_BOOT)
        gateway.counter = last  # the very counter that came last
        gateway.periods(1 if is_announced else FIRST_ANSWER_PERIODS)
        assert gateway.state is LifeCycleState.READY
        assert gateway.core.rejected_frames == 0
        assert gateway.core.lost_samples == 0

    def test_the_other_boards_restart_does_not_excuse_a_repeated_counter(self) -> None:
        gateway = hand(LifeCycleState.READY)
        gateway.period()
        gateway.give(DAC_BOOT)
        gateway.deadline()
        gateway.counter -= 1
        assert "repeated" in texts(gateway.sample())[0]

    @pytest.mark.parametrize("board", ["adc", "dac"])
    def test_a_simulated_board_that_restarts_is_brought_up_again_after_reset(self, board: str) -> None:
        bench = Bench(make_rig()).run()
        bench.periods(20)
        slave = getattr(bench.boards, board)
        bench._carry((), slave.start(bench.now_ns))
        assert bench.gateway.state is LifeCycleState.FAULT
        bench.operate(Trigger.RESET)
        bench.periods(12)
        assert bench.gateway.state is LifeCycleState.READY
        bench.operate(Trigger.ARM)
        bench.operate(Trigger.START)
        bench.periods(20)
        assert bench.gateway.state is LifeCycleState.RUNNING


class TestBabble:
    @pytest.mark.parametrize("frame", [emergency(0x090, 0x1001), error_frame(BUS_OFF)])
    def test_in_fault_it_is_told_moderately(self, frame: Frame) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        events = [event for _ in range(1024) for event in gateway.give(frame).log]
        assert gateway.state is LifeCycleState.FAULT
        assert 15 <= len(events) <= 18

    @pytest.mark.parametrize(
        "frames", [(ADC_BOOT, ADC_UP), (emergency(0x0A0, 0x1000), emergency(0x0A0, 0, 0))]
    )
    @pytest.mark.parametrize("state", [LifeCycleState.OFFLINE, LifeCycleState.FAULT])
    def test_a_node_that_changes_its_mind_is_too(
        self, frames: tuple[Frame, ...], state: LifeCycleState
    ) -> None:
        gateway = hand(state)
        told = [event for _ in range(512) for event in gateway.give(*frames).log]
        assert 15 <= len(told) <= 40

    def test_a_node_that_leaves_operational_all_the_time_is_started_once_a_period(self) -> None:
        gateway = hand()
        for _ in range(10):
            gateway.deadline()
            gateway.give(*[ADC_BOOT, ADC_UP, DAC_BOOT] * 20)
        starts = [frame.data[1] for frame in gateway.told.frames if frame.id == codec.NMT]
        assert starts == [0x10, 0x20] * 10

    def test_after_a_reset_it_is_told_again(self) -> None:
        gateway = hand()
        warning = emergency(0x090, 0x1000)
        told = [len(gateway.give(warning).log) for _ in range(9)]
        assert told == [1] * 8 + [0]
        gateway.core.link_failed("x")
        gateway.operate(Trigger.RESET)
        assert len(gateway.give(warning).log) == 1

    def test_rejections_in_every_other_period_are_told_with_their_number(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        told: list[str] = []
        for _ in range(64):
            gateway.deadline()
            told += texts(gateway.give(Frame(codec.TPDO1_ADC, b"")))
            gateway.lose_sample()
            gateway.period()
        assert len(told) == 8 + 3
        assert told[7].startswith("guard: rejected: ")
        assert told[8].startswith("guard: rejected (16 so far): ")


class TestEmergencies:
    @pytest.mark.parametrize(("identifier", "board"), [(codec.EMCY_ADC, "adc"), (codec.EMCY_DAC, "dac")])
    @pytest.mark.parametrize("state", [LifeCycleState.ARMED, LifeCycleState.RUNNING])
    def test_armed_or_running_it_is_a_fault(self, identifier: int, board: str, state: LifeCycleState) -> None:
        gateway = hand(state)
        output = gateway.give(emergency(identifier, 0x8250))
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output) == [f"{board}: EMCY 0x8250 (RPDO did not come in time), error register 0x11"]
        assert commands(output) == [CENTRED]

    @pytest.mark.parametrize("state", [LifeCycleState.OFFLINE, LifeCycleState.READY])
    def test_before_it_is_a_warning(self, state: LifeCycleState) -> None:
        gateway = hand(state)
        event, *_ = gateway.give(emergency(codec.EMCY_DAC, 0x1000, 0x01)).log
        assert event == LogEntry(Severity.WARNING, "dac", "EMCY 0x1000 (generic error), error register 0x01")
        assert gateway.state is LifeCycleState.OFFLINE

    @pytest.mark.parametrize(("identifier", "boot"), [(codec.EMCY_ADC, ADC_BOOT), (codec.EMCY_DAC, DAC_BOOT)])
    @pytest.mark.parametrize("is_restarted", [True, False])
    def test_a_board_in_error_is_not_ready_until_it_says_that_none_is_left(
        self, identifier: int, boot: Frame, is_restarted: bool
    ) -> None:
        gateway = hand(LifeCycleState.READY)
        gateway.give(emergency(identifier, 0x2310))
        gateway.periods(20)
        assert gateway.state is LifeCycleState.OFFLINE
        (refusal,) = texts(gateway.operate(Trigger.ARM))
        assert "operational, in error: EMCY 0x2310 (current at the device's output)" in refusal
        gateway.give(boot if is_restarted else emergency(identifier, 0, 0))
        gateway.periods(FIRST_ANSWER_PERIODS + 1)
        assert gateway.state is LifeCycleState.READY

    def test_what_the_vendor_adds_is_told(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        frame = Frame(codec.EMCY_DAC, codec.encode_emcy_dac(0x8200, 0x11, 2, 7))
        assert faults(gateway.give(frame)) == [
            "dac: EMCY 0x8200 (protocol error), error register 0x11, vendor bytes 02 07 00 00 00"
        ]

    @pytest.mark.parametrize("state", LIVE_STATES)
    def test_its_end_is_good_news(self, state: LifeCycleState) -> None:
        gateway = hand(state)
        output = gateway.give(emergency(codec.EMCY_ADC, 0, 0))
        assert output == Output(log=(LogEntry(Severity.INFO, "adc", "EMCY: no error"),))
        assert gateway.state is state

    @pytest.mark.parametrize("length", [0, 7])
    def test_another_length_is_rejected(self, length: int) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        output = gateway.give(Frame(codec.EMCY_DAC, bytes(length)))
        assert texts(output) == [f"guard: rejected: EMCY of dac has {length} bytes, not 8"]
        assert gateway.state is LifeCycleState.RUNNING

    def test_a_simulated_boards_emergency_is_a_fault(self) -> None:
        bench = Bench(make_rig()).run()
        bench.periods(3)
        bench.boards.dac.faults = DacFaults(emergency_code=0x5030)
        bench.period()
        assert bench.gateway.fault_reason == "dac: EMCY 0x5030 (device hardware), error register 0x11"


FOREIGN = {
    "RPDO1_DAC": Frame(codec.RPDO1_DAC, bytes(8)),
    "SYNC": Frame(codec.SYNC),
    "NMT": Frame(codec.NMT, b"\x01\x00"),
    "HEARTBEAT_GATEWAY": Frame(codec.HEARTBEAT_GATEWAY, b"\x05"),
}


class TestForeignMaster:
    @pytest.mark.parametrize("state", LIVE_STATES)
    @pytest.mark.parametrize("name", FOREIGN)
    def test_the_gateways_own_frames_from_elsewhere_are_a_fault(
        self, name: str, state: LifeCycleState
    ) -> None:
        gateway = hand(state)
        output = gateway.give(FOREIGN[name])
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output) == [
            f"bus: foreign {name} frame {FOREIGN[name]}: another master commands this bus"
        ]
        assert commands(output) == [CENTRED]

    @pytest.mark.parametrize("identifier", COMMANDS_TO_BOARDS)
    def test_commands_to_the_boards_from_elsewhere_are_a_fault_once_armed(self, identifier: int) -> None:
        frame = Frame(identifier, bytes(8))
        for state in (LifeCycleState.OFFLINE, LifeCycleState.READY):
            gateway = hand(state)
            assert "is not in arm.dbc" in texts(gateway.give(frame))[0]
            assert gateway.state is state
        for state in (LifeCycleState.ARMED, LifeCycleState.RUNNING):
            gateway = hand(state)
            said = gateway.give(frame)
            assert commands(said) == [CENTRED]
            assert faults(said)[0].endswith("another master commands this bus")

    def test_a_stranger_of_their_number_hides_none(self) -> None:
        gateway = hand(LifeCycleState.FAULT)
        gateway.give(Frame(0x080, is_extended=True))
        assert len(texts(gateway.give(FOREIGN["SYNC"]))) == 1

    @pytest.mark.parametrize("data", [b"", b"\0", bytes(8)])
    def test_whatever_they_carry(self, data: bytes) -> None:
        for frame in FOREIGN.values():
            gateway = hand(LifeCycleState.RUNNING)
            gateway.give(frame._replace(data=data))
            assert gateway.state is LifeCycleState.FAULT

    def test_in_fault_each_is_told_once(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        told = []
        for _ in range(100):
            told += texts(gateway.give(*FOREIGN.values()))
        assert [text.split(" ")[2] for text in told if text.startswith("bus")] == list(FOREIGN)

    def test_after_a_reset_they_are_a_fault_again(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.give(*FOREIGN.values())
        gateway.operate(Trigger.RESET)
        assert faults(gateway.give(FOREIGN["SYNC"]))


class TestBusErrors:
    @pytest.mark.parametrize("state", LIVE_STATES)
    def test_bus_off_is_a_fault(self, state: LifeCycleState) -> None:
        gateway = hand(state)
        output = gateway.give(error_frame(0x40))
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output) == ["bus: bus-off: check wiring, termination and bit rate"]
        assert commands(output) == [CENTRED]

    @pytest.mark.parametrize("bit", [bit for bit in range(29) if 1 << bit != 0x40])
    def test_no_other_class_of_error_is(self, bit: int) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.give(error_frame(1 << bit))
        assert gateway.state is LifeCycleState.RUNNING

    def test_bus_off_among_other_classes_is_one_too(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.give(error_frame(0x40 | 0x04))
        assert gateway.state is LifeCycleState.FAULT

    def test_other_errors_are_counted_and_told_moderately(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        told = [text for _ in range(20) for text in texts(gateway.give(error_frame(0x04)))]
        assert gateway.core.error_frames == 20
        assert told == [
            f"bus: error frame 00000004#0000000000000000, {number} so far" for number in (*range(1, 9), 16)
        ]
        assert gateway.state is LifeCycleState.RUNNING

    def test_the_shells_loss_of_the_link_is_a_fault(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        output = gateway.core.link_failed("vcan0: network is down")
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output) == ["link: vcan0: network is down"]
        assert commands(output) == [CENTRED]

    def test_a_second_fault_is_told_and_the_first_reason_stays(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.core.link_failed("first")
        output = gateway.core.link_failed("second")
        assert output == Output(log=(LogEntry(Severity.WARNING, "link", "second"),))
        assert gateway.core.fault_reason == "link: first"


STRANGERS = {
    "unknown": Frame(0x123, b"\x01"),
    "extended": Frame(0x190, bytes(8), is_extended=True),
    "remote": Frame(0x190, b"", is_remote=True),
    "extended RPDO1": Frame(0x220, bytes(8), is_extended=True),
    "remote SYNC": Frame(0x080, b"", is_remote=True),
    "another node's TPDO": Frame(0x191, bytes(8)),
    "SDO": Frame(0x590, bytes(8)),
}


class TestStrangers:
    @pytest.mark.parametrize("kind", STRANGERS)
    @pytest.mark.parametrize("state", LifeCycleState)
    def test_they_are_told_once_and_change_nothing(self, kind: str, state: LifeCycleState) -> None:
        gateway = hand(state)
        frame = STRANGERS[kind]
        output = gateway.give(frame)
        assert output.frames == ()
        assert texts(output) == [
            f"bus: frame {frame} is not in arm.dbc; further ones of its identifier are ignored in silence"
        ]
        for _ in range(3):
            assert gateway.give(frame) == Output()
        assert gateway.state is state

    def test_a_babbling_node_does_not_fill_the_recording(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        told = [gateway.give(Frame(identifier, is_extended=True)).log for identifier in range(1000, 1500)]
        assert sum(map(len, told)) == MOST_REPORTED
        assert gateway.state is LifeCycleState.RUNNING

    def test_an_extended_frame_is_no_sample(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.deadline()
        sample = sample_frame(CENTRED, gateway.counter)
        assert gateway.give(sample._replace(is_extended=True)).frames == ()
        assert len(commands(gateway.sample())) == 1


class TestNotFinite:
    GROWING = TransferFunctionLaw(num=[1.0], den=[1.0, -1e10])  # overflows within 40 samples

    def test_an_output_that_is_not_finite_is_a_fault_and_leaves_no_command(self) -> None:
        rig = make_rig()
        laws = {
            "vertical": PidLaw(kp=20.0, ki=0.0),
            "horizontal": self.GROWING,
            "rotation": PidLaw(kp=1.0, ki=0.0),
        }
        gateway = HandGateway(rig, make_gateway(rig, laws))
        gateway.core._loops._axes[1].law._L = [0.0]  # as if nothing had limited it
        gateway.to(LifeCycleState.RUNNING)
        for _ in range(60):
            gateway.deadline()
            gateway.give(ADC_UP, DAC_UP)
            output = gateway.sample()
            if gateway.state is LifeCycleState.FAULT:
                break
        assert commands(output) == [CENTRED]
        (text,) = faults(output)
        assert text.startswith("horizontal: control law gave ")
        assert text.endswith(" V at setpoint 0.05, position 0")
        assert output.cycle is not None
        assert output.cycle.state is LifeCycleState.FAULT
        assert not math.isfinite(output.cycle.axes[1].output_v)
        assert [axis.command_v for axis in output.cycle.axes] == list(CENTRED)

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    @pytest.mark.parametrize("axis", [0, 1, 2])
    def test_on_any_axis(self, value: float, axis: int) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.core._loops._axes[axis].setpoint = lambda t: value
        gateway.deadline()
        output = gateway.sample()
        assert commands(output) == [CENTRED]
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output)[0].startswith(f"{gateway.core._loops._axes[axis].name}: control law gave ")


def test_no_number_that_is_not_finite_reaches_the_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    gateway = hand(LifeCycleState.RUNNING)
    asked: list[float] = []
    command = gateway.core._loops._valves.command

    def spied(index: int, offset_v: float) -> float:
        asked.append(offset_v)
        return command(index, offset_v)

    monkeypatch.setattr(gateway.core._loops._valves, "command", spied)
    gateway.core._loops._axes[1].setpoint = lambda t: math.nan
    gateway.deadline()
    gateway.sample()
    assert len(asked) == 1
    assert math.isfinite(asked[0])


class TestReset:
    def test_after_it_the_counter_and_the_reports_begin_anew(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.deadline()
        gateway.give(Frame(codec.TPDO1_ADC, b""))
        gateway.core.link_failed("x")
        gateway.operate(Trigger.RESET)
        gateway.counter -= 1  # the last counter once more
        gateway.periods(FIRST_ANSWER_PERIODS + 1)
        assert gateway.state is LifeCycleState.READY
        gateway.give(FOREIGN["SYNC"])
        gateway.operate(Trigger.RESET)
        assert len(gateway.give(Frame(codec.TPDO1_ADC, b"")).log) == 1
        gateway.give(FOREIGN["SYNC"])
        gateway.operate(Trigger.RESET)
        assert len(gateway.give(Frame(codec.TPDO1_ADC, b"")).log) == 1

    def test_periods_in_fault_are_not_held_against_it(self) -> None:
        gateway = hand(LifeCycleState.FAULT)
        for _ in range(20):
            gateway.deadline()
        gateway.operate(Trigger.RESET)
        gateway.periods(FIRST_ANSWER_PERIODS + 1)
        gateway.operate(Trigger.ARM)
        gateway.deadline()
        gateway.deadline()
        assert gateway.state is LifeCycleState.ARMED


PATIENT = {"adc__stale_after_periods": "5"}


class TestWhichSync:
    """A sample is fresh if it answers the last SYNC; the board's counter tells."""

    def test_a_late_answer_is_rejected_and_the_one_in_time_taken(self) -> None:
        gateway = hand(LifeCycleState.RUNNING, **PATIENT)
        gateway.period()
        gateway.deadline()
        gateway.deadline()  # the answer to the SYNC before comes only now
        late = gateway.sample()
        assert commands(late) == []
        assert texts(late) == [
            "guard: rejected: TPDO1_ADC: answers an earlier SYNC, 1 before the last: it is late, "
            "or the board missed a SYNC"
        ]
        assert len(commands(gateway.sample())) == 1
        assert SYNC in gateway.deadline().frames

    def test_a_board_that_missed_a_sync_is_followed_after_two_periods_without_one(self) -> None:
        gateway = hand(LifeCycleState.RUNNING, **PATIENT)
        gateway.period()
        gateway.deadline()  # SYNC is lost: no answer
        gateway.deadline()
        assert commands(gateway.sample()) == []
        for _ in range(2):
            output = gateway.deadline()
            assert SYNC not in output.frames
            assert texts(output) == ["guard: a period without SYNC, to tell late from lost"]
        for _ in range(3):
            assert SYNC in gateway.deadline().frames
            assert len(commands(gateway.sample())) == 1

    @pytest.mark.parametrize("late_periods", [1, 2, 3, 4])
    @pytest.mark.parametrize("has_lost", [False, True])
    @pytest.mark.parametrize("state", [LifeCycleState.RUNNING, LifeCycleState.FAULT])
    def test_a_link_that_becomes_slow_moves_nothing_and_is_a_fault(
        self, late_periods: int, has_lost: bool, state: LifeCycleState
    ) -> None:
        """However patient the rig file is; nor does a reset make it look fresh."""
        gateway = hand(LifeCycleState.RUNNING, adc__stale_after_periods="60")
        gateway.period()
        if has_lost:
            gateway.deadline()  # SYNC is lost: no answer
            gateway.periods(4)
            assert len(commands(gateway.period())) == 1
        is_resetting = state is LifeCycleState.FAULT
        due: list[int] = []
        for number in range(140):
            if SYNC in gateway.deadline().frames:
                due.append(number + late_periods)
            gateway.give(ADC_UP, DAC_UP)
            while due and due[0] <= number:
                due.pop(0)
                assert [volts for volts in commands(gateway.sample()) if volts != CENTRED] == []
                assert gateway.state is not LifeCycleState.READY
            if number == 30 and is_resetting:
                gateway.told.add(gateway.core.link_failed("test"))
            if number == 50 and is_resetting:
                gateway.operate(Trigger.RESET)
        assert gateway.state is (LifeCycleState.OFFLINE if is_resetting else LifeCycleState.FAULT)

    @pytest.mark.parametrize("late_ns", [1_000_000, PERIOD_NS - 1_000_000])
    def test_lost_syncs_cost_as_little_as_can_be(self, late_ns: int) -> None:
        """Its own answer, the next one, and two periods without SYNC: under the shipped limit of 5."""
        gateway = hand(LifeCycleState.RUNNING, **PATIENT)
        for _ in range(20):
            gateway.deadline()
            gateway.give(ADC_UP, DAC_UP)
            assert len(commands(gateway.sample(after_ns=late_ns))) == 1
            gateway.deadline()  # SYNC is lost
            gateway.deadline()
            assert commands(gateway.sample(after_ns=late_ns)) == []
            silent = 0
            while SYNC not in gateway.deadline().frames:
                silent += 1
            assert silent == 2
            assert len(commands(gateway.sample(after_ns=late_ns))) == 1

    def test_a_machine_that_stalls_is_not_taken_for_a_board_that_missed_a_sync(self) -> None:
        gateway = hand(LifeCycleState.RUNNING, adc__stale_after_periods="60")
        gateway.period()
        gateway.deadline()  # here it had
        gateway.periods(5)
        gateway.deadline()
        gateway.deadline(late_ns=4 * PERIOD_NS)
        assert commands(gateway.sample()) == []  # the answer to the SYNC before the stall
        for stall in (6, 0):
            assert SYNC not in gateway.deadline(late_ns=stall * PERIOD_NS).frames
        assert commands(gateway.sample()) == []  # to the one after it
        assert SYNC in gateway.deadline().frames
        gateway.give(ADC_UP, DAC_UP)
        assert len(commands(gateway.sample())) == 1
        assert gateway.state is LifeCycleState.RUNNING

    def test_without_a_counter_a_lost_answer_costs_three_periods(self) -> None:
        gateway = hand(LifeCycleState.RUNNING, adc__protected="false", **PATIENT)
        for _ in range(5):
            gateway.period()
            assert SYNC in gateway.deadline().frames  # its answer is lost
            gateway.give(ADC_UP, DAC_UP)
            assert [SYNC in gateway.deadline().frames for _ in range(3)] == [False, False, True]
            assert len(commands(gateway.sample())) == 1

    def test_a_first_sync_that_is_lost_is_sent_again(self) -> None:
        gateway = hand()
        gateway.give(ADC_UP, DAC_UP)
        had_sync = [SYNC in gateway.deadline().frames for _ in range(11)]
        assert [number for number, had in enumerate(had_sync) if had] == [0, 5, 10]
        gateway.sample()
        assert gateway.state is LifeCycleState.READY

    @pytest.mark.parametrize("late_periods", [1, 3])
    @pytest.mark.parametrize("protected", ["true", "false"])
    @pytest.mark.parametrize("has_restarted", [False, True])
    def test_a_link_slow_from_the_beginning_is_never_ready(
        self, late_periods: int, protected: str, has_restarted: bool
    ) -> None:
        gateway = hand(
            LifeCycleState.READY if has_restarted else LifeCycleState.OFFLINE, adc__protected=protected
        )
        if has_restarted:
            gateway.period()
            gateway.give(ADC_BOOT)
        due: list[int] = []
        for number in range(200):
            if SYNC in gateway.deadline().frames:
                due.append(number + late_periods)
            gateway.give(ADC_UP, DAC_UP)
            while due and due[0] <= number:
                due.pop(0)
                gateway.sample()
        assert gateway.state is LifeCycleState.OFFLINE
        assert gateway.core.rejected_frames > 30

    def test_an_answer_within_the_silent_period_has_its_age(self) -> None:
        gateway = hand(LifeCycleState.RUNNING, **PATIENT)
        gateway.period()
        gateway.deadline()
        gateway.deadline()
        gateway.sample()
        assert SYNC not in gateway.deadline().frames
        late = gateway.sample()
        assert commands(late) == []
        assert "ms after SYNC exceeds" in gateway.core._last_rejection

    @pytest.mark.parametrize("state", [LifeCycleState.OFFLINE, LifeCycleState.READY, LifeCycleState.ARMED])
    def test_it_comes_back_in_every_state(self, state: LifeCycleState) -> None:
        gateway = hand(state, **PATIENT)
        gateway.period()
        gateway.deadline()  # SYNC is lost
        gateway.period()
        gateway.periods(2)
        assert gateway.state is max(state, LifeCycleState.READY)
        assert gateway.period().cycle is not None

    @pytest.mark.parametrize("is_ahead", [True, False])
    @pytest.mark.parametrize("state", [LifeCycleState.ARMED, LifeCycleState.RUNNING])
    def test_another_node_that_sends_samples_too_is_a_fault_or_never_heard(
        self, state: LifeCycleState, is_ahead: bool
    ) -> None:
        """What it says never moves a valve, though its CRC is sound."""
        gateway = hand(state, **PATIENT)
        gateway.period()
        other = sample_frame((9.0, 9.0, 9.0), gateway.counter + (40 if is_ahead else -40))
        said = gateway.give(other)
        assert (gateway.state is LifeCycleState.FAULT) == is_ahead
        assert gateway.core.rejected_frames == 1
        if is_ahead:
            assert commands(said) == [CENTRED]
            assert faults(said)[0].startswith(
                "adc: TPDO1_ADC: counter 42 after 1, but 0 SYNC unanswered: another node sends it too"
            )
            return
        assert commands(said) == []
        assert "an old sample" in texts(said)[0]
        before = len(gateway.told.cycles)
        gateway.periods(5)
        assert [cycle.fresh for cycle in gateway.told.cycles[before:]] == [True] * 5

    def test_one_with_the_same_node_id_and_counter_is_a_fault(self) -> None:
        """Two boards of one node id, started by one NMT command, count alike."""
        gateway = hand(LifeCycleState.RUNNING)
        gateway.deadline()
        assert len(commands(gateway.sample())) == 1
        twin = sample_frame((5.0, 5.0, 5.1), gateway.counter - 1)
        output = gateway.give(twin)
        assert commands(output) == [CENTRED]
        assert faults(output) == [
            "adc: TPDO1_ADC: counter 1 came twice, with other values: another node sends it too, perhaps one "
            "of the same node id"
        ]

    def test_the_same_frame_twice_is_no_fault(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.deadline()
        gateway.sample()
        gateway.counter -= 1
        assert commands(gateway.sample()) == []
        assert gateway.state is LifeCycleState.RUNNING

    @pytest.mark.parametrize("protected", ["true", "false"])
    @pytest.mark.parametrize("is_first", [True, False])
    @pytest.mark.parametrize("ahead", [0, -40])
    def test_one_that_answers_as_well_is_a_fault_whatever_it_counts(
        self, protected: str, is_first: bool, ahead: int
    ) -> None:
        gateway = hand(LifeCycleState.RUNNING, adc__protected=protected, **PATIENT)
        gateway.periods(3)
        for number in range(4):
            assert gateway.state is LifeCycleState.RUNNING, number
            gateway.deadline()
            other = sample_frame((5.0, 5.0, 5.0), gateway.counter + ahead, protected=protected == "true")
            if is_first:
                gateway.give(other)
            gateway.sample()
            if not is_first:
                gateway.give(other)
            if gateway.state is LifeCycleState.FAULT:
                break
        assert number == 2
        assert str(gateway.core.fault_reason).startswith(
            "adc: TPDO1_ADC: 3 periods with more answers than SYNCs: another node sends it too"
        )

    def test_a_frame_that_comes_twice_now_and_then_is_none(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        for _ in range(40):
            gateway.period()
            gateway.counter -= 1
            gateway.sample()
            gateway.period()
        assert gateway.state is LifeCycleState.RUNNING

    def test_two_boards_from_the_beginning_are_never_ready_when_an_operator_could_arm(self) -> None:
        gateway = hand()
        for _ in range(100):
            output = gateway.deadline()
            assert gateway.state is LifeCycleState.OFFLINE
            gateway.give(ADC_UP, DAC_UP)
            if SYNC in output.frames:
                gateway.sample()
                gateway.counter -= 1
                gateway.sample()
        assert "more answers than SYNCs" in gateway.core.readiness
        gateway.periods(FIRST_ANSWER_PERIODS + 7)
        assert gateway.state is LifeCycleState.READY

    def test_nor_is_it_heard_before_the_boards_own_sample(self) -> None:
        gateway = hand(LifeCycleState.RUNNING)
        gateway.period()
        gateway.deadline()
        gateway.give(sample_frame((9.0, 9.0, 9.0), gateway.counter + 1))
        assert gateway.state is LifeCycleState.FAULT

    def test_with_it_nothing_becomes_ready_for_long(self) -> None:
        gateway = hand(LifeCycleState.READY)
        gateway.period()
        gateway.give(sample_frame(CENTRED, gateway.counter + 3))
        assert gateway.state is LifeCycleState.OFFLINE
        for _ in range(50):
            gateway.deadline()
            assert gateway.state is LifeCycleState.OFFLINE
            gateway.give(ADC_UP, DAC_UP)
            gateway.sample()
            gateway.give(sample_frame(CENTRED, gateway.counter + 3))

    def test_a_command_that_centres_never_waits(self) -> None:
        gateway = hand(LifeCycleState.RUNNING, **PATIENT)
        gateway.period()
        gateway.deadline()
        gateway.deadline()
        gateway.sample()
        gateway.operate(Trigger.STOP)
        assert SYNC in gateway.deadline().frames
