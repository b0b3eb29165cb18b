"""Requests of an operator to a gateway: setpoints, controllers and jogs, in every state."""

from __future__ import annotations

import json
from itertools import pairwise

import pytest
from support.constants import CENTRED, COUNT_V, PERIOD_S
from support.gateway_bench import (
    ADC_UP,
    DAC_UP,
    SYNC,
    RigBench,
    SteppedGateway,
    commands,
    make_rig,
    make_stepped,
    texts,
)

from hil.core.control_law import ControlLaw
from hil.core.controller_change import PreparedController, prepare_controller
from hil.core.controller_file import PidLaw
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Output, Severity
from hil.core.requests import ControllerRequest, JogRequest, Reply, Request, SetpointRequest
from hil.core.wire import codec

NOT_RUNNING = [state for state in LifeCycleState if state is not LifeCycleState.RUNNING]
NOT_ARMED = [state for state in LifeCycleState if state is not LifeCycleState.ARMED]


def ask(gateway: SteppedGateway | RigBench, request: Request) -> Reply:
    """Give a request; a reply is in the log too, but for the parts of a long jog."""
    output = gateway.operate(request)
    assert output.reply is not None
    if output.reply.text.startswith("jog goes on"):
        return output.reply
    assert output.reply.text in output.log[-1].text
    expected = Severity.INFO if output.reply.accepted else Severity.WARNING
    assert output.log[-1].severity is expected
    return output.reply


def document(law: dict[str, object], **changes: object) -> str:
    """Text of a controller file for an axis in m."""
    fields: dict[str, object] = {
        "format": "hil-controller",
        "version": 1,
        "name": "test",
        "description": "",
        "sample_time_s": PERIOD_S,
        "input_unit": "m",
        "output_unit": "V",
        "law": law,
        "origin": {},
    }
    return json.dumps(fields | changes)


def pid(kp: float, ki: float = 0.0, **changes: object) -> str:
    return document({"kind": "pid", "kp": kp, "ki": ki}, **changes)


def vertical(bench: RigBench) -> list[tuple[float, float, float]]:
    """Setpoint, position and command of the vertical axis in every period with a sample."""
    signals = [cycle.axes[0] for cycle in bench.transcript.cycles if cycle.fresh]
    return [(s.setpoint, s.position, s.command_v) for s in signals]


@pytest.fixture
def bench() -> RigBench:
    """A rig that is controlled, at rest."""
    running = RigBench(make_rig(), PidLaw(kp=20.0, ki=10.0), "step:0@0").run()
    running.periods(20)
    return running


class TestTriggers:
    def test_the_reply_is_what_the_log_says(self) -> None:
        gateway = make_stepped(LifeCycleState.READY)
        assert ask(gateway, Trigger.ARM) == Reply(True, "ready -> armed (arm)")
        assert ask(gateway, Trigger.START) == Reply(True, "armed -> running (start)")
        assert ask(gateway, Trigger.STOP) == Reply(True, "running -> armed (stop)")

    def test_a_refused_trigger_says_why(self) -> None:
        reply = ask(make_stepped(LifeCycleState.READY), Trigger.START)
        assert not reply.accepted
        assert reply.text.startswith("start refused in state ready")

    def test_a_refused_start_names_every_axis_that_is_in_the_way(self) -> None:
        gateway = make_stepped(LifeCycleState.READY, axes__vertical__min_y="-0.05")
        gateway.operate(Trigger.ARM)
        gateway.period([1.0, 9.95, 5.0])
        gateway.period([0.05, 5.0, 5.0])
        assert not ask(gateway, Trigger.ARM).accepted

    def test_no_other_call_has_a_reply(self) -> None:
        gateway = make_stepped()
        assert gateway.deadline().reply is None
        assert gateway.sample().reply is None


def test_a_stop_that_the_bus_refused_is_repeated_before_sync() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.periods(5)
    gateway.core.command_refused(gateway.operate(Trigger.STOP).frames[-1])
    for _ in range(2):
        late = gateway.deadline(late_ns=7_000_000)
        assert late.frames[0].id == codec.RPDO1_DAC
        assert commands(late) == [CENTRED]
        assert late.frames[1] == SYNC
        gateway.core.command_refused(late.frames[0])
        gateway.sample()
    assert gateway.deadline().frames[1] == SYNC
    assert gateway.deadline().frames[0] == SYNC


@pytest.mark.parametrize("again", [Trigger.START, JogRequest("vertical", 1.0, 0.1)])
def test_after_a_stop_that_the_bus_refused_the_rate_counts_from_the_last_command(again: Request) -> None:
    rate_v_s = 10.0
    gateway = make_stepped(LifeCycleState.RUNNING, axes__vertical__valve__max_rate_v_s=str(rate_v_s))
    gateway.periods(3)
    gateway.deadline()
    gateway.receive(ADC_UP, DAC_UP)
    gateway.sample(after_ns=9_000_000)
    before, before_ns = gateway.transcript.commands()[-1][0], gateway.now_ns
    gateway.core.command_refused(gateway.operate(Trigger.STOP).frames[-1])
    assert ask(gateway, again).accepted
    gateway.period()
    step_v = gateway.transcript.commands()[-1][0] - before
    assert gateway.now_ns - before_ns < 4_000_000
    assert 0.0 < step_v <= rate_v_s * (gateway.now_ns - before_ns) / 1e9 + COUNT_V


class TestUnknownAxes:
    @pytest.mark.parametrize(
        "request_",
        [
            SetpointRequest("vertikal", "0.1"),
            ControllerRequest("vertikal", "ppid", "{}"),
            JogRequest("vertikal", 0.1, 0.1),
        ],
    )
    def test_the_nearest_name_is_given(self, request_: Request) -> None:
        reply = ask(make_stepped(LifeCycleState.ARMED), request_)
        assert reply == Reply(
            False,
            "refused: no axis 'vertikal'; the rig has vertical, horizontal, rotation; did you mean vertical?",
        )

    def test_a_huge_name_is_not_repeated(self) -> None:
        reply = ask(make_stepped(), SetpointRequest("x" * 1_000_000, "0.1"))
        assert reply == Reply(False, "refused: the axis has a name of 1000000 characters")


class TestSetpoints:
    @pytest.mark.parametrize("text", ["0.1", "+1e-1", "step:0.1@0", ".1"])
    def test_a_running_axis_approaches_it_within_the_limits(self, bench: RigBench, text: str) -> None:
        before = len(vertical(bench))
        reply = ask(bench, SetpointRequest("vertical", text))
        assert reply == Reply(True, f"setpoint {text}, approached now with at most 0.45 m/s and 1.8 m/s^2")
        bench.periods(100)
        setpoints = [r for r, _, _ in vertical(bench)[before - 1 :]]
        steps = [after - before for before, after in pairwise(setpoints)]
        assert setpoints[0] == 0.0
        assert setpoints[-1] == 0.1
        assert max(steps) <= 0.45 * PERIOD_S + 1e-12
        assert all(abs(b - a) <= 1.8 * PERIOD_S**2 + 1e-12 for a, b in pairwise([0.0, *steps]))
        assert bench.gateway.state is LifeCycleState.RUNNING

    def test_other_axes_keep_their_setpoints(self, bench: RigBench) -> None:
        ask(bench, SetpointRequest("vertical", "0.1"))
        bench.periods(50)
        assert bench.transcript.cycles[-1].axes[1].setpoint == 0.0

    def test_a_further_request_goes_on_from_the_present_motion(self, bench: RigBench) -> None:
        ask(bench, SetpointRequest("vertical", "0.1"))
        bench.periods(12)
        ask(bench, SetpointRequest("vertical", "0.12"))
        ask(bench, SetpointRequest("vertical", "-0.1"))
        bench.periods(120)
        setpoints = [r for r, _, _ in vertical(bench)]
        steps = [after - before for before, after in pairwise(setpoints)]
        assert all(abs(b - a) <= 1.8 * PERIOD_S**2 + 1e-12 for a, b in pairwise(steps))
        assert setpoints[-1] == -0.1

    def test_the_motion_of_the_first_setpoint_goes_on(self) -> None:
        bench = RigBench(make_rig(), PidLaw(kp=20.0, ki=10.0), "ramp:0.1@0/1").run()
        bench.periods(40)
        ask(bench, SetpointRequest("vertical", "hold"))
        bench.periods(40)
        setpoints = [r for r, _, _ in vertical(bench)[-80:]]
        steps = [after - before for before, after in pairwise(setpoints)]
        assert all(abs(b - a) <= 1.8 * PERIOD_S**2 + 1e-12 for a, b in pairwise(steps[2:]))
        assert steps[-1] == 0.0
        assert 0.04 < setpoints[-1] < 0.06

    @pytest.mark.parametrize(
        ("text", "reason"),
        [
            ("0.2", "reaches 0.2 m, beyond 0.15 m (rig: axes.vertical.max_y)"),
            ("-0.151", "reaches -0.151 m, beyond -0.15 m (rig: axes.vertical.min_y)"),
            ("sine:0.1@0/1", "limit 0.45 m/s (rig: axes.vertical.operator.setpoint_max_speed)"),
            ("csv:table.csv", "the request has no table, and the daemon reads no files"),
            ("nan", "is neither a number, such as 0.05, nor one of step:SIZE@TIME"),
            ("stp", "hold; did you mean step?"),
            ("o.05", "setpoint 'o.05' is neither a number, such as 0.05, nor one of "),
            ("step:0.1", "is not written as step:SIZE@TIME"),
            ("ladder:" + "0," * 1000 + "0@0/1", "the text has 2012 characters, limit 1000"),
        ],
    )
    @pytest.mark.parametrize("state", [LifeCycleState.READY, LifeCycleState.RUNNING])
    def test_a_setpoint_that_the_axis_must_not_have_is_refused(
        self, state: LifeCycleState, text: str, reason: str
    ) -> None:
        reply = ask(make_stepped(state), SetpointRequest("vertical", text))
        assert not reply.accepted
        assert reply.text.startswith("setpoint refused: ")
        assert reason in reply.text

    def test_a_refused_setpoint_changes_nothing(self, bench: RigBench) -> None:
        ask(bench, SetpointRequest("vertical", "0.2"))
        bench.periods(5)
        assert vertical(bench)[-1][0] == 0.0

    @pytest.mark.parametrize("state", [state for state in NOT_RUNNING if state is not LifeCycleState.FAULT])
    def test_it_is_the_setpoint_of_the_next_start(self, state: LifeCycleState) -> None:
        gateway = make_stepped(state, axes__vertical__setpoint='"step:0.1@1"')
        reply = ask(gateway, SetpointRequest("vertical", "0.1"))
        assert reply.text.startswith("setpoint 0.1, approached when control starts")
        while gateway.state is LifeCycleState.OFFLINE:
            gateway.period()
        gateway.bring_to(LifeCycleState.RUNNING) if gateway.state is LifeCycleState.READY else (
            gateway.operate(Trigger.START)
        )
        gateway.volts = (5.6, 5.0, 5.0)
        gateway.periods(80)
        setpoints = [c.axes[0].setpoint for c in gateway.transcript.cycles if c.state == 3 and c.fresh]
        assert setpoints[0] == pytest.approx(0.0198, abs=1e-4)  # the position, from which it begins
        assert setpoints[-1] == 0.1

    def test_a_stop_forgets_it(self, bench: RigBench) -> None:
        ask(bench, SetpointRequest("vertical", "0.1"))
        bench.periods(50)
        bench.operate(Trigger.STOP)
        bench.operate(Trigger.START)
        bench.periods(100)
        assert vertical(bench)[-1][0] == 0.0

    @pytest.mark.parametrize("way", [(Trigger.DISARM, Trigger.ARM), (Trigger.RESET,)])
    def test_what_was_asked_for_before_a_disarm_or_reset_is_forgotten(self, way: tuple[Trigger, ...]) -> None:
        fault = Trigger.RESET in way
        gateway = make_stepped(LifeCycleState.ARMED)
        assert ask(gateway, SetpointRequest("vertical", "0.1")).accepted
        if fault:
            gateway.core.link_failed("test")
        for trigger in way:
            gateway.operate(trigger)
        while gateway.state is LifeCycleState.OFFLINE:
            gateway.period()
        if fault:
            gateway.operate(Trigger.ARM)
        output = gateway.operate(Trigger.START)
        gateway.periods(80)
        assert gateway.state is LifeCycleState.RUNNING
        assert gateway.transcript.cycles[-1].axes[0].setpoint == 0.05  # that of the gateway's start
        assert not any("approaches" in entry.text for entry in output.log)

    def test_it_is_refused_in_state_fault_because_a_reset_would_forget_it(self) -> None:
        gateway = make_stepped(LifeCycleState.FAULT)
        request = SetpointRequest("vertical", "0.1")
        reply = ask(gateway, request)
        assert not reply.accepted
        assert reply.text.startswith("setpoint refused: the state is fault (")
        assert "give it after `hil reset`" in reply.text
        refusal = gateway.core.refuse_setpoint(request)
        assert refusal is not None
        assert refusal.text == f"vertical: {reply.text}"
        assert "no axis 'elbow'" in ask(gateway, SetpointRequest("elbow", "0.1")).text

    def test_the_start_says_which_axes_will_move(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        ask(gateway, SetpointRequest("vertical", "0.1"))
        output = gateway.operate(Trigger.START)
        assert output.reply is not None
        assert "vertical approaches step:0.1@0" in output.reply.text
        assert "setpoint: vertical approaches step:0.1@0" in texts(output)

    def test_between_start_and_the_first_sample_nothing_is_approached_yet(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.deadline()
        gateway.operate(Trigger.START)
        assert ask(gateway, SetpointRequest("vertical", "0.1")).accepted
        gateway.sample()
        gateway.period()
        assert gateway.transcript.cycles[-1].axes[0].setpoint == pytest.approx(1.8 * PERIOD_S**2, abs=1e-4)


class TestControllers:
    def test_the_first_command_is_that_of_a_law_that_ran_before(self, bench: RigBench) -> None:
        ask(bench, SetpointRequest("vertical", "0.1"))
        bench.periods(20)
        r, y, command_v = vertical(bench)[-1]
        law = ControlLaw(PidLaw(kp=31.0, ki=7.0), PERIOD_S)
        law.initialise(r, y, command_v - 5.0)
        assert law.output(r, y) == pytest.approx(command_v - 5.0, abs=1e-12)
        law.advance(command_v - 5.0)
        reply = ask(bench, ControllerRequest("vertical", "new.json", pid(31.0, 7.0)))
        assert reply.accepted
        assert "new.json takes over at the last command, without a bump" in reply.text
        assert "so the closed loop was not checked" in reply.text
        for _ in range(5):
            bench.period()
            r, y, command_v = vertical(bench)[-1]
            assert command_v - 5.0 == pytest.approx(law.output(r, y), abs=1e-12)
            law.advance(command_v - 5.0)

    def test_at_rest_the_valve_does_not_move(self, bench: RigBench) -> None:
        bench.periods(200)
        before_v = vertical(bench)[-1][2]
        ask(bench, ControllerRequest("vertical", "new.json", pid(5.0, 1.0)))
        bench.periods(3)
        assert all(abs(command_v - before_v) < 0.02 for _, _, command_v in vertical(bench)[-3:])

    def test_a_law_without_state_reports_its_bump(self) -> None:
        bench = RigBench(make_rig(), PidLaw(kp=20.0, ki=20.0), "step:0.1@0").run()
        bench.periods(300)
        r, y, command_v = vertical(bench)[-1]
        bump_v = 2.0 * (r - y) - (command_v - 5.0)
        reply = ask(bench, ControllerRequest("vertical", "p.json", pid(2.0)))
        assert f"takes over with a bump of {bump_v:+.4g} V, because it has no state" in reply.text
        assert "at most 400 V/s (rig: axes.vertical.valve.max_rate_v_s)" in reply.text

    def test_a_law_without_integrator_reports_its_motion(self, bench: RigBench) -> None:
        law: dict[str, object] = {"kind": "transfer_function", "num": [0.2], "den": [1.0, -0.9]}
        ask(bench, SetpointRequest("vertical", "0.1"))
        bench.periods(15)
        reply = ask(bench, ControllerRequest("vertical", "lag.json", document(law)))
        assert "it has no integrator, so its output then moves by" in reply.text
        assert "with a time constant of 0.106 s" in reply.text

    @pytest.mark.parametrize(
        ("text", "reason"),
        [
            ("{", "new.json: not valid JSON"),
            (pid(1.0, sample_time_s=0.01), "sample_time_s: 0.01 s is not the loop's 0.0112 s"),
            (pid(1.0, input_unit="rad"), "input_unit is rad, but the axis is in m; give a controller"),
            (pid(1e13), "law.kp"),
            (pid(0.5, origin={"plant": {"num": [1.0], "den": [1.0, -1.0]}}), "has the modulus 1.005"),
            (" " * 140_000, "the controller file has 140000 characters, limit 131072"),
        ],
    )
    @pytest.mark.parametrize("state", [LifeCycleState.ARMED, LifeCycleState.RUNNING])
    def test_a_controller_that_does_not_fit_is_refused(
        self, state: LifeCycleState, text: str, reason: str
    ) -> None:
        gateway = make_stepped(state)
        law = gateway.core._loops._axes[0].law
        reply = ask(gateway, ControllerRequest("vertical", "new.json", text))
        assert not reply.accepted
        assert reply.text.startswith("controller refused: ")
        assert reason in reply.text
        assert gateway.core._loops._axes[0].law is law

    @pytest.mark.parametrize("name", ["x" * 201, "a\nb", "\x1b[31m"])
    def test_a_name_that_cannot_be_shown_is_refused(self, name: str) -> None:
        reply = ask(make_stepped(), ControllerRequest("vertical", name, pid(1.0)))
        assert reply == Reply(
            False, "controller refused: its name must have at most 200 printable characters"
        )

    def test_a_stable_loop_with_the_plant_of_the_file_is_accepted_without_a_remark(self) -> None:
        plant = {"num": [1.0], "den": [1.0, 1.0]}
        text = pid(5.0, 1.0, origin={"plant": plant})
        reply = ask(make_stepped(LifeCycleState.ARMED), ControllerRequest("vertical", "new.json", text))
        assert reply == Reply(True, "controller new.json acts from the next start on")

    def test_a_prepared_controller_gives_the_same_answer(self) -> None:
        request = ControllerRequest("vertical", "new.json", pid(31.0, 7.0))
        given: list[PreparedController | None] = [None, prepare_controller(request, make_rig())]
        sent = []
        for prepared in given:
            bench = RigBench(make_rig(), PidLaw(kp=20.0, ki=10.0), "step:0.1@0").run()
            bench.periods(20)
            output = bench.gateway.operate(request, bench.now_ns, prepared)
            bench.periods(20)
            sent.append((output, bench.transcript.frames))
        assert sent[0] == sent[1]

    def test_a_prepared_controller_of_another_text_is_not_used(self, bench: RigBench) -> None:
        request = ControllerRequest("vertical", "new.json", pid(31.0, 7.0))
        other = prepare_controller(request._replace(document=pid(1.0, input_unit="rad")), bench.rig)
        assert not other.numbers
        output = bench.gateway.operate(request, bench.now_ns, other)
        assert output.reply is not None
        assert output.reply.accepted


class TestJogs:
    JOG = JogRequest("vertical", 0.5, 0.2)

    def test_one_valve_has_its_offset_for_the_time_and_the_others_are_centred(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.period()
        assert ask(gateway, self.JOG) == Reply(True, "jog begins: +0.5 V for 0.2 s")
        assert gateway.state is LifeCycleState.RUNNING
        before = len(gateway.transcript.frames)
        gateway.periods(30)
        assert gateway.state is LifeCycleState.ARMED
        sent = [v for frame in gateway.transcript.frames[before:] for v in commands_of(frame)]
        jogged = [v for v in sent if v != CENTRED]
        assert len(jogged) == 17  # the deadlines within 0.2 s
        assert jogged == [(pytest.approx(5.5, abs=1e-3), *CENTRED[1:])] * 17
        assert "life cycle: running -> armed (jog ended: its time is over)" in gateway.transcript.texts()
        first = sent.index(jogged[0])
        assert sent[first : first + 17] == jogged

    @pytest.mark.parametrize(
        ("after_ns", "step_v"), [(1_000_000, 0.155), (6_000_000, 0.28), (11_000_000, 0.28)]
    )
    def test_the_rate_limit_counts_from_the_command_before(self, after_ns: int, step_v: float) -> None:
        gateway = make_stepped(LifeCycleState.ARMED, axes__horizontal__valve__max_rate_v_s="25.0")
        gateway.operate(JogRequest("horizontal", 0.9, 0.5))
        sent = []
        for delay_ns in (6_000_000, after_ns):
            gateway.deadline()
            gateway.receive(ADC_UP, DAC_UP)
            (command,) = commands(gateway.sample(after_ns=delay_ns))
            sent.append(command[1])
        assert sent == pytest.approx([5.28, 5.28 + step_v], abs=COUNT_V)

    def test_the_rate_limit_applies(self) -> None:
        gateway = make_stepped(
            LifeCycleState.ARMED,
            axes__vertical__valve__max_rate_v_s="10.0",
        )
        gateway.operate(self.JOG)
        gateway.periods(6)
        commanded = [v[0] for v in gateway.transcript.commands() if v != CENTRED]
        assert commanded[:4] == pytest.approx([5.112, 5.224, 5.336, 5.448], abs=1e-3)

    @pytest.mark.parametrize("state", NOT_ARMED)
    def test_it_is_refused_in_every_other_state(self, state: LifeCycleState) -> None:
        gateway = make_stepped(state)
        reply = ask(gateway, self.JOG)
        assert not reply.accepted
        assert f"jog refused: the state is {state.name.lower()} (" in reply.text
        assert gateway.state is state

    @pytest.mark.parametrize(
        ("offset_v", "duration_s", "reason"),
        [
            (1.01, 0.2, "the jog's offset is 1.01 V, limit 1 V (rig: axes.vertical.operator.jog_max_v)"),
            (-1.01, 0.2, "the jog's offset is -1.01 V, limit 1 V"),
            (float("nan"), 0.2, "the jog's offset is nan V"),
            (
                0.5,
                0.51,
                "the jog's time is 0.51 s, but must be over 0 s and at most 0.5 s (rig: axes.vertical.",
            ),
            (0.5, 0.0, "the jog's time is 0 s"),
            (0.5, float("inf"), "the jog's time is inf s"),
            (0.5, float("nan"), "the jog's time is nan s"),
        ],
    )
    def test_it_is_refused_beyond_the_limits(self, offset_v: float, duration_s: float, reason: str) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        reply = ask(gateway, JogRequest("vertical", offset_v, duration_s))
        assert not reply.accepted
        assert reason in reply.text
        assert gateway.state is LifeCycleState.ARMED

    def test_a_further_request_extends_it_and_changes_the_voltage(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.operate(self.JOG)
        gateway.periods(10)
        assert ask(gateway, self.JOG._replace(offset_v=-0.5)) == Reply(True, "jog goes on: -0.5 V for 0.2 s")
        gateway.periods(15)
        assert gateway.state is LifeCycleState.RUNNING
        assert gateway.transcript.commands()[-1][0] == pytest.approx(4.5, abs=1e-3)
        gateway.periods(5)
        assert gateway.state is LifeCycleState.ARMED

    def test_after_a_stop_it_does_not_begin_again_until_the_requests_have_paused(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.operate(self.JOG)
        gateway.periods(2)
        gateway.operate(Trigger.STOP)
        for _ in range(60):  # whoever jogs goes on to ask every second period
            reply = ask(gateway, self.JOG)
            assert reply == Reply(
                False, "jog refused: the jog was stopped; let go, and jog again after 0.5 s"
            )
            gateway.periods(2)
            assert gateway.state is LifeCycleState.ARMED
        gateway.periods(46)
        assert ask(gateway, self.JOG).accepted

    def test_a_jog_that_the_fence_ends_does_not_creep_on(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.period()
        gateway.operate(self.JOG)
        gateway.period([8.0, 5.0, 5.0])
        gateway.period([8.65, 5.0, 5.0])
        assert gateway.state is LifeCycleState.ARMED
        assert not ask(gateway, self.JOG).accepted
        gateway.period([8.0, 5.0, 5.0])
        assert gateway.state is LifeCycleState.ARMED

    def test_the_parts_of_a_long_jog_are_not_logged_one_by_one(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.operate(self.JOG)
        assert gateway.operate(self.JOG).log == ()

    def test_only_one_axis_is_jogged_at_a_time(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.operate(self.JOG)
        reply = ask(gateway, self.JOG._replace(axis="rotation"))
        assert reply == Reply(False, "jog refused: vertical is being jogged; one axis at a time")

    def test_it_ends_without_samples_too(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.operate(self.JOG._replace(duration_s=0.015))
        gateway.period()
        output = [gateway.deadline() for _ in range(2)][-1]
        assert gateway.state is LifeCycleState.ARMED
        assert commands(output) == [CENTRED]

    def test_it_ends_at_the_travel_fence(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.period()
        gateway.operate(self.JOG)
        gateway.period([8.0, 5.0, 5.0])
        assert gateway.state is LifeCycleState.RUNNING
        output = gateway.period([8.65, 5.0, 5.0])
        assert gateway.state is LifeCycleState.ARMED
        assert commands(output) == [CENTRED]
        assert texts(output)[0].startswith(
            "life cycle: running -> armed (jog ended: position 0.1204 m is beyond the travel fence, "
            "-0.12 to 0.12 m (rig: axes.vertical.fence_min_y, fence_max_y))"
        )

    @pytest.mark.parametrize(("begin_v", "inward_v", "outward_v"), [(9.0, 8.9, 9.05), (1.0, 1.1, 0.95)])
    def test_an_axis_beyond_the_fence_may_only_move_back(
        self, begin_v: float, inward_v: float, outward_v: float
    ) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.volts = (begin_v, 5.0, 5.0)
        gateway.period()
        gateway.operate(self.JOG)
        gateway.period()
        gateway.period([inward_v, 5.0, 5.0])
        assert gateway.state is LifeCycleState.RUNNING
        gateway.period([outward_v, 5.0, 5.0])
        assert gateway.state is LifeCycleState.ARMED

    def test_the_envelope_of_the_jogged_axis_applies(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.period()
        gateway.operate(self.JOG)
        for volts in (5.0, 5.1, 5.2, 5.3, 8.0):
            gateway.period([volts, 5.0, 5.0])
        assert gateway.state is LifeCycleState.FAULT
        assert "limit 1.8 m/s" in (gateway.core.fault_reason or "")

    def test_an_axis_beyond_its_soft_end_stop_is_not_jogged(self) -> None:
        rig = make_rig(envelope="max_y = 0.155\nmax_error = 0.15", axes=("vertical",))
        gateway = SteppedGateway(rig).bring_to(LifeCycleState.ARMED)
        gateway.period([9.8, 5.0, 5.0])
        reply = ask(gateway, self.JOG)
        assert "jog refused: position 0.1584 m is above the upper soft end stop 0.155 m" in reply.text

    def test_other_axes_may_move(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.period()
        gateway.operate(self.JOG)
        for volts in (5.0, 5.1, 5.2, 5.3, 8.0):
            gateway.period([5.0, volts, 5.0])
        assert gateway.state is LifeCycleState.RUNNING

    def test_other_valves_are_centred_although_the_bus_refused_the_stop(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.periods(5)
        assert CENTRED not in gateway.transcript.commands()[-2:]
        gateway.core.command_refused(gateway.operate(Trigger.STOP).frames[-1])
        assert ask(gateway, self.JOG).accepted
        before = len(gateway.transcript.commands())
        gateway.periods(3)
        jogged = (pytest.approx(5.5, abs=1e-3), *CENTRED[1:])
        assert gateway.transcript.commands()[before:] == [jogged] * 3

    def test_its_end_centres_the_valve_before_sync_so_that_no_later_sync_is_needed(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.operate(JogRequest("vertical", 0.5, 0.05))
        gateway.periods(4)
        ended = gateway.deadline()
        assert gateway.state is LifeCycleState.ARMED
        assert commands(ended) == [CENTRED]
        assert ended.frames[0].id == codec.RPDO1_DAC
        assert ended.frames[1] == SYNC
        assert SYNC not in gateway.deadline(late_ns=7_000_000).frames

    def test_a_stop_ends_it(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.operate(self.JOG)
        gateway.periods(3)
        assert commands(gateway.operate(Trigger.STOP)) == [CENTRED]
        gateway.periods(3)
        assert gateway.transcript.commands()[-1] == CENTRED

    def test_control_after_a_jog_is_as_without_it(self) -> None:
        sent = []
        for has_jog in (False, True):
            gateway = make_stepped(LifeCycleState.ARMED)
            if has_jog:
                gateway.operate(self.JOG)
            gateway.periods(30)
            gateway.operate(Trigger.START)
            before = len(gateway.transcript.frames)
            gateway.periods(30)
            sent.append([v for frame in gateway.transcript.frames[before:] for v in commands_of(frame)])
        assert sent[0] == sent[1]

    def test_a_fault_ends_it_for_good(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.operate(self.JOG)
        gateway.periods(2)
        gateway.transcript.add(gateway.core.link_failed("test"))
        gateway.operate(Trigger.RESET)
        gateway.bring_to(LifeCycleState.ARMED)
        gateway.operate(Trigger.START)
        gateway.periods(30)
        assert gateway.state is LifeCycleState.RUNNING

    def test_setpoints_that_change_during_a_jog_wait_for_the_start(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED)
        gateway.operate(self.JOG)
        gateway.period()
        assert "when control starts" in ask(gateway, SetpointRequest("vertical", "0.1")).text
        assert "next start" in ask(gateway, ControllerRequest("vertical", "a.json", pid(1.0, 1.0))).text
        gateway.period()
        assert gateway.state is LifeCycleState.RUNNING


def commands_of(frame: Frame) -> list[tuple[float, float, float]]:
    """Voltages of a frame, if it is a command."""
    return commands(Output((frame,))) if frame.id == codec.RPDO1_DAC else []
