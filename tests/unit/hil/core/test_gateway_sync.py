"""Which SYNC a sample answers: slow links, lost SYNCs, and periods without SYNC."""

from __future__ import annotations

import pytest
from support.constants import CENTRED, PERIOD_NS
from support.gateway_bench import ADC_BOOT, ADC_UP, DAC_UP, PATIENT, SYNC, commands, make_stepped, texts

from hil.core.life_cycle import LifeCycleState, Trigger


def test_a_late_answer_is_rejected_and_a_timely_one_accepted() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING, **PATIENT)
    gateway.period()
    gateway.deadline()
    gateway.deadline()  # the answer to the SYNC before arrives only now
    late = gateway.sample()
    assert commands(late) == []
    assert texts(late) == [
        "guard: rejected: TPDO1_ADC: answers an earlier SYNC, 1 before the last: it is late, "
        "or the board missed a SYNC"
    ]
    assert len(commands(gateway.sample())) == 1
    assert SYNC in gateway.deadline().frames


def test_after_a_lost_sync_two_periods_pass_without_sync() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING, **PATIENT)
    gateway.period()
    gateway.deadline()  # SYNC is lost: no answer
    gateway.deadline()
    assert commands(gateway.sample()) == []
    for _ in range(2):
        output = gateway.deadline()
        assert SYNC not in output.frames
        assert texts(output) == [
            "guard: no SYNC in this period, to find out whether the last sample was late or a SYNC was lost"
        ]
    for _ in range(3):
        assert SYNC in gateway.deadline().frames
        assert len(commands(gateway.sample())) == 1


@pytest.mark.parametrize("late_periods", [1, 2, 3, 4])
@pytest.mark.parametrize("has_lost", [False, True])
@pytest.mark.parametrize("state", [LifeCycleState.RUNNING, LifeCycleState.FAULT])
def test_a_link_that_becomes_slow_moves_no_valve_and_is_a_fault(
    late_periods: int, has_lost: bool, state: LifeCycleState
) -> None:
    """Neither a large staleness limit nor a reset makes late samples acceptable."""
    gateway = make_stepped(LifeCycleState.RUNNING, adc__stale_after_periods="60")
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
        gateway.receive(ADC_UP, DAC_UP)
        while due and due[0] <= number:
            due.pop(0)
            assert [volts for volts in commands(gateway.sample()) if volts != CENTRED] == []
            assert gateway.state is not LifeCycleState.READY
        if number == 30 and is_resetting:
            gateway.transcript.add(gateway.core.link_failed("test"))
        if number == 50 and is_resetting:
            gateway.operate(Trigger.RESET)
    assert gateway.state is (LifeCycleState.OFFLINE if is_resetting else LifeCycleState.FAULT)


@pytest.mark.parametrize("late_ns", [1_000_000, PERIOD_NS - 1_000_000])
def test_a_lost_sync_costs_two_samples_and_two_periods_without_sync(late_ns: int) -> None:
    """That makes four periods without a good sample, below the shipped limit of five."""
    gateway = make_stepped(LifeCycleState.RUNNING, **PATIENT)
    for _ in range(20):
        gateway.deadline()
        gateway.receive(ADC_UP, DAC_UP)
        assert len(commands(gateway.sample(after_ns=late_ns))) == 1
        gateway.deadline()  # SYNC is lost
        gateway.deadline()
        assert commands(gateway.sample(after_ns=late_ns)) == []
        silent = 0
        while SYNC not in gateway.deadline().frames:
            silent += 1
        assert silent == 2
        assert len(commands(gateway.sample(after_ns=late_ns))) == 1


def test_a_stall_of_this_machine_is_not_taken_for_a_lost_sync() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING, adc__stale_after_periods="60")
    gateway.period()
    gateway.deadline()  # this SYNC is lost
    gateway.periods(5)
    gateway.deadline()
    gateway.deadline(late_ns=4 * PERIOD_NS)
    assert commands(gateway.sample()) == []  # the answer to the SYNC before the stall
    for stall in (6, 0):
        assert SYNC not in gateway.deadline(late_ns=stall * PERIOD_NS).frames
    assert commands(gateway.sample()) == []  # the answer to the SYNC after the stall
    assert SYNC in gateway.deadline().frames
    gateway.receive(ADC_UP, DAC_UP)
    assert len(commands(gateway.sample())) == 1
    assert gateway.state is LifeCycleState.RUNNING


def test_without_a_counter_a_lost_answer_costs_three_periods() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING, adc__protected="false", **PATIENT)
    for _ in range(5):
        gateway.period()
        assert SYNC in gateway.deadline().frames  # its answer is lost
        gateway.receive(ADC_UP, DAC_UP)
        assert [SYNC in gateway.deadline().frames for _ in range(3)] == [False, False, True]
        assert len(commands(gateway.sample())) == 1


def test_a_lost_first_sync_is_repeated_after_five_periods() -> None:
    gateway = make_stepped()
    gateway.receive(ADC_UP, DAC_UP)
    had_sync = [SYNC in gateway.deadline().frames for _ in range(11)]
    assert [number for number, had in enumerate(had_sync) if had] == [0, 5, 10]
    gateway.sample()
    assert gateway.state is LifeCycleState.READY


@pytest.mark.parametrize("late_periods", [1, 3])
@pytest.mark.parametrize("protected", ["true", "false"])
@pytest.mark.parametrize("has_restarted", [False, True])
def test_a_link_that_is_slow_from_the_beginning_is_never_ready(
    late_periods: int, protected: str, has_restarted: bool
) -> None:
    gateway = make_stepped(
        LifeCycleState.READY if has_restarted else LifeCycleState.OFFLINE, adc__protected=protected
    )
    if has_restarted:
        gateway.period()
        gateway.receive(ADC_BOOT)
    due: list[int] = []
    for number in range(200):
        if SYNC in gateway.deadline().frames:
            due.append(number + late_periods)
        gateway.receive(ADC_UP, DAC_UP)
        while due and due[0] <= number:
            due.pop(0)
            gateway.sample()
    assert gateway.state is LifeCycleState.OFFLINE
    assert gateway.core.rejected_frames > 30


def test_an_answer_in_a_period_without_sync_is_judged_by_its_age() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING, **PATIENT)
    gateway.period()
    gateway.deadline()
    gateway.deadline()
    gateway.sample()
    assert SYNC not in gateway.deadline().frames
    late = gateway.sample()
    assert commands(late) == []
    assert "ms after SYNC, limit 11.2 ms" in gateway.core.readiness


@pytest.mark.parametrize("state", [LifeCycleState.OFFLINE, LifeCycleState.READY, LifeCycleState.ARMED])
def test_the_gateway_recovers_from_a_lost_sync_in_every_state(state: LifeCycleState) -> None:
    gateway = make_stepped(state, **PATIENT)
    gateway.period()
    gateway.deadline()  # SYNC is lost
    gateway.period()
    gateway.periods(2)
    assert gateway.state is max(state, LifeCycleState.READY)
    assert gateway.period().cycle is not None


def test_the_sync_of_a_command_that_centres_never_waits() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING, **PATIENT)
    gateway.period()
    gateway.deadline()
    gateway.deadline()
    gateway.sample()
    gateway.operate(Trigger.STOP)
    assert SYNC in gateway.deadline().frames
