"""The triggers of a run without an operator, to the period, on a real gateway core."""

from __future__ import annotations

import pytest
from support.constants import CENTRED, PERIOD_S
from support.gateway_bench import RigBench, SteppedGateway, commands, make_rig, make_stepped

from firmware_sim.boards.faults import AdcFaults
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Output
from hil.core.requests import ArmRequest, CheckFailure, JogRequest
from hil.core.wire import codec
from hil.shells.run_plan import CENTRING_PERIODS, Ending, OperatorPlan, Plan, RunPlan, StopRequest


class PlannedRun:
    """A bench and a plan, stepped as the shells do it: a period begins, then the plan gives its trigger."""

    def __init__(self, duration_s: float, bring_up_s: float = 5.0) -> None:
        self.bench = RigBench(make_rig())
        self.plan: Plan = RunPlan(duration_s, PERIOD_S, bring_up_s)
        self.triggers: list[tuple[int, Trigger]] = []
        self.number = 0

    def period(self) -> None:
        self.bench.period()
        trigger = self.plan.after_period(self.bench.gateway)
        if trigger is not None:
            self.triggers.append((self.number, trigger))
            self.bench.operate(trigger)
        self.number += 1

    def until(self, ending: Ending | None = None) -> None:
        """Step until the run is over, or until it ends for the reason ``ending``."""
        for _ in range(2000):
            if self.plan.is_over or (ending is not None and self.plan.ending is ending):
                return
            self.period()
        raise AssertionError("the plan does not end")

    def periods(self, number: int) -> None:
        for _ in range(number):
            self.period()


def stepped(plan: RunPlan, gateway: SteppedGateway) -> Trigger | ArmRequest | None:
    """One period of a gateway without boards; the plan's trigger."""
    gateway.deadline()
    return plan.after_period(gateway.core)


class TestOrder:
    def test_arm_then_start_then_stop(self) -> None:
        run = PlannedRun(duration_s=0.56)
        run.until()
        triggers = [trigger for _, trigger in run.triggers]
        assert triggers == [Trigger.ARM, Trigger.START, Trigger.STOP]
        assert run.plan.ending is Ending.COMPLETED
        assert run.bench.gateway.state is LifeCycleState.ARMED

    def test_it_arms_in_ready_and_starts_in_armed(self) -> None:
        plan, gateway = RunPlan(1.0, PERIOD_S), make_stepped()
        assert stepped(plan, gateway) is None
        gateway.lose_sample()
        gateway.bring_to(LifeCycleState.READY)
        assert stepped(plan, gateway) is Trigger.ARM
        gateway.operate(Trigger.ARM)
        assert stepped(plan, gateway) is Trigger.START

    def test_a_refused_request_to_arm_ends_the_run(self) -> None:
        plan, gateway = RunPlan(1.0, PERIOD_S), make_stepped(LifeCycleState.READY)
        failure = CheckFailure("SCHED_FIFO", "refused")
        plan.take_failures((failure,))
        assert stepped(plan, gateway) == ArmRequest((failure,))
        gateway.operate(ArmRequest((failure,)))
        assert stepped(plan, gateway) is None
        assert plan.ending is Ending.START_REFUSED

    def test_overrides_go_with_the_request_to_arm(self) -> None:
        plan = RunPlan(1.0, PERIOD_S, overrides=["SCHED_FIFO"])
        gateway = make_stepped(LifeCycleState.READY)
        failure = CheckFailure("SCHED_FIFO", "refused")
        plan.take_failures((failure,))
        assert stepped(plan, gateway) == ArmRequest((failure,), ("SCHED_FIFO",))
        gateway.operate(ArmRequest((failure,), ("SCHED_FIFO",)))
        assert stepped(plan, gateway) is Trigger.START

    @pytest.mark.parametrize(("duration_s", "samples"), [(0.0112, 2), (0.56, 51), (1.0, 90), (1e-6, 2)])
    def test_control_lasts_from_time_0_to_the_duration(self, duration_s: float, samples: int) -> None:
        """Both ends are included: setpoints at t = 0, 11.2 ms, and so on up to the duration."""
        run = PlannedRun(duration_s)
        run.until()
        assert sum(cycle.state == LifeCycleState.RUNNING for cycle in run.bench.transcript.cycles) == samples

    def test_it_waits_for_a_board_that_is_lost_before_the_start(self) -> None:
        plan, gateway = RunPlan(1.0, PERIOD_S), make_stepped(LifeCycleState.READY)
        gateway.receive(Frame(codec.HEARTBEAT_DAC, b"\x00"))
        assert stepped(plan, gateway) is None
        gateway.lose_sample()
        gateway.bring_to(LifeCycleState.READY)
        assert stepped(plan, gateway) is Trigger.ARM


class TestEnding:
    def test_centring_commands_are_sent_before_the_run_is_over(self) -> None:
        run = PlannedRun(duration_s=0.2)
        run.until(Ending.COMPLETED)
        run.bench.transcript.frames.clear()
        run.until()
        assert set(run.bench.transcript.commands()) == {CENTRED}
        assert len(run.bench.transcript.commands()) == CENTRING_PERIODS
        assert run.bench.boards.dac.valve_v == CENTRED

    @pytest.mark.parametrize("apply", ["at sync", "at once"])
    def test_the_board_has_applied_the_centring_command_in_either_mode(self, apply: str) -> None:
        run = PlannedRun(duration_s=0.2)
        run.bench = RigBench(make_rig({"dac.apply": f'"{apply}"'}))
        run.periods(20)
        assert run.bench.boards.dac.valve_v != CENTRED
        run.until()
        assert run.bench.boards.dac.valve_v == CENTRED

    def test_an_interrupt_while_running_stops_in_the_next_period(self) -> None:
        run = PlannedRun(duration_s=10.0)
        run.periods(40)
        assert run.bench.gateway.state is LifeCycleState.RUNNING
        run.plan.end(Ending.INTERRUPTED)
        assert not run.plan.is_over
        run.period()
        assert run.triggers[-1] == (40, Trigger.STOP)
        run.until()
        assert run.number == 40 + CENTRING_PERIODS
        assert run.plan.ending is Ending.INTERRUPTED
        assert run.bench.boards.dac.valve_v == CENTRED

    def test_an_interrupt_during_bring_up_neither_arms_nor_starts(self) -> None:
        run = PlannedRun(duration_s=10.0)
        run.plan.end(Ending.INTERRUPTED)
        run.until()
        assert run.triggers == []
        assert run.number == CENTRING_PERIODS

    def test_a_refused_start_ends_the_run(self) -> None:
        run = PlannedRun(duration_s=10.0)
        run.bench = RigBench(make_rig(envelope="max_error = 0.01"), setpoints="step:0.05@0")
        run.until()
        assert run.plan.ending is Ending.START_REFUSED
        assert [trigger for _, trigger in run.triggers] == [Trigger.ARM, Trigger.START]
        assert set(run.bench.transcript.commands()) == {CENTRED}

    def test_a_gateway_that_stops_by_itself_ends_the_run(self) -> None:
        """The enable switch was released: the gateway leaves running without a trigger of the plan."""
        run = PlannedRun(duration_s=10.0)
        run.periods(40)
        run.bench.operate(Trigger.STOP)
        run.until()
        assert run.plan.ending is Ending.RELEASED
        assert run.bench.boards.dac.valve_v == CENTRED

    def test_a_fault_ends_the_run_without_a_trigger(self) -> None:
        run = PlannedRun(duration_s=10.0)
        run.periods(40)
        run.bench.boards.adc.faults = AdcFaults(hung=True)
        run.until()
        assert run.plan.ending is Ending.FAULT
        assert run.bench.gateway.state is LifeCycleState.FAULT
        assert [trigger for _, trigger in run.triggers] == [Trigger.ARM, Trigger.START]

    def test_a_fault_while_the_run_ends_does_not_replace_the_reason(self) -> None:
        run = PlannedRun(duration_s=0.2)
        run.until(Ending.COMPLETED)
        run.bench.gateway.link_failed("x")
        run.until()
        assert run.plan.ending is Ending.COMPLETED

    @pytest.mark.parametrize(("bring_up_s", "periods"), [(5.0, 446), (0.1, 9), (0.0, 1)])
    def test_boards_that_do_not_come_up_end_the_run_at_the_timeout(
        self, bring_up_s: float, periods: int
    ) -> None:
        plan, gateway = RunPlan(10.0, PERIOD_S, bring_up_s), make_stepped()
        for _ in range(periods):
            assert stepped(plan, gateway) is None
            assert plan.ending is None
        stepped(plan, gateway)
        assert plan.ending is Ending.NO_BOARDS
        for _ in range(CENTRING_PERIODS):
            assert not plan.is_over
            stepped(plan, gateway)
        assert plan.is_over

    def test_boards_that_come_up_in_the_last_period_are_used(self) -> None:
        plan, gateway = RunPlan(10.0, PERIOD_S, 0.1), make_stepped()
        for _ in range(8):
            stepped(plan, gateway)
        gateway.bring_to(LifeCycleState.READY)
        assert stepped(plan, gateway) is Trigger.ARM

    @pytest.mark.parametrize("second", list(Ending))
    def test_the_first_reason_stays(self, second: Ending) -> None:
        plan = RunPlan(1.0, PERIOD_S)
        plan.end(Ending.LINK)
        plan.end(second)
        assert plan.ending is Ending.LINK

    def test_a_second_reason_does_not_delay_the_end(self) -> None:
        plan, gateway = RunPlan(1.0, PERIOD_S), make_stepped()
        plan.end(Ending.INTERRUPTED)
        for _ in range(CENTRING_PERIODS):
            plan.end(Ending.LINK)
            stepped(plan, gateway)
        assert plan.is_over


def test_the_default_timeout_of_the_boards_is_5_s() -> None:
    plan, gateway = RunPlan(10.0, PERIOD_S), make_stepped()
    for _ in range(446):
        stepped(plan, gateway)
    assert plan.ending is None
    stepped(plan, gateway)
    assert plan.ending is Ending.NO_BOARDS


def test_a_stop_request_is_set_by_a_signal_and_stays() -> None:
    stop = StopRequest()
    assert not stop.is_set
    for _ in range(2):
        stop.set(15, None)
        assert stop.is_set


def test_a_run_that_is_not_over_has_no_ending() -> None:
    plan = RunPlan(1.0, PERIOD_S)
    assert plan.ending is None
    assert not plan.is_over


def test_a_stop_centres_the_valves_at_once() -> None:
    output: Output = make_stepped(LifeCycleState.RUNNING).operate(Trigger.STOP)
    assert commands(output) == [CENTRED]


@pytest.mark.parametrize(
    "before", [None, Ending.COMPLETED, Ending.INTERRUPTED, Ending.FAULT, Ending.NO_BOARDS]
)
def test_a_failure_ends_a_run_at_once_and_a_fault_before_it_stays_the_reason(before: Ending | None) -> None:
    plan = RunPlan(1.0, PERIOD_S)
    if before is not None:
        plan.end(before)
        assert not plan.is_over
    plan.fail(Ending.LINK)
    assert plan.is_over
    assert plan.ending is (Ending.FAULT if before is Ending.FAULT else Ending.LINK)
    plan.after_period(make_stepped().core)
    assert plan.is_over


class TestOperatorPlan:
    """The plan of a daemon."""

    def test_it_never_gives_a_trigger_before_the_end(self) -> None:
        run = PlannedRun(1.0)
        run.plan = OperatorPlan()
        run.periods(50)
        assert run.bench.gateway.state is LifeCycleState.READY
        run.bench.operate(Trigger.ARM)
        run.bench.operate(Trigger.START)
        run.periods(50)
        run.bench.operate(Trigger.STOP)
        run.bench.operate(Trigger.DISARM)
        run.periods(10)
        assert run.triggers == []
        assert run.plan.ending is None

    def test_a_fault_stays_until_the_reset_and_does_not_end_the_run(self) -> None:
        run = PlannedRun(1.0)
        run.plan = OperatorPlan()
        run.periods(20)
        run.bench.transcript.add(run.bench.gateway.link_failed("test"))
        run.periods(500)
        assert run.bench.gateway.state is LifeCycleState.FAULT
        assert not run.plan.is_over
        run.bench.operate(Trigger.RESET)
        run.periods(20)
        assert run.bench.gateway.state is LifeCycleState.READY

    def test_a_stop_request_stops_the_axes_centres_the_valves_and_ends(self) -> None:
        run = PlannedRun(1.0)
        run.plan = OperatorPlan()
        run.periods(20)
        run.bench.operate(Trigger.ARM)
        run.bench.operate(Trigger.START)
        run.periods(20)
        run.plan.end(Ending.INTERRUPTED)
        run.bench.transcript.frames.clear()
        run.until()
        assert [trigger for _, trigger in run.triggers] == [Trigger.STOP]
        assert len(run.bench.transcript.commands()) >= CENTRING_PERIODS
        assert run.bench.transcript.commands()[-CENTRING_PERIODS:] == [CENTRED] * CENTRING_PERIODS
        assert run.bench.boards.dac.valve_v == CENTRED

    @pytest.mark.parametrize("has_fault", [False, True])
    def test_a_stop_request_in_another_state_only_centres(self, has_fault: bool) -> None:
        run = PlannedRun(1.0)
        run.plan = OperatorPlan()
        run.periods(20)
        if has_fault:
            run.bench.transcript.add(run.bench.gateway.link_failed("test"))
        run.plan.end(Ending.INTERRUPTED)
        before = run.number
        run.until()
        assert run.number - before == CENTRING_PERIODS
        assert run.triggers == []

    def test_a_jog_is_ended_too(self) -> None:
        run = PlannedRun(1.0)
        run.plan = OperatorPlan()
        run.periods(20)
        run.bench.operate(Trigger.ARM)
        run.bench.operate(JogRequest("vertical", 0.5, 0.5))
        run.periods(2)
        run.plan.end(Ending.INTERRUPTED)
        run.until()
        assert run.bench.gateway.state is LifeCycleState.ARMED
        assert run.bench.boards.dac.valve_v == CENTRED

    def test_a_link_that_fails_ends_it_at_once(self) -> None:
        plan = OperatorPlan()
        plan.fail(Ending.LINK)
        assert plan.is_over
        assert plan.ending is Ending.LINK
