"""Late and missed deadlines: skipped, counted, reported, and never caught up."""

from __future__ import annotations

import pytest
from support.constants import PERIOD_NS
from support.gateway_bench import (
    AXES,
    SYNC,
    commands,
    faults,
    make_rig,
    make_running,
    make_stepped,
    texts,
)

from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.period_clock import PeriodClock


class TestClock:
    """The clock alone."""

    def test_before_the_first_period(self) -> None:
        clock = PeriodClock(100, 1000)
        assert (clock.number, clock.next_deadline_ns, clock.missed_periods) == (-1, 1000, 0)

    def test_a_period_that_begins_in_time(self) -> None:
        clock = PeriodClock(100, 1000)
        clock.begin_period(1007, clock.skipped_periods(1007))
        assert (clock.number, clock.deadline_ns, clock.wake_ns) == (0, 1000, 1007)
        assert (clock.next_deadline_ns, clock.missed_periods) == (1100, 0)

    @pytest.mark.parametrize(
        ("now_ns", "skipped"), [(0, 0), (999, 0), (1099, 0), (1100, 1), (1199, 1), (1200, 2)]
    )
    def test_whole_periods_are_skipped(self, now_ns: int, skipped: int) -> None:
        clock = PeriodClock(100, 1000)
        assert clock.skipped_periods(now_ns) == skipped
        clock.begin_period(now_ns, skipped)
        assert (clock.number, clock.deadline_ns) == (skipped, 1000 + 100 * skipped)
        assert (clock.next_deadline_ns, clock.missed_periods) == (1100 + 100 * skipped, skipped)

    @pytest.mark.parametrize(("late_ns", "is_very_late"), [(-10, False), (50, False), (51, True)])
    def test_more_than_half_a_period_is_very_late(self, late_ns: int, is_very_late: bool) -> None:
        clock = PeriodClock(100, 1000)
        clock.begin_period(1000 + late_ns, 0)
        assert clock.is_very_late == is_very_late


class TestLateDeadlines:
    def test_a_wake_up_late_by_less_than_a_period_does_not_move_the_next_deadline(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        due_ns = gateway.core.next_deadline_ns
        output = gateway.deadline(late_ns=PERIOD_NS - 1)
        assert output.log == ()
        assert gateway.core.next_deadline_ns == due_ns + PERIOD_NS
        assert gateway.core.missed_periods == 0

    @pytest.mark.parametrize("skipped", [1, 2])
    def test_missed_periods_are_skipped_counted_and_reported(self, skipped: int) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.period()
        due_ns = gateway.core.next_deadline_ns
        output = gateway.deadline(late_ns=skipped * PERIOD_NS)
        assert output.frames.count(SYNC) == 1
        assert texts(output) == [f"loop: woke up {skipped * 11.2:.1f} ms late, skipped periods: {skipped}"]
        assert gateway.core.next_deadline_ns == due_ns + (skipped + 1) * PERIOD_NS
        assert gateway.core.missed_periods == skipped
        cycle = gateway.sample().cycle
        assert cycle is not None
        assert (cycle.number, cycle.deadline_ns) == (2 + skipped, due_ns + skipped * PERIOD_NS)

    def test_skipped_periods_are_never_caught_up(self) -> None:
        gateway = make_stepped(LifeCycleState.READY)
        gateway.deadline(late_ns=10 * PERIOD_NS + 5)
        assert gateway.core.next_deadline_ns == gateway.now_ns - 5 + PERIOD_NS

    def test_an_early_call_misses_no_period(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        due_ns = gateway.core.next_deadline_ns
        output = gateway.deadline(late_ns=-3_000_000)
        assert output.log == ()
        assert gateway.core.next_deadline_ns == due_ns + PERIOD_NS
        assert gateway.core.missed_periods == 0

    @pytest.mark.parametrize(("skipped", "is_fault"), [(2, False), (3, True)])
    def test_a_stall_as_long_as_the_staleness_limit_is_a_fault(self, skipped: int, is_fault: bool) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.period()
        output = gateway.deadline(late_ns=skipped * PERIOD_NS)
        assert (gateway.state is LifeCycleState.FAULT) == is_fault
        assert faults(output) == is_fault * [
            "adc: no good sample for 3 periods, limit 3 (rig: adc.stale_after_periods); "
            "last cause: the loop itself missed 3 deadlines: other programs or the host took its time; hil "
            "doctor checks the machine"
        ]

    def test_skipped_periods_and_periods_without_a_sample_add_up(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.deadline()
        gateway.deadline()  # one period without a sample
        gateway.deadline(late_ns=PERIOD_NS)  # another, and one skipped
        assert gateway.state is LifeCycleState.FAULT

    def test_the_setpoint_follows_the_deadlines_over_skipped_periods(self) -> None:
        rig = make_rig()
        gateway = make_running(rig, setpoints="ladder:0.01,0.02,0.03,0.04@0/0.0112")
        gateway.period()
        gateway.deadline(late_ns=2 * PERIOD_NS)
        cycle = gateway.sample().cycle
        assert cycle is not None
        assert cycle.axes[0].setpoint == 0.04


class TestVeryLateWake:
    """After more than half a period, the next SYNC would follow too soon."""

    def test_a_wake_up_late_by_more_than_half_a_period_sends_no_sync_and_is_reported(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.period()
        output = gateway.deadline(late_ns=PERIOD_NS // 2 + 1)
        assert SYNC not in output.frames
        assert texts(output) == ["loop: woke up 5.6 ms late: no SYNC in this period"]
        assert gateway.core.missed_periods == 1
        assert SYNC in gateway.deadline().frames
        assert len(commands(gateway.sample())) == 1

    def test_a_wake_up_late_by_half_a_period_sends_sync(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.period()
        assert SYNC in gateway.deadline(late_ns=PERIOD_NS // 2).frames
        assert gateway.core.missed_periods == 0

    @pytest.mark.parametrize("trigger", [Trigger.STOP, None])
    def test_a_command_that_centres_does_not_wait_for_a_later_sync(self, trigger: Trigger | None) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.period()
        if trigger:
            gateway.operate(trigger)
        else:
            gateway.core.link_failed("test")
        assert SYNC in gateway.deadline(late_ns=PERIOD_NS - 1).frames

    def test_after_a_late_command_the_rate_limit_uses_the_elapsed_time(self) -> None:
        """At 100 V/s, a command may change by 1.12 V in a whole period, and by 0.672 V in 0.6 periods."""
        gateway = make_stepped(
            LifeCycleState.RUNNING, **{f"axes__{name}__valve__max_rate_v_s": "100.0" for name in AXES}
        )
        for axis in gateway.core._loops._axes:
            axis.law.output = lambda r, y: 4.0  # type: ignore[method-assign]
        gateway.period()
        gateway.deadline(late_ns=0)
        (late,) = commands(gateway.sample(after_ns=5_480_000))
        assert late == pytest.approx((7.24,) * 3, abs=1e-3)
        gateway.deadline()
        (after,) = commands(gateway.sample(after_ns=1_000_000))
        assert after == pytest.approx((7.24 + 0.672,) * 3, abs=1e-3)
