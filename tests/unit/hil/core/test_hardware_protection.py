"""The gateway with an emergency stop, an enable switch and a read-back of the valves."""

from __future__ import annotations

import json

import pytest
from support.constants import CENTRED, PERIOD_NS
from support.gateway_bench import (
    ADC_UP,
    DAC_UP,
    SYNC,
    RigBench,
    SteppedGateway,
    commands,
    faults,
    make_gateway,
    texts,
)
from support.protected_rigs import (
    BOTH,
    EMERGENCY_STOP,
    ENABLE,
    ENABLE_BIT,
    STOP_BIT,
    inputs_frame,
    protected_rig,
    read_back_frame,
)

from firmware_sim.boards.faults import AdcFaults, DacFaults
from hil.core.control_law import ControlLaw
from hil.core.controller_file import PidLaw
from hil.core.core_state import restore, state_of
from hil.core.experiment import read_experiment
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Output, Severity
from hil.core.requests import JogRequest
from hil.core.rig import Rig
from hil.core.setpoints import parse_setpoint
from hil.core.wire import codec

EXPERIMENT = """{"format": "hil-experiment", "version": 1, "axis": "vertical", "mode": "open loop",
"signal": {"kind": "steps", "amplitude": 0.2, "hold_s": 1.0, "duration_s": 5.0}}"""
OPEN_TEXT = "the contact is open: bit 0 of byte 0 of frame 0x290 is 0 (rig: emergency_stop)"
ACTIVE = [LifeCycleState.ARMED, LifeCycleState.RUNNING]


class ProtectedGateway(SteppedGateway):
    """The gateway alone, with a test that plays boards and contacts. ``bits`` are those of the contacts."""

    def __init__(self, rig: Rig, core: Gateway | None = None) -> None:
        super().__init__(rig, core or make_gateway(rig))
        self.bits: int | None = BOTH
        self.pins: tuple[float, ...] | None = CENTRED
        """Voltages on the valves' pins; None for a board that sends no read-back."""
        self.input_counter = 0

    def period(self, volts: object = None) -> Output:
        has_sync = SYNC in self.deadline().frames
        output = self.receive(ADC_UP, DAC_UP)
        if has_sync:
            output = self.sample()
            self.inputs()
            if self.rig.dac.read_back and self.pins is not None:
                self.receive(read_back_frame(self.pins, self.counter))
        return output

    def inputs(self) -> Output:
        """The frame of the contacts arrives now."""
        if self.bits is None or not self.rig.inputs:
            return Output()
        self.input_counter += 1
        return self.receive(inputs_frame(self.bits, self.input_counter))


def gateway(state: LifeCycleState, tables: str = EMERGENCY_STOP, read_back: bool = False) -> ProtectedGateway:
    subject = ProtectedGateway(protected_rig(tables, read_back))
    subject.bring_to(state)
    assert subject.state is state
    return subject


def experiment_gateway(tables: str) -> ProtectedGateway:
    """A gateway in state armed whose vertical axis an experiment will excite."""
    rig = protected_rig(tables)
    experiment = read_experiment(EXPERIMENT, rig)
    core = Gateway(
        rig,
        {name: ControlLaw(PidLaw(kp=20.0, ki=0.0), rig.loop.period_s) for name in rig.axes},
        {name: parse_setpoint("hold") for name in rig.axes},
        1_000_000_000,
        experiment,
    )
    subject = ProtectedGateway(rig, core)
    subject.bring_to(LifeCycleState.ARMED)
    return subject


class TestEmergencyStop:
    @pytest.mark.parametrize("bits", [None, 0, ENABLE_BIT])
    def test_without_a_closed_contact_nothing_arms_and_the_refusal_says_why(self, bits: int | None) -> None:
        subject = ProtectedGateway(protected_rig())
        subject.bits = bits
        subject.periods(20)
        (refusal,) = texts(subject.operate(Trigger.ARM))
        why = "no frame 0x290 has shown the contact closed" if bits is None else OPEN_TEXT
        assert refusal.startswith(
            "life cycle: arm refused in state offline (wait for state ready: adc operational; "
            "dac operational; "
        )
        assert f"emergency stop: {why}" in refusal
        assert why in subject.core.readiness
        assert set(subject.transcript.commands()) == {CENTRED}

    def test_a_closed_contact_lets_the_gateway_become_ready(self) -> None:
        subject = gateway(LifeCycleState.READY)
        assert "emergency stop: the contact is closed" in subject.transcript.texts()
        assert "emergency stop" not in subject.core.readiness

    @pytest.mark.parametrize("state", ACTIVE)
    def test_an_opened_contact_is_a_fault_that_centres_the_valves_in_the_same_call(
        self, state: LifeCycleState
    ) -> None:
        subject = gateway(state)
        subject.periods(5)
        subject.bits = 0
        output = subject.inputs()
        assert subject.state is LifeCycleState.FAULT
        assert faults(output) == [f"emergency stop: {OPEN_TEXT}: it is pressed, or its wire is broken"]
        assert commands(output) == [CENTRED]

    @pytest.mark.parametrize("state", ACTIVE)
    def test_missing_frames_are_a_fault_at_the_first_deadline_after_the_timeout(
        self, state: LifeCycleState
    ) -> None:
        subject = gateway(state)
        subject.periods(5)
        subject.bits = None
        for _ in range(4):
            subject.period()
        assert subject.state is state
        output = subject.deadline()
        assert faults(output) == [
            "emergency stop: no good frame 0x290 for 55.0 ms, limit 50 ms (rig: emergency_stop.timeout_s)"
        ]
        assert output.frames[0].id == codec.RPDO1_DAC
        assert commands(output) == [CENTRED, CENTRED]

    def test_a_sample_after_the_timeout_gives_no_command_but_the_centring_one(self) -> None:
        """The timeout can pass between a deadline and the sample."""
        subject = gateway(LifeCycleState.RUNNING)
        subject.periods(5)
        subject.bits = None
        subject.periods(3)
        subject.deadline()
        subject.receive(ADC_UP, DAC_UP)
        output = subject.sample((6.0, 6.0, 6.0), after_ns=PERIOD_NS - 1)
        assert subject.state is LifeCycleState.FAULT
        assert commands(output) == [CENTRED]
        assert output.cycle is not None and output.cycle.fresh

    def test_in_ready_an_opened_contact_leads_to_offline_and_a_closed_one_back(self) -> None:
        subject = gateway(LifeCycleState.READY)
        subject.bits = 0
        assert texts(subject.inputs())[-1] == "life cycle: ready -> offline (boards lost)"
        subject.bits = STOP_BIT
        subject.periods(2)
        assert subject.state is LifeCycleState.READY

    def test_a_timeout_between_two_deadlines_refuses_to_arm(self) -> None:
        subject = gateway(LifeCycleState.READY)
        subject.now_ns += 60_000_000
        assert any("arm refused in state offline" in text for text in texts(subject.operate(Trigger.ARM)))
        assert subject.state is LifeCycleState.OFFLINE

    def test_after_a_fault_the_contact_must_be_closed_to_become_ready(self) -> None:
        subject = gateway(LifeCycleState.RUNNING)
        subject.bits = 0
        subject.period()
        subject.operate(Trigger.RESET)
        subject.periods(20)
        assert subject.state is LifeCycleState.OFFLINE
        subject.bits = STOP_BIT
        subject.periods(2)
        assert subject.state is LifeCycleState.READY

    def test_in_fault_an_opened_contact_is_reported_once(self) -> None:
        subject = gateway(LifeCycleState.FAULT)
        subject.periods(5)
        subject.bits = 0
        reports = [text for _ in range(10) for text in texts(subject.inputs())]
        assert [text for text in reports if OPEN_TEXT in text] == [reports[0]]

    def test_damaged_frames_are_reported_and_do_not_hold_the_contact_closed(self) -> None:
        subject = gateway(LifeCycleState.RUNNING)
        subject.bits = None
        reports = []
        for number in range(6):
            subject.period()
            reports += texts(subject.receive(inputs_frame(STOP_BIT, 100 + number, crc_error=1)))
        assert subject.state is LifeCycleState.FAULT
        assert reports[0].startswith("guard: rejected: frame 0x290: CRC 0x")

    def test_a_contact_of_the_simulated_board_stops_the_arm(self) -> None:
        bench = RigBench(protected_rig()).run()
        bench.periods(20)
        bench.boards.adc.faults = AdcFaults(emergency_stop_pressed=True)
        bench.period()
        assert bench.gateway.fault_reason is not None
        assert bench.gateway.fault_reason.startswith(f"emergency stop: {OPEN_TEXT}")
        bench.period()
        assert bench.boards.dac.valve_v == CENTRED

    @pytest.mark.parametrize("broken", [AdcFaults(silent_inputs=True), AdcFaults(input_crcs_to_corrupt=100)])
    def test_a_simulated_board_whose_inputs_fail_is_a_fault(self, broken: AdcFaults) -> None:
        bench = RigBench(protected_rig()).run()
        bench.periods(20)
        bench.boards.adc.faults = broken
        bench.periods(6)
        assert bench.gateway.state is LifeCycleState.FAULT

    def test_a_digital_input_without_counter_and_crc_works_too(self) -> None:
        bench = RigBench(protected_rig(EMERGENCY_STOP + "protected = false\n")).run()
        bench.periods(20)
        assert bench.gateway.state is LifeCycleState.RUNNING
        bench.boards.adc.faults = AdcFaults(emergency_stop_pressed=True)
        bench.period()
        assert bench.gateway.state is LifeCycleState.FAULT

    def test_without_the_table_a_frame_of_inputs_is_reported_once(self) -> None:
        subject = gateway(LifeCycleState.RUNNING, tables="")
        frame = inputs_frame(0, 1)
        assert texts(subject.receive(frame)) == [
            f"bus: frame {frame} is TPDO2_ADC, which this rig does not use (rig: emergency_stop.frame, "
            "enable.frame); further frames with its identifier are not reported"
        ]
        assert subject.receive(frame) == Output()
        assert subject.state is LifeCycleState.RUNNING


class TestEnable:
    def test_motion_without_an_experiment_does_not_need_the_switch(self) -> None:
        subject = ProtectedGateway(protected_rig(ENABLE))
        subject.bits = 0
        subject.bring_to(LifeCycleState.RUNNING)
        subject.periods(10)
        assert subject.state is LifeCycleState.RUNNING

    @pytest.mark.parametrize("bits", [0, STOP_BIT])
    def test_an_experiment_does_not_start_without_the_switch(self, bits: int) -> None:
        subject = experiment_gateway(ENABLE)
        subject.bits = bits
        subject.periods(2)
        (refusal,) = texts(subject.operate(Trigger.START))
        assert refusal == (
            "enable: start refused: the contact is open: bit 1 of byte 0 of frame 0x290 is 0 (rig: enable): "
            "nobody holds the switch, or its wire is broken"
        )
        assert subject.state is LifeCycleState.ARMED

    @pytest.mark.parametrize("is_silent", [True, False])
    def test_a_released_switch_stops_the_experiment_with_centred_valves(self, is_silent: bool) -> None:
        subject = experiment_gateway(ENABLE)
        subject.operate(Trigger.START)
        subject.periods(3)
        assert subject.state is LifeCycleState.RUNNING
        if is_silent:
            subject.bits = None
            subject.periods(4)
            output = subject.deadline()
        else:
            subject.bits = 0
            output = subject.inputs()
        assert subject.state is LifeCycleState.ARMED
        assert set(commands(output)) == {CENTRED}
        assert [entry.severity for entry in output.log] == [Severity.WARNING, Severity.INFO]
        assert texts(output)[1] == "life cycle: running -> armed (stop)"
        subject.periods(5)
        assert subject.transcript.commands()[-5:] == [CENTRED] * 5

    def test_the_emergency_stop_comes_before_the_switch(self) -> None:
        subject = experiment_gateway(EMERGENCY_STOP + ENABLE)
        subject.operate(Trigger.START)
        subject.periods(3)
        subject.bits = 0
        output = subject.inputs()
        assert subject.state is LifeCycleState.FAULT
        assert not any(text.startswith("enable") for text in texts(output))

    def test_a_held_switch_starts_again_after_a_stop(self) -> None:
        subject = experiment_gateway(ENABLE)
        subject.operate(Trigger.START)
        subject.bits = 0
        subject.periods(2)
        subject.bits = ENABLE_BIT
        subject.periods(1)
        subject.operate(Trigger.START)
        assert subject.state is LifeCycleState.RUNNING


class TestJog:
    REQUEST = JogRequest("vertical", 0.3, 0.3)

    def test_without_the_switch_a_jog_is_refused(self) -> None:
        subject = ProtectedGateway(protected_rig(ENABLE))
        subject.bits = 0
        subject.bring_to(LifeCycleState.ARMED)
        reply = subject.operate(self.REQUEST).reply
        assert reply is not None and not reply.accepted
        assert reply.text.startswith("jog refused: enable: the contact is open: bit 1 of byte 0")

    def test_a_released_switch_ends_a_jog_in_the_same_call(self) -> None:
        subject = gateway(LifeCycleState.ARMED, ENABLE)
        reply = subject.operate(self.REQUEST).reply
        assert reply is not None and reply.accepted
        subject.periods(5)
        assert subject.transcript.commands()[-1][0] == pytest.approx(5.3, abs=0.001)
        subject.bits = 0
        output = subject.inputs()
        assert commands(output) == [CENTRED]
        assert subject.state is LifeCycleState.ARMED
        subject.periods(20)
        assert subject.transcript.commands()[-20:] == [CENTRED] * 20

    def test_without_an_enable_table_a_jog_needs_no_switch(self) -> None:
        subject = gateway(LifeCycleState.ARMED, EMERGENCY_STOP)
        subject.operate(self.REQUEST)
        subject.periods(3)
        assert subject.state is LifeCycleState.RUNNING

    def test_the_emergency_stop_is_a_fault_during_a_jog(self) -> None:
        subject = gateway(LifeCycleState.ARMED, EMERGENCY_STOP + ENABLE)
        subject.operate(self.REQUEST)
        subject.periods(3)
        subject.bits = ENABLE_BIT
        assert commands(subject.inputs()) == [CENTRED]
        assert subject.state is LifeCycleState.FAULT

    def test_a_jog_after_the_timeout_of_the_emergency_stop_is_refused(self) -> None:
        subject = gateway(LifeCycleState.ARMED, EMERGENCY_STOP)
        subject.now_ns += 60_000_000
        output = subject.operate(self.REQUEST)
        assert subject.state is LifeCycleState.FAULT
        assert output.reply is not None and not output.reply.accepted


class TestReadBack:
    def test_without_a_read_back_nothing_arms(self) -> None:
        subject = ProtectedGateway(protected_rig("", read_back=True))
        subject.pins = None
        subject.periods(20)
        assert subject.state is LifeCycleState.OFFLINE
        assert "dac: no read-back of the valves (TPDO1_DAC) has arrived" in subject.core.readiness

    @pytest.mark.parametrize("state", ACTIVE)
    def test_a_valve_that_does_not_follow_is_a_fault(self, state: LifeCycleState) -> None:
        subject = gateway(LifeCycleState.ARMED, "", read_back=True)
        subject.pins = (5.0, 7.0, 5.0)
        subject.periods(2)
        assert subject.state is LifeCycleState.ARMED
        subject.period()
        assert subject.core.fault_reason is not None
        assert subject.core.fault_reason.startswith(
            "dac: valve of horizontal: 7.000 V on the pin, commanded 5.000 V: they differ by 2.000 V"
        )
        assert subject.transcript.commands()[-1] == CENTRED

    def test_missing_read_backs_are_a_fault_before_sync(self) -> None:
        subject = gateway(LifeCycleState.ARMED, "", read_back=True)
        subject.pins = None
        subject.periods(3)
        assert subject.state is LifeCycleState.ARMED
        output = subject.deadline()
        assert subject.state is LifeCycleState.FAULT
        assert [frame.id for frame in output.frames][:2] == [codec.RPDO1_DAC, codec.SYNC]

    @pytest.mark.parametrize("apply", ["at sync", "at once"])
    @pytest.mark.parametrize("protected", [True, False])
    def test_the_simulated_board_follows_fast_commands(self, apply: str, protected: bool) -> None:
        bench = RigBench(read_back_rig(apply, protected), setpoints="ladder:0.1,-0.1@0/0.1").run()
        bench.periods(100)
        assert bench.gateway.state is LifeCycleState.RUNNING
        assert len({command[0] for command in bench.transcript.commands()}) > 20

    @pytest.mark.parametrize("apply", ["at sync", "at once"])
    def test_a_frozen_valve_of_the_simulated_board_is_found(self, apply: str) -> None:
        bench = RigBench(read_back_rig(apply, True), setpoints="ladder:0.1,-0.1@0/0.1").run()
        bench.periods(30)
        bench.boards.dac.faults = DacFaults(frozen_v={1: 9.0})
        bench.periods(5)
        assert bench.gateway.fault_reason is not None
        assert bench.gateway.fault_reason.startswith("dac: valve of vertical: ")

    def test_a_simulated_board_that_stops_to_read_back_is_a_fault(self) -> None:
        bench = RigBench(read_back_rig("at sync", True)).run()
        bench.periods(30)
        bench.boards.dac.faults = DacFaults(silent_read_back=True)
        bench.periods(5)
        assert bench.gateway.fault_reason == (
            "dac: no read-back of the valves (TPDO1_DAC) for 3 periods, limit 3 "
            "(rig: adc.stale_after_periods)"
        )

    def test_a_valve_that_stays_open_after_a_fault_is_reported_once(self) -> None:
        subject = gateway(LifeCycleState.ARMED, "", read_back=True)
        subject.transcript.add(subject.core.link_failed("test"))
        subject.pins = (5.0, 5.0, 8.0)
        before = len(subject.transcript.log)
        subject.periods(10)
        said = [entry.text for entry in subject.transcript.log[before:] if "valve of rotation" in entry.text]
        assert len(said) == 1

    def test_a_frame_that_is_damaged_once_changes_nothing(self) -> None:
        subject = gateway(LifeCycleState.ARMED, "", read_back=True)
        subject.deadline()
        frame = read_back_frame(CENTRED, 99)
        output = subject.receive(frame._replace(data=frame.data[:-1] + b"\0"))
        assert texts(output)[0].startswith("guard: rejected: TPDO1_DAC: CRC 0x00")
        assert subject.state is LifeCycleState.ARMED

    def test_without_the_key_the_frame_is_reported_once(self) -> None:
        subject = gateway(LifeCycleState.RUNNING, "")
        (said,) = texts(subject.receive(read_back_frame(CENTRED, 1)))
        assert "is TPDO1_DAC, which this rig does not use (rig: dac.read_back); further" in said
        assert subject.receive(read_back_frame(CENTRED, 2)) == Output()


def read_back_rig(apply: str, protected: bool) -> Rig:
    from msgspec.structs import replace

    rig = protected_rig("", read_back=True, protected=protected)
    return replace(rig, dac=replace(rig.dac, apply=apply))


class TestState:
    """The state of a core with protection can be written and restored (``core_state``)."""

    @staticmethod
    def copy_of(core: Gateway, rig: Rig) -> Gateway:
        fresh = make_gateway(rig)
        restore(fresh, json.loads(json.dumps(state_of(core), allow_nan=False)))
        return fresh

    @pytest.mark.parametrize("bits", [0, ENABLE_BIT, BOTH, None])
    def test_a_copy_answers_as_the_original(self, bits: int | None) -> None:
        rig = protected_rig(EMERGENCY_STOP + ENABLE, read_back=True)
        subject = ProtectedGateway(rig)
        subject.bring_to(LifeCycleState.ARMED)
        subject.operate(JogRequest("vertical", 0.02, 0.5))
        subject.periods(5)
        twin = ProtectedGateway(rig, self.copy_of(subject.core, rig))
        twin.now_ns, twin.counter, twin.input_counter = subject.now_ns, subject.counter, subject.input_counter
        before = len(subject.transcript.frames)
        for one in (subject, twin):
            one.bits = bits
            one.pins = (5.0, 5.0, 5.3)
            one.periods(8)
        assert subject.transcript.frames[before:] == twin.transcript.frames
        assert subject.transcript.log[-len(twin.transcript.log) :] == twin.transcript.log
        assert state_of(subject.core) == state_of(twin.core)

    def test_a_copy_awaits_the_answer_of_a_board_too(self) -> None:
        bench = TestIgnoredStart.stubborn()
        bench.pass_to_gateway = lambda frame: () if frame.id == 0x5A0 else (frame,)
        while not any(frame.id == 0x620 for frame in bench.transcript.frames):
            bench.period()
        bench.gateway = self.copy_of(bench.gateway, bench.rig)
        bench.periods(60)
        assert bench.gateway.readiness.endswith("no answer to SDO (1001h:0) within 500 ms")


class TestIgnoredStart:
    """A board that ignores NMT start is asked why, and started ever more rarely."""

    @staticmethod
    def stubborn(error_code: int = 0x3310) -> RigBench:
        bench = RigBench(protected_rig(""))
        bench.boards.dac.faults = DacFaults(start_prevented_by=error_code)
        bench.restart_board("dac")
        return bench

    def test_its_error_register_and_last_error_are_reported_once_and_in_the_readiness(self) -> None:
        bench = self.stubborn()
        bench.periods(300)
        finding = (
            "error register 0x05 (generic error, voltage, 1001h); last error 0x3310 (output voltage) (1003h)"
        )
        said = [text for text in bench.transcript.texts() if "error register" in text]
        assert said == [f"dac: not operational after 3 NMT starts: {finding}"]
        assert bench.gateway.state is LifeCycleState.OFFLINE
        assert bench.gateway.readiness.endswith(f"dac pre-operational after 5 NMT starts: {finding}")

    def test_it_gets_few_starts(self) -> None:
        bench = self.stubborn()
        bench.periods(5400)  # one minute
        sent = [frame for frame in bench.transcript.frames if frame.id == codec.NMT and frame.data[1] == 0x20]
        assert 10 <= len(sent) <= 18
        assert len([frame for frame in bench.transcript.frames if frame.id == 0x620]) == 2

    def test_a_board_without_sdo_server_is_reported_too(self) -> None:
        bench = self.stubborn()
        bench.pass_to_gateway = lambda frame: () if frame.id == 0x5A0 else (frame,)
        bench.periods(100)
        assert bench.gateway.readiness.endswith("no answer to SDO (1001h:0) within 500 ms")

    def test_a_repaired_board_comes_up(self) -> None:
        bench = self.stubborn()
        bench.periods(100)
        bench.boards.dac.faults = None
        bench.periods(600)
        assert bench.gateway.state is LifeCycleState.READY
        assert bench.gateway.readiness == "adc operational; dac operational"

    def test_a_board_that_needed_many_starts_must_settle(self) -> None:
        bench = self.stubborn()
        bench.periods(140)
        bench.boards.dac.faults = None
        while bench.boards.dac.state != 5:
            bench.period()
        bench.periods(20)
        assert "dac operational, but not settled after" in bench.gateway.readiness
        assert bench.gateway.state is LifeCycleState.OFFLINE

    def test_a_board_that_toggles_its_state_gets_few_starts_and_entries(self) -> None:
        subject = SteppedGateway(protected_rig(""))
        entries = 0
        for number in range(2000):
            subject.deadline()
            state = 5 if number % 2 else 127
            subject.receive(ADC_UP, Frame(codec.HEARTBEAT_DAC, bytes((state,))))
            subject.sample()
        starts = [frame for frame in subject.transcript.frames if frame.id == codec.NMT]
        entries = len(subject.transcript.log)
        assert len(starts) <= 12
        assert entries <= 40
        assert subject.state is LifeCycleState.OFFLINE

    def test_an_answer_that_was_not_asked_for_is_a_foreign_frame(self) -> None:
        subject = SteppedGateway(protected_rig(""))
        answer = Frame(0x5A0, bytes.fromhex("4F01100011000000"))
        assert "is not in arm.dbc" in texts(subject.receive(answer))[0]


def test_a_good_frame_of_each_protection_reports_only_what_it_proves() -> None:
    rig = protected_rig(EMERGENCY_STOP, read_back=True)
    gateway = SteppedGateway(rig)
    assert texts(gateway.deadline()) == []
    assert texts(gateway.receive(inputs_frame(STOP_BIT, 0))) == ["emergency stop: the contact is closed"]
    assert texts(gateway.receive(read_back_frame((5.0, 5.0, 5.0), 0))) == [
        "dac: the valves follow their commands"
    ]
    gateway.sample()
    gateway.deadline()
    assert texts(gateway.receive(inputs_frame(STOP_BIT, 1))) == []
    assert texts(gateway.receive(read_back_frame((5.0, 5.0, 5.0), 1))) == []


def test_the_frame_of_one_contact_says_nothing_about_the_other() -> None:
    bare = "protected = false\n"
    gateway = SteppedGateway(protected_rig(EMERGENCY_STOP + bare + ENABLE.replace("0x290", "0x291") + bare))
    gateway.deadline()
    assert texts(gateway.receive(Frame(0x291, b"\x03"))) == []
    assert "no frame 0x290 has shown the contact closed" in gateway.core.readiness
    assert texts(gateway.receive(Frame(0x290, b"\x01"))) == ["emergency stop: the contact is closed"]
