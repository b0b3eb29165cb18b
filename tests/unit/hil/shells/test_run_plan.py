"""What an unattended run asks for and when, to the period; driven on a real core."""

from __future__ import annotations

import pytest
from support.gateway_bench import Bench, HandGateway, commands, hand, make_rig

from firmware_sim.boards.faults import AdcFaults
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Output
from hil.core.wire import codec
from hil.shells.run_plan import CENTRING_PERIODS, Ending, RunPlan, StopRequest

PERIOD_S = 0.0112
CENTRED = (5.0, 5.0, 5.0)


class PlannedRun:
    """A bench and a plan, stepped as the shells do: a period begins, then the plan acts."""

    def __init__(self, duration_s: float, bring_up_s: float = 5.0) -> None:
        self.bench = Bench(make_rig())
        self.plan = RunPlan(duration_s, PERIOD_S, bring_up_s)
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
        """Until the run is over, or first ends in ``ending``."""
        for _ in range(2000):
            if self.plan.is_over or (ending is not None and self.plan.ending is ending):
                return
            self.period()
        raise AssertionError("the plan does not end")

    def periods(self, number: int) -> None:
        for _ in range(number):
            self.period()


def stepped(plan: RunPlan, gateway: HandGateway) -> Trigger | None:
    """One period of a gateway whose boards a test plays."""
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

    def test_it_arms_when_ready_and_starts_when_armed(self) -> None:
        plan, gateway = RunPlan(1.0, PERIOD_S), hand()
        assert stepped(plan, gateway) is None
        gateway.lose_sample()
        gateway.to(LifeCycleState.READY)
        assert stepped(plan, gateway) is Trigger.ARM
        assert stepped(plan, gateway) is Trigger.ARM  # as long as it is not
        gateway.operate(Trigger.ARM)
        assert stepped(plan, gateway) is Trigger.START

    @pytest.mark.parametrize(("duration_s", "samples"), [(0.0112, 2), (0.56, 51), (1.0, 90), (1e-6, 2)])
    def test_it_controls_from_0_to_the_duration(self, duration_s: float, samples: int) -> None:
        """Both ends count: setpoints at t = 0, 11.2 ms, ... up to the duration."""
        run = PlannedRun(duration_s)
        run.until()
        assert sum(cycle.state == LifeCycleState.RUNNING for cycle in run.bench.told.cycles) == samples

    def test_a_board_that_is_lost_before_the_start_is_waited_for(self) -> None:
        plan, gateway = RunPlan(1.0, PERIOD_S), hand(LifeCycleState.READY)
        gateway.give(Frame(codec.HEARTBEAT_DAC, b"\x00"))
        assert stepped(plan, gateway) is None
        gateway.lose_sample()
        gateway.to(LifeCycleState.READY)
        assert stepped(plan, gateway) is Trigger.ARM


class TestEnding:
    def test_the_valves_are_centred_and_sent_so_before_it_is_over(self) -> None:
        run = PlannedRun(duration_s=0.2)
        run.until(Ending.COMPLETED)
        run.bench.told.frames.clear()
        run.until()
        assert set(run.bench.told.commands()) == {CENTRED}
        assert len(run.bench.told.commands()) == CENTRING_PERIODS
        assert run.bench.boards.dac.valve_v == CENTRED

    @pytest.mark.parametrize("apply", ["at sync", "at once"])
    def test_the_board_has_applied_it_in_either_mode(self, apply: str) -> None:
        run = PlannedRun(duration_s=0.2)
        run.bench = Bench(make_rig({"dac.apply": f'"{apply}"'}))
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

    def test_a_fault_ends_it_without_a_trigger(self) -> None:
        run = PlannedRun(duration_s=10.0)
        run.periods(40)
        run.bench.boards.adc.faults = AdcFaults(hung=True)
        run.until()
        assert run.plan.ending is Ending.FAULT
        assert run.bench.gateway.state is LifeCycleState.FAULT
        assert [trigger for _, trigger in run.triggers] == [Trigger.ARM, Trigger.START]

    def test_a_fault_while_ending_keeps_the_first_reason(self) -> None:
        run = PlannedRun(duration_s=0.2)
        run.until(Ending.COMPLETED)
        run.bench.gateway.link_failed("x")
        run.until()
        assert run.plan.ending is Ending.COMPLETED

    @pytest.mark.parametrize(("bring_up_s", "periods"), [(5.0, 446), (0.1, 9), (0.0, 1)])
    def test_boards_that_do_not_come_up_end_it_in_time(self, bring_up_s: float, periods: int) -> None:
        plan, gateway = RunPlan(10.0, PERIOD_S, bring_up_s), hand()
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
        plan, gateway = RunPlan(10.0, PERIOD_S, 0.1), hand()
        for _ in range(8):
            stepped(plan, gateway)
        gateway.to(LifeCycleState.READY)
        assert stepped(plan, gateway) is Trigger.ARM

    @pytest.mark.parametrize("second", list(Ending))
    def test_the_first_reason_stays(self, second: Ending) -> None:
        plan = RunPlan(1.0, PERIOD_S)
        plan.end(Ending.LINK)
        plan.end(second)
        assert plan.ending is Ending.LINK

    def test_a_second_reason_does_not_lengthen_it(self) -> None:
        plan, gateway = RunPlan(1.0, PERIOD_S), hand()
        plan.end(Ending.INTERRUPTED)
        for _ in range(CENTRING_PERIODS):
            plan.end(Ending.LINK)
            stepped(plan, gateway)
        assert plan.is_over


def test_by_itself_it_waits_5_s_for_the_boards() -> None:
    plan, gateway = RunPlan(10.0, PERIOD_S), hand()
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


def test_stop_answers_with_the_centre() -> None:
    output: Output = hand(LifeCycleState.RUNNING).operate(Trigger.STOP)
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
    plan.after_period(hand().core)
    assert plan.is_over
