"""The gateway core without faults: bring-up, commands, cycles, and other rig files.

The test plays the boards (``SteppedGateway``), or the simulated boards answer (``RigBench``).
"""

from __future__ import annotations

import math

import pytest
from support.constants import CENTRED, COUNT_V, PERIOD_NS
from support.gateway_bench import (
    ADC_BOOT,
    ADC_UP,
    DAC_BOOT,
    DAC_UP,
    GATEWAY_HEARTBEAT,
    START_NS,
    SYNC,
    RigBench,
    SteppedGateway,
    commands,
    make_gateway,
    make_rig,
    make_running,
    make_stepped,
    sample_frame,
    texts,
)
from support.wire import frame_crc

from hil.core.controller_file import PidLaw
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.sync_matching import ANSWER_TIMEOUT_PERIODS
from hil.core.wire import codec

START_ADC, START_DAC = Frame(0x000, b"\x01\x10"), Frame(0x000, b"\x01\x20")


class TestBringUp:
    def test_the_first_deadline_sends_sync_heartbeat_and_centre(self) -> None:
        output = make_stepped().deadline()
        assert output.frames[:2] == (SYNC, GATEWAY_HEARTBEAT)
        assert commands(output) == [CENTRED]
        assert output.cycle is None
        assert output.log == ()

    def test_a_boot_up_message_is_answered_by_nmt_start(self) -> None:
        gateway = make_stepped()
        gateway.deadline()
        assert gateway.receive(ADC_BOOT).frames == (START_ADC,)
        assert gateway.receive(DAC_BOOT).frames == (START_DAC,)
        assert gateway.transcript.texts() == ["adc: boot-up", "dac: boot-up"]

    def test_a_change_of_a_boards_state_is_reported_once(self) -> None:
        gateway = make_stepped()
        for _ in range(3):
            gateway.receive(ADC_BOOT)
        for _ in range(3):
            gateway.receive(ADC_UP)
        assert gateway.transcript.texts() == ["adc: boot-up", "adc: operational"]

    @pytest.mark.parametrize("state", [0, 4, 127, 99])
    def test_every_heartbeat_that_is_not_operational_is_answered_by_nmt_start(self, state: int) -> None:
        gateway = make_stepped()
        for _ in range(3):
            gateway.deadline()
            assert gateway.receive(Frame(0x710, bytes((state,)))).frames == (START_ADC,)

    def test_ready_needs_both_boards_and_a_good_sample_after_them(self) -> None:
        gateway = make_stepped()
        for heartbeats in ((), (ADC_UP,), (DAC_UP,)):
            gateway.deadline()
            assert gateway.state is LifeCycleState.OFFLINE
            gateway.receive(*heartbeats)
            assert gateway.state is LifeCycleState.OFFLINE
            output = gateway.sample()
            assert commands(output) == []
        assert gateway.state is LifeCycleState.READY
        assert texts(output) == ["life cycle: offline -> ready (boards up)"]

    @pytest.mark.parametrize("missing", [ADC_UP, DAC_UP])
    def test_one_board_alone_does_not_lead_to_ready(self, missing: Frame) -> None:
        gateway = make_stepped()
        for _ in range(5):
            gateway.deadline()
            gateway.receive(*{ADC_UP, DAC_UP} - {missing})
            gateway.sample()
            assert gateway.state is LifeCycleState.OFFLINE

    def test_a_rejected_sample_does_not_lead_to_ready(self) -> None:
        gateway = make_stepped()
        gateway.deadline()
        gateway.receive(ADC_UP, DAC_UP)
        gateway.sample((0.0, 5.0, 5.0))
        assert gateway.state is LifeCycleState.OFFLINE

    def test_the_gateways_heartbeat_is_sent_at_its_interval(self) -> None:
        gateway = make_stepped()
        sent = [GATEWAY_HEARTBEAT in gateway.deadline().frames for _ in range(28)]
        assert [k for k, is_sent in enumerate(sent) if is_sent] == [0, 9, 18, 27]

    @pytest.mark.parametrize("state", [LifeCycleState.RUNNING, LifeCycleState.FAULT])
    def test_the_gateways_heartbeat_is_sent_in_every_state(self, state: LifeCycleState) -> None:
        gateway = make_stepped(state)
        gateway.transcript.frames.clear()
        gateway.periods(18)
        assert gateway.transcript.frames.count(GATEWAY_HEARTBEAT) == 2

    def test_skipped_periods_do_not_skip_the_gateways_heartbeat(self) -> None:
        gateway = make_stepped()
        gateway.deadline()
        for _ in range(7):
            gateway.deadline()  # periods 1 to 7
        output = gateway.deadline(late_ns=2 * PERIOD_NS)  # would be 8, is 10
        assert GATEWAY_HEARTBEAT in output.frames
        sent = [GATEWAY_HEARTBEAT in gateway.deadline().frames for _ in range(9)]
        assert sent == [False] * 8 + [True]

    def test_a_sample_before_the_first_sync_is_rejected(self) -> None:
        gateway = make_stepped()
        gateway.receive(ADC_UP, DAC_UP)
        assert texts(gateway.sample()) == [
            "guard: rejected: TPDO1_ADC: no SYNC is unanswered: the frame came twice, "
            "or was sent without SYNC"
        ]
        assert gateway.state is LifeCycleState.OFFLINE

    @pytest.mark.parametrize(
        ("board", "identifier"), [("adc", codec.HEARTBEAT_ADC), ("dac", codec.HEARTBEAT_DAC)]
    )
    @pytest.mark.parametrize("length", [0, 2, 8])
    def test_a_heartbeat_of_another_length_is_rejected(
        self, board: str, identifier: int, length: int
    ) -> None:
        gateway = make_stepped()
        output = gateway.receive(Frame(identifier, b"\x05" * length))
        assert texts(output) == [f"guard: rejected: heartbeat of {board} has {length} bytes, not 1"]
        assert gateway.core.rejected_frames == 1
        assert f"{board} silent" in gateway.operate(Trigger.ARM).log[0].text

    def test_the_simulated_boards_come_up(self) -> None:
        bench = RigBench(make_rig())
        bench.periods(12)
        assert bench.gateway.state is LifeCycleState.READY
        assert [text for text in bench.transcript.texts() if "life cycle" in text or "dac" in text] == [
            "dac: boot-up",
            "dac: operational",
            "life cycle: offline -> ready (boards up)",
        ]
        assert bench.transcript.frames[:2] == [START_ADC, START_DAC]
        assert set(bench.transcript.commands()) == {CENTRED}


@pytest.mark.parametrize("state", [state for state in LifeCycleState if state is not LifeCycleState.RUNNING])
def test_valves_are_centred_every_period_in_every_state_but_running(state: LifeCycleState) -> None:
    gateway = make_stepped(state)
    for k in range(20):
        output = gateway.deadline()
        assert commands(output) == [CENTRED]
        assert output.frames[0] == SYNC or state is LifeCycleState.OFFLINE
        if state is not LifeCycleState.OFFLINE:
            gateway.receive(ADC_UP, DAC_UP)
            assert commands(gateway.sample((5.0 + 0.1 * k, 4.0, 6.0))) == []
        assert gateway.state is state


def test_a_valve_that_was_moved_while_armed_is_centred_at_the_next_deadline() -> None:
    gateway = make_stepped(LifeCycleState.ARMED)
    gateway.core._loops._valves.command(0, 2.0)
    assert commands(gateway.deadline()) == [CENTRED]


def test_before_the_first_sample_the_signals_of_a_cycle_are_nan() -> None:
    gateway = make_stepped()
    gateway.deadline()
    cycle = gateway.deadline().cycle
    assert cycle is not None
    assert (cycle.number, cycle.receive_ns, cycle.fresh) == (0, 0, False)
    for axis in cycle.axes:
        assert math.isnan(axis.setpoint) and math.isnan(axis.position) and math.isnan(axis.error)
        assert math.isnan(axis.potentiometer_v)
        assert (axis.output_v, axis.command_v) == (0.0, 5.0)


class TestRunning:
    def test_a_command_leaves_only_in_answer_to_a_fresh_good_sample(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING, adc__protected="false")
        for number in range(30):
            assert commands(gateway.deadline()) == []
            assert commands(gateway.receive(ADC_UP, DAC_UP)) == []
            assert len(commands(gateway.sample())) == 1
            gateway.now_ns += 100_000
            if number % 2:
                again = sample_frame(gateway.volts, 0, protected=False)
                assert commands(gateway.receive(again)) == []
        assert gateway.state is LifeCycleState.RUNNING

    def test_the_command_is_the_control_laws_output(self) -> None:
        """u = 20 (r - y) = 1 V for a setpoint of 0.05 m and an axis in the middle."""
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.deadline()
        (volts,) = commands(gateway.sample())
        assert volts == pytest.approx((6.0, 6.0, 6.0), abs=COUNT_V)

    def test_each_axis_has_its_own_loop(self) -> None:
        rig = make_rig()
        laws = {name: PidLaw(kp=kp, ki=0.0) for name, kp in zip(rig.axes, (10.0, 20.0, -1.0), strict=True)}
        steps = {"vertical": "step:0.1@0", "horizontal": "step:-0.05@0", "rotation": "step:1@0"}
        gateway = make_running(rig, laws, steps)
        gateway.deadline()
        # vertical at 0.033 m, horizontal at 0, rotation at -0.33 rad
        (volts,) = commands(gateway.sample((6.0, 5.0, 4.0)))
        expected = (5 + 10 * (0.1 - 0.033), 5 + 20 * -0.05, 5 - (1 + 0.33))
        assert volts == pytest.approx(expected, abs=2 * COUNT_V)

    def test_limits_act_and_the_cycle_has_the_voltages_before_and_after_them(self) -> None:
        rig = make_rig({"axes.vertical.valve.max_v": "6.5", "axes.horizontal.valve.max_rate_v_s": "10.0"})
        gateway = make_running(rig, PidLaw(kp=100.0, ki=0.0))
        gateway.deadline()
        output = gateway.sample()
        assert commands(output)[0] == pytest.approx((6.5, 5.112, 9.48), abs=COUNT_V)
        assert output.cycle is not None
        vertical, horizontal, rotation = output.cycle.axes
        assert [axis.output_v for axis in output.cycle.axes] == pytest.approx([5.0] * 3)
        assert vertical.command_v == pytest.approx(6.5, abs=COUNT_V)
        assert horizontal.command_v == pytest.approx(5.112)
        assert rotation.command_v == pytest.approx(5 + 400 * 0.0112)

    def test_a_control_law_at_its_limit_does_not_wind_up(self) -> None:
        """A PI law that was at its limit for 10 s leaves it as soon as the error changes sign."""
        narrow = {f"axes.{axis}.valve.max_v": "5.5" for axis in ("vertical", "horizontal", "rotation")}
        rig = make_rig(narrow, envelope='disabled = ["max_speed"]')  # the position jumps
        gateway = make_running(rig, PidLaw(kp=10.0, ki=20.0))
        gateway.periods(900)
        assert gateway.transcript.commands()[-1] == pytest.approx((5.5, 5.5, 5.5), abs=COUNT_V)
        gateway.period((9.0, 9.0, 9.0))
        assert max(gateway.transcript.commands()[-1]) < 5.0

    def test_the_cycle_of_a_good_sample(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.deadline(late_ns=300_000)
        deadline_ns = gateway.now_ns - 300_000
        (cycle,) = [gateway.sample((6.0, 5.0, 5.0), after_ns=700_000).cycle]
        assert cycle is not None
        assert (cycle.number, cycle.deadline_ns, cycle.wake_ns) == (1, deadline_ns, deadline_ns + 300_000)
        assert (cycle.receive_ns, cycle.state, cycle.fresh) == (
            deadline_ns + 1_000_000,
            LifeCycleState.RUNNING,
            True,
        )
        vertical = cycle.axes[0]
        assert vertical.setpoint == 0.05
        assert vertical.position == pytest.approx(0.033, abs=1e-5)
        assert vertical.error == vertical.setpoint - vertical.position
        assert vertical.output_v == pytest.approx(20 * vertical.error)
        assert vertical.command_v == 5.0 + vertical.output_v
        assert vertical.potentiometer_v == pytest.approx(6.0, abs=COUNT_V)

    def test_before_running_the_cycles_setpoint_follows_the_position(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.deadline()
        cycle = gateway.sample((6.0, 5.0, 5.0)).cycle
        assert cycle is not None
        vertical = cycle.axes[0]
        assert vertical.setpoint == vertical.position == pytest.approx(0.033, abs=1e-5)
        assert (vertical.error, vertical.output_v, vertical.command_v) == (0.0, 0.0, 5.0)

    def test_without_a_sample_the_cycle_holds_the_last_signals(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.deadline()
        good = gateway.sample().cycle
        gateway.deadline()
        held = gateway.deadline().cycle
        assert good is not None and held is not None
        assert (held.number, held.receive_ns, held.fresh) == (good.number + 1, 0, False)
        assert held.axes == good.axes

    def test_a_period_with_a_sample_gives_one_cycle(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.transcript.cycles.clear()
        gateway.periods(10)
        assert [cycle.number for cycle in gateway.transcript.cycles] == list(range(1, 11))

    def test_the_setpoints_time_begins_with_the_first_controlled_sample_and_follows_the_deadlines(
        self,
    ) -> None:
        rig = make_rig()
        gateway = SteppedGateway(rig, make_gateway(rig, setpoints="ladder:0.01,0.02,0.03@0/0.0112"))
        gateway.bring_to(LifeCycleState.ARMED)
        gateway.periods(7)
        gateway.operate(Trigger.START)
        gateway.deadline()
        gateway.lose_sample()
        setpoints = []
        for late_ns in (900_000, 0, 5_000_000):
            gateway.deadline(late_ns)
            cycle = gateway.sample().cycle
            assert cycle is not None
            setpoints.append(cycle.axes[0].setpoint)
        assert setpoints == [0.01, 0.02, 0.03]

    def test_a_step_at_1_12_s_begins_after_100_samples(self) -> None:
        rig = make_rig()
        gateway = make_running(rig, setpoints="step:0.05@1.12")
        gateway.transcript.cycles.clear()
        gateway.periods(102)
        setpoints = [cycle.axes[0].setpoint for cycle in gateway.transcript.cycles]
        assert setpoints == [0.0] * 100 + [0.05] * 2

    def test_start_does_not_move_a_valve_at_any_error(self) -> None:
        """An integrating control law starts without a bump at any position."""
        rig = make_rig()
        gateway = make_running(rig, PidLaw(kp=11.0, ki=5.0, kd=0.27, tau_d=0.0267))
        gateway.deadline()
        assert commands(gateway.sample((9.0, 2.0, 5.0))) == [CENTRED]
        gateway.deadline()
        (volts,) = commands(gateway.sample((9.0, 2.0, 5.0)))
        assert max(abs(v - 5.0) for v in volts) < 0.1

    def test_stop_centres_at_once_and_a_new_start_begins_at_time_0(self) -> None:
        rig = make_rig()
        gateway = make_running(rig, PidLaw(kp=11.0, ki=50.0), "step:0.05@0.1")
        gateway.periods(40)
        assert gateway.transcript.commands()[-1] != CENTRED
        output = gateway.operate(Trigger.STOP)
        assert commands(output) == [CENTRED]
        assert gateway.core._loops._axes[0].signals.command_v == 5.0
        gateway.transcript.frames.clear()
        gateway.periods(5)
        assert set(gateway.transcript.commands()) == {CENTRED}
        gateway.operate(Trigger.START)
        gateway.transcript.cycles.clear()
        gateway.periods(20)
        setpoints = [cycle.axes[0].setpoint for cycle in gateway.transcript.cycles]
        assert setpoints == [0.0] * 9 + [0.05] * 11
        assert gateway.transcript.cycles[0].axes[0].output_v == 0.0

    def test_start_after_the_periods_sample_waits_for_the_next(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED, adc__protected="false")
        gateway.period()
        gateway.operate(Trigger.START)
        again = sample_frame(gateway.volts, 0, protected=False)
        assert commands(gateway.receive(again)) == []
        assert len(commands(gateway.period())) == 1

    def test_the_rpdo_counter_goes_up_by_one_in_every_frame(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.periods(300)
        gateway.operate(Trigger.STOP)
        gateway.periods(5)
        gateway.receive(Frame(codec.SYNC))  # a fault
        gateway.periods(5)
        frames = [frame for frame in gateway.transcript.frames if frame.id == codec.RPDO1_DAC]
        assert [frame.data[6] for frame in frames] == [k & 0xFF for k in range(len(frames))]
        assert all(frame.data[7] == frame_crc(0x220, frame.data[:7]) for frame in frames)


class TestOtherRigs:
    @pytest.mark.parametrize(
        "axes",
        [("vertical",), ("horizontal",), ("rotation",), ("vertical", "rotation"), ("horizontal", "rotation")],
    )
    def test_channels_without_an_axis_are_centred(self, axes: tuple[str, ...]) -> None:
        bench = RigBench(make_rig(axes=axes)).run()
        bench.periods(20)
        used = [{"vertical": 0, "horizontal": 1, "rotation": 2}[axis] for axis in axes]
        for volts in bench.transcript.commands()[-10:]:
            for channel in range(3):
                assert (volts[channel] != 5.0) == (channel in used)
        assert len(bench.transcript.cycles[-1].axes) == len(axes)

    def test_axes_may_use_the_channels_in_any_order(self) -> None:
        rig = make_rig(
            {
                "axes.vertical.valve.channel": "3",
                "axes.rotation.valve.channel": "1",
                "axes.vertical.potentiometer.channel": "2",
                "axes.horizontal.potentiometer.channel": "1",
            }
        )
        steps = {"vertical": "step:0.1@0", "horizontal": "step:0@0", "rotation": "step:-0.1@0"}
        gateway = make_running(rig, setpoints=steps)
        gateway.deadline()
        # horizontal's potentiometer on channel 1 at 0.033 m
        (volts,) = commands(gateway.sample((6.0, 5.0, 5.0)))
        assert volts == pytest.approx((3.0, 5 - 20 * 0.033, 7.0), abs=2 * COUNT_V)

    @pytest.mark.parametrize(("adc", "dac"), [("true", "false"), ("false", "true"), ("false", "false")])
    def test_boards_without_counter_and_crc(self, adc: str, dac: str) -> None:
        bench = RigBench(make_rig({"adc.protected": adc, "dac.protected": dac})).run()
        bench.periods(50)
        assert bench.gateway.state is LifeCycleState.RUNNING
        assert bench.gateway.rejected_frames == 0
        lengths = {len(frame.data) for frame in bench.transcript.frames if frame.id == codec.RPDO1_DAC}
        assert lengths == {8 if dac == "true" else 6}
        assert bench.boards.dac.valve_v != CENTRED

    def test_a_protected_gateway_rejects_an_unprotected_board(self) -> None:
        gateway = make_stepped()
        gateway.deadline()
        gateway.receive(ADC_UP, DAC_UP)
        gateway.receive(sample_frame(CENTRED, 0, protected=False))
        assert gateway.state is LifeCycleState.OFFLINE

    def test_a_centre_voltage_other_than_5_v(self) -> None:
        changes = {"axes.vertical.valve.centre_v": "4.75", "axes.rotation.valve.centre_v": "5.25"}
        gateway = SteppedGateway(make_rig(changes)).bring_to(LifeCycleState.RUNNING)
        centres = pytest.approx((4.75, 5.0, 5.25), abs=COUNT_V / 2)
        assert gateway.transcript.commands()[0] == centres
        gateway.deadline()
        assert commands(gateway.sample())[0] == pytest.approx((5.75, 6.0, 6.25), abs=COUNT_V)
        assert commands(gateway.operate(Trigger.STOP))[0] == centres

    def test_a_period_other_than_the_shipped_one(self) -> None:
        bench = RigBench(
            make_rig({"loop.period_s": "0.02", "dac.watchdog_timeout_s": "0.1"}), PidLaw(kp=5.0, ki=1.0)
        ).run()
        bench.periods(100)
        assert bench.gateway.state is LifeCycleState.RUNNING
        assert bench.transcript.cycles[-1].deadline_ns - bench.transcript.cycles[-2].deadline_ns == 20_000_000


def test_the_closed_loop_reaches_its_setpoints() -> None:
    bench = RigBench(make_rig(), PidLaw(kp=11.013, ki=5.6444, kd=38.639, tau_d=74.162), "step:0.1@0.5").run()
    bench.periods(round(6 / 0.0112))
    assert bench.gateway.state is LifeCycleState.RUNNING
    for axis in bench.transcript.cycles[-1].axes:
        assert axis.position == pytest.approx(0.1, abs=0.002)
    assert bench.gateway.rejected_frames == bench.gateway.missed_periods == bench.gateway.lost_samples == 0


def test_the_shell_chooses_the_first_deadline() -> None:
    assert make_gateway(make_rig(), first_deadline_ns=77).next_deadline_ns == 77
    assert make_stepped().core.next_deadline_ns == START_NS


def test_a_sample_is_awaited_only_in_state_running_and_until_it_has_come() -> None:
    gateway = make_stepped(LifeCycleState.ARMED)
    gateway.deadline()
    assert not gateway.core.awaits_sample
    gateway.sample()
    gateway.operate(Trigger.START)
    assert not gateway.core.awaits_sample
    gateway.deadline()
    assert gateway.core.awaits_sample
    gateway.sample()
    assert not gateway.core.awaits_sample


def test_readiness_says_what_is_missing_and_why_a_sample_was_rejected() -> None:
    gateway = make_stepped()
    gateway.deadline()
    assert gateway.core.readiness == "adc silent; dac silent"
    gateway.sample((0.0, 5.0, 5.0))
    assert gateway.core.readiness.startswith("adc silent; dac silent; last sample rejected: vertical: ")


@pytest.mark.parametrize(("late_ns", "late"), [(7_050_003, "7.1"), (7_049_997, "7.0")])
def test_the_time_of_a_late_period_is_given_in_milliseconds(late_ns: int, late: str) -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.period()
    assert texts(gateway.deadline(late_ns)) == [f"loop: woke up {late} ms late: no SYNC in this period"]
    assert gateway.core.missed_periods == 1
    gateway = make_stepped()
    assert texts(gateway.deadline(2 * PERIOD_NS + late_ns))[0] == (
        f"loop: woke up {22.4 + float(late):.1f} ms late, skipped periods: 2"
    )


def test_after_a_reset_samples_may_begin_with_any_counter_and_are_judged_anew() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.period()
    last = gateway.counter - 1
    gateway.core.link_failed("test")
    gateway.operate(Trigger.RESET)
    gateway.counter = last  # the counter of the last sample again
    gateway.periods(ANSWER_TIMEOUT_PERIODS)
    assert gateway.state is LifeCycleState.READY
    assert gateway.core.rejected_frames == 0


def test_after_a_reset_a_rejected_sample_is_reported_again() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.core.link_failed("test")
    for is_reported in (True, False):
        gateway.deadline()
        assert ("guard: rejected" in " ".join(texts(gateway.sample((0.0, 5.0, 5.0))))) is is_reported
    gateway.operate(Trigger.RESET)
    gateway.deadline()
    assert "guard: rejected" in " ".join(texts(gateway.sample((0.0, 5.0, 5.0))))
