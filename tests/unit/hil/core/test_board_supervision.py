"""Reactions to the boards' heartbeats, restarts and emergency messages."""

from __future__ import annotations

from typing import Any

import pytest
from support.constants import CENTRED
from support.gateway_bench import (
    ADC_BOOT,
    ADC_UP,
    DAC_BOOT,
    DAC_UP,
    LIVE_STATES,
    TIMEOUT_PERIODS,
    RigBench,
    commands,
    emergency,
    error_frame,
    faults,
    make_rig,
    make_stepped,
    texts,
)

from firmware_sim.boards.faults import DacFaults
from hil.core.frames import Frame
from hil.core.gateway import BUS_OFF
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.nmt_starts import IMMEDIATE_STARTS, SETTLED_NS
from hil.core.output import LogEntry, Output, Severity
from hil.core.sync_matching import ANSWER_TIMEOUT_PERIODS
from hil.core.wire import codec


class TestHeartbeatLoss:
    @pytest.mark.parametrize("board", ["adc", "dac"])
    @pytest.mark.parametrize("state", [LifeCycleState.ARMED, LifeCycleState.RUNNING])
    def test_a_heartbeat_timeout_of_either_board_is_a_fault_at_its_exact_time(
        self, board: str, state: LifeCycleState
    ) -> None:
        gateway = make_stepped(state)
        other = DAC_UP if board == "adc" else ADC_UP
        gateway.deadline()
        gateway.receive(ADC_UP, DAC_UP)
        gateway.sample()
        for _ in range(TIMEOUT_PERIODS):
            gateway.deadline()
            gateway.receive(other)
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
    def test_each_board_has_its_own_timeout(self, board: str) -> None:
        gateway = make_stepped(LifeCycleState.READY, **{f"{board}__heartbeat_timeout_s": "0.1344"})
        for _ in range(12):
            gateway.deadline()
            gateway.sample()
            assert gateway.state is LifeCycleState.READY
        output = gateway.deadline()
        assert gateway.state is LifeCycleState.OFFLINE
        assert texts(output)[0].startswith(f"{board}: no heartbeat for ")

    def test_a_heartbeat_after_a_timeout_leads_back_to_ready(self) -> None:
        gateway = make_stepped(LifeCycleState.READY)
        for _ in range(TIMEOUT_PERIODS + 1):
            gateway.deadline()
            gateway.receive(ADC_UP)
            gateway.sample()
        assert gateway.state is LifeCycleState.OFFLINE
        gateway.period()
        assert gateway.state is LifeCycleState.READY

    def test_a_simulated_board_without_heartbeat_is_a_fault(self) -> None:
        bench = RigBench(make_rig()).run()
        bench.boards.dac.faults = DacFaults(silent_heartbeat=True)
        bench.periods(40)
        assert bench.gateway.state is LifeCycleState.FAULT
        assert bench.gateway.fault_reason is not None
        assert bench.gateway.fault_reason.startswith("dac: no heartbeat for ")
        assert bench.boards.dac.valve_v == CENTRED


class TestBoardRestart:
    @pytest.mark.parametrize("boot", [ADC_BOOT, DAC_BOOT])
    def test_a_restart_while_running_is_a_fault_and_the_board_is_started(self, boot: Frame) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.periods(3)
        output = gateway.receive(boot)
        board, node = ("adc", 0x10) if boot == ADC_BOOT else ("dac", 0x20)
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output) == [f"{board}: left operational: boot-up"]
        assert [frame.id for frame in output.frames] == [codec.RPDO1_DAC, codec.NMT]
        assert commands(output) == [CENTRED]
        assert output.frames[1].data == bytes((1, node))

    @pytest.mark.parametrize("nmt_state", [4, 127, 3])
    def test_leaving_operational_while_armed_is_a_fault(self, nmt_state: int) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        assert faults(gateway.receive(Frame(codec.HEARTBEAT_DAC, bytes((nmt_state,)))))
        assert gateway.state is LifeCycleState.FAULT

    def test_a_restart_in_ready_leads_to_offline_and_back(self) -> None:
        gateway = make_stepped(LifeCycleState.READY)
        gateway.receive(DAC_BOOT)
        assert gateway.state is LifeCycleState.OFFLINE
        gateway.period()
        assert gateway.state is LifeCycleState.READY

    @pytest.mark.parametrize("is_announced", [True, False])
    def test_the_counter_of_a_restarted_board_may_begin_with_any_value(self, is_announced: bool) -> None:
        """The board is restarted with a boot-up message at once, or after its heartbeat timed out."""
        gateway = make_stepped(LifeCycleState.READY)
        gateway.period()
        last = gateway.counter - 1
        if not is_announced:
            for _ in range(TIMEOUT_PERIODS + 2):
                gateway.deadline()
                gateway.receive(DAC_UP)
        gateway.receive(ADC_BOOT)
        gateway.counter = last  # the counter of the last sample again
        gateway.periods(1 if is_announced else ANSWER_TIMEOUT_PERIODS)
        assert gateway.state is LifeCycleState.READY
        assert gateway.core.rejected_frames == 0
        assert gateway.core.lost_samples == 0

    def test_a_restart_of_the_dac_board_does_not_allow_a_repeated_counter(self) -> None:
        gateway = make_stepped(LifeCycleState.READY)
        gateway.period()
        gateway.receive(DAC_BOOT)
        gateway.deadline()
        gateway.counter -= 1
        assert "repeated" in texts(gateway.sample())[0]

    @pytest.mark.parametrize("board", ["adc", "dac"])
    def test_a_restarted_simulated_board_comes_up_after_a_reset(self, board: str) -> None:
        bench = RigBench(make_rig()).run()
        bench.periods(20)
        bench.restart_board(board)
        assert bench.gateway.state is LifeCycleState.FAULT
        bench.operate(Trigger.RESET)
        bench.periods(12)
        assert bench.gateway.state is LifeCycleState.READY
        bench.operate(Trigger.ARM)
        bench.operate(Trigger.START)
        bench.periods(20)
        assert bench.gateway.state is LifeCycleState.RUNNING


class TestEmergencies:
    @pytest.mark.parametrize(("identifier", "board"), [(codec.EMCY_ADC, "adc"), (codec.EMCY_DAC, "dac")])
    @pytest.mark.parametrize("state", [LifeCycleState.ARMED, LifeCycleState.RUNNING])
    def test_an_emergency_while_armed_or_running_is_a_fault(
        self, identifier: int, board: str, state: LifeCycleState
    ) -> None:
        gateway = make_stepped(state)
        output = gateway.receive(emergency(identifier, 0x8250))
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output) == [f"{board}: EMCY 0x8250 (RPDO did not come in time), error register 0x11"]
        assert commands(output) == [CENTRED]

    @pytest.mark.parametrize("state", [LifeCycleState.OFFLINE, LifeCycleState.READY])
    def test_an_emergency_before_arming_is_a_warning(self, state: LifeCycleState) -> None:
        gateway = make_stepped(state)
        entry, *_ = gateway.receive(emergency(codec.EMCY_DAC, 0x1000, 0x01)).log
        assert entry == LogEntry(Severity.WARNING, "dac", "EMCY 0x1000 (generic error), error register 0x01")
        assert gateway.state is LifeCycleState.OFFLINE

    @pytest.mark.parametrize(("identifier", "boot"), [(codec.EMCY_ADC, ADC_BOOT), (codec.EMCY_DAC, DAC_BOOT)])
    @pytest.mark.parametrize("is_restarted", [True, False])
    def test_a_board_in_error_is_not_ready_until_it_reports_no_error_or_restarts(
        self, identifier: int, boot: Frame, is_restarted: bool
    ) -> None:
        gateway = make_stepped(LifeCycleState.READY)
        gateway.receive(emergency(identifier, 0x2310))
        gateway.periods(20)
        assert gateway.state is LifeCycleState.OFFLINE
        (refusal,) = texts(gateway.operate(Trigger.ARM))
        assert "operational, in error: EMCY 0x2310 (current at the device's output)" in refusal
        gateway.receive(boot if is_restarted else emergency(identifier, 0, 0))
        gateway.periods(ANSWER_TIMEOUT_PERIODS + 1)
        assert gateway.state is LifeCycleState.READY

    def test_the_vendor_bytes_of_an_emergency_are_reported(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        frame = Frame(codec.EMCY_DAC, codec.encode_emcy_dac(0x8200, 0x11, 2, 7))
        assert faults(gateway.receive(frame)) == [
            "dac: EMCY 0x8200 (protocol error), error register 0x11, vendor bytes 02 07 00 00 00"
        ]

    @pytest.mark.parametrize("state", LIVE_STATES)
    def test_the_end_of_an_emergency_is_reported_as_information(self, state: LifeCycleState) -> None:
        gateway = make_stepped(state)
        output = gateway.receive(emergency(codec.EMCY_ADC, 0, 0))
        assert output == Output(log=(LogEntry(Severity.INFO, "adc", "EMCY: no error"),))
        assert gateway.state is state

    @pytest.mark.parametrize("length", [0, 7])
    def test_an_emergency_of_wrong_length_is_rejected(self, length: int) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        output = gateway.receive(Frame(codec.EMCY_DAC, bytes(length)))
        assert texts(output) == [f"guard: rejected: EMCY of dac has {length} bytes, not 8"]
        assert gateway.state is LifeCycleState.RUNNING

    def test_each_board_has_its_own_decoder(self, monkeypatch: pytest.MonkeyPatch) -> None:
        decoded: list[str] = []
        for board, name in ((codec.EMCY_ADC, "decode_emcy_adc"), (codec.EMCY_DAC, "decode_emcy_dac")):
            decode = getattr(codec, name)

            def spy(data: bytes, name: str = name, decode: Any = decode) -> Any:
                decoded.append(name)
                return decode(data)

            monkeypatch.setattr(codec, name, spy)
            make_stepped().receive(emergency(board, 0x1000))
        assert decoded == ["decode_emcy_adc", "decode_emcy_dac"]

    def test_an_emergency_of_a_simulated_board_is_a_fault(self) -> None:
        bench = RigBench(make_rig()).run()
        bench.periods(3)
        bench.boards.dac.faults = DacFaults(emergency_code=0x5030)
        bench.period()
        assert bench.gateway.fault_reason == "dac: EMCY 0x5030 (device hardware), error register 0x11"


class TestThrottling:
    @pytest.mark.parametrize("frame", [emergency(0x090, 0x1001), error_frame(BUS_OFF)])
    def test_reports_in_state_fault_are_throttled(self, frame: Frame) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        entries = [entry for _ in range(1024) for entry in gateway.receive(frame).log]
        assert gateway.state is LifeCycleState.FAULT
        assert 15 <= len(entries) <= 18

    @pytest.mark.parametrize(
        "frames", [(ADC_BOOT, ADC_UP), (emergency(0x0A0, 0x1000), emergency(0x0A0, 0, 0))]
    )
    @pytest.mark.parametrize("state", [LifeCycleState.OFFLINE, LifeCycleState.FAULT])
    def test_reports_of_alternating_board_states_and_emergencies_are_throttled(
        self, frames: tuple[Frame, ...], state: LifeCycleState
    ) -> None:
        gateway = make_stepped(state)
        reports = [entry for _ in range(512) for entry in gateway.receive(*frames).log]
        assert 15 <= len(reports) <= 40

    def test_a_board_is_started_at_most_once_per_period_and_not_for_ever(self) -> None:
        gateway = make_stepped()
        for periods in range(1, 11):
            gateway.deadline()
            gateway.receive(*[ADC_BOOT, ADC_UP, DAC_BOOT] * 20)
            assert len([frame for frame in gateway.transcript.frames if frame.id == codec.NMT]) <= 2 * periods
        starts = [frame.data[1] for frame in gateway.transcript.frames if frame.id == codec.NMT]
        assert starts == [0x10, 0x20] * IMMEDIATE_STARTS

    def test_a_reset_ends_the_throttling_of_reports(self) -> None:
        gateway = make_stepped()
        warning = emergency(0x090, 0x1000)
        reports = [len(gateway.receive(warning).log) for _ in range(9)]
        assert reports == [1] * 8 + [0]
        gateway.core.link_failed("x")
        gateway.operate(Trigger.RESET)
        assert len(gateway.receive(warning).log) == 1


class TestFindings:
    """What a board has said about its errors, once the gateway has asked it."""

    def test_a_finding_is_shown_only_while_the_board_is_not_operational(self) -> None:
        gateway = make_stepped()
        gateway.core._boards._queries["dac"].finding = "error register 0x01"
        gateway.receive(ADC_UP, Frame(codec.HEARTBEAT_DAC, b"\x7f"))
        assert gateway.core.readiness == "adc operational; dac pre-operational: error register 0x01"
        gateway.receive(DAC_UP)
        assert gateway.core.readiness == "adc operational; dac operational"

    def test_a_question_that_is_not_answered_in_time_is_reported_once(self) -> None:
        gateway = make_stepped()
        gateway.deadline()
        gateway.core._boards._queries["dac"].begin(gateway.now_ns)
        reports = [
            text for _ in range(60) for text in texts(gateway.deadline()) if "not operational after" in text
        ]
        assert len(reports) == 1
        assert "no answer to SDO (1001h:0) within 500 ms" in reports[0]

    def test_an_answer_is_followed_by_the_next_question_and_is_no_foreign_frame(self) -> None:
        gateway = make_stepped()
        gateway.core._boards._queries["dac"].begin(gateway.now_ns)
        output = gateway.receive(Frame(0x5A0, bytes.fromhex("4F01100011000000")))
        assert output == Output((Frame(0x620, bytes.fromhex("4003100100000000")),))
        report = gateway.receive(Frame(0x5A0, bytes.fromhex("4303100110820000")))
        assert texts(report) == [
            "dac: not operational after 0 NMT starts: error register 0x11 (generic error, communication "
            "error, 1001h); last error 0x8210 (PDO not processed: too short) (1003h)"
        ]

    def test_a_board_that_has_settled_is_asked_anew_the_next_time(self) -> None:
        gateway = make_stepped()
        query, starts = gateway.core._boards._queries["dac"], gateway.core._boards.dac.starts
        query.begin(gateway.now_ns)
        query.finding, starts.sent = "error register 0x01", IMMEDIATE_STARTS + 1
        gateway.receive(DAC_UP)
        assert query.is_begun and query.finding is not None
        gateway.now_ns += SETTLED_NS
        gateway.receive(DAC_UP)
        assert starts.sent == 0
        assert not query.is_begun and query.finding is None
