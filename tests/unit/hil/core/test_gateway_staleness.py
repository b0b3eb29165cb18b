"""Periods without a good sample: the limit, the fault, and the valves."""

from __future__ import annotations

import pytest
from support.constants import CENTRED
from support.gateway_bench import (
    ADC_UP,
    DAC_UP,
    GATEWAY_HEARTBEAT,
    SYNC,
    TIMEOUT_PERIODS,
    RigBench,
    commands,
    faults,
    make_rig,
    make_stepped,
    texts,
)

from firmware_sim.boards.faults import AdcFaults
from hil.core.life_cycle import LifeCycleState
from hil.core.output import Severity
from hil.core.sync_matching import ANSWER_TIMEOUT_PERIODS


@pytest.mark.parametrize("limit", [1, 2, 3, 7])
@pytest.mark.parametrize("state", [LifeCycleState.ARMED, LifeCycleState.RUNNING])
def test_the_staleness_limit_is_exact_to_the_period(limit: int, state: LifeCycleState) -> None:
    gateway = make_stepped(state, adc__stale_after_periods=str(limit))
    gateway.period()
    for _ in range(limit):
        gateway.deadline()
        assert gateway.state is state
    output = gateway.deadline()
    assert gateway.state is LifeCycleState.FAULT
    assert faults(output) == [
        f"adc: no good sample for {limit} periods, limit {limit} (rig: adc.stale_after_periods); "
        "last cause: no TPDO1_ADC arrived: check the board and its cable, or the bus is overloaded: hil "
        "monitor shows its load"
    ]
    assert gateway.core.fault_reason == faults(output)[0]


def test_a_good_sample_resets_the_count_of_stale_periods() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    for _ in range(20):
        gateway.deadline()
        gateway.receive(ADC_UP, DAC_UP)
        gateway.lose_sample()
        gateway.deadline()
        gateway.lose_sample()
        gateway.deadline()
        gateway.sample()
    assert gateway.state is LifeCycleState.RUNNING


def test_stale_samples_in_ready_lead_to_offline() -> None:
    gateway = make_stepped(LifeCycleState.READY)
    gateway.deadline()
    gateway.deadline()
    gateway.deadline()
    output = gateway.deadline()
    assert gateway.state is LifeCycleState.OFFLINE
    assert [entry.severity for entry in output.log] == [Severity.WARNING, Severity.INFO]
    assert texts(output)[1] == "life cycle: ready -> offline (boards lost)"
    gateway.periods(ANSWER_TIMEOUT_PERIODS + 2)  # the board has missed four SYNCs
    assert gateway.state is LifeCycleState.READY


def test_no_command_leaves_before_the_staleness_limit() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.period()
    for _ in range(3):
        output = gateway.deadline()
        assert [frame for frame in output.frames if frame != GATEWAY_HEARTBEAT] == [SYNC]


def test_the_command_of_a_fault_leaves_before_sync() -> None:
    """A board that applies commands at SYNC centres in this very period."""
    gateway = make_stepped(LifeCycleState.RUNNING)
    for _ in range(3):
        gateway.deadline()
    output = gateway.deadline()
    assert [frame.id for frame in output.frames if frame != GATEWAY_HEARTBEAT] == [0x220, 0x080, 0x220]
    assert commands(output) == [CENTRED, CENTRED]


def test_a_hung_adc_board_leads_to_centred_valves_at_the_limit() -> None:
    bench = RigBench(make_rig(), setpoints="step:0.1@0").run()
    bench.periods(5)
    assert max(bench.boards.dac.valve_v) > 6.0
    bench.boards.adc.faults = AdcFaults(hung=True)
    for _ in range(3):
        bench.period()
        assert max(bench.boards.dac.valve_v) > 5.5
    bench.period()
    assert bench.gateway.state is LifeCycleState.FAULT
    assert bench.boards.dac.valve_v == CENTRED


def test_the_cycles_after_a_fault_hold_the_centre_voltage() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.period()
    for _ in range(6):
        gateway.deadline()
    states = [LifeCycleState(cycle.state) for cycle in gateway.transcript.cycles[-5:]]
    command_v = [cycle.axes[0].command_v for cycle in gateway.transcript.cycles[-5:]]
    assert states == [LifeCycleState.RUNNING] * 3 + [LifeCycleState.FAULT] * 2
    assert command_v == pytest.approx([6.0, 6.0, 6.0, 5.0, 5.0])


def test_silence_in_state_fault_is_not_reported() -> None:
    gateway = make_stepped(LifeCycleState.READY)
    gateway.core.link_failed("x")
    entries = [entry for _ in range(TIMEOUT_PERIODS + 10) for entry in gateway.deadline().log]
    assert entries == []


def test_stale_periods_are_not_counted_while_offline() -> None:
    gateway = make_stepped()
    for _ in range(50):
        assert gateway.deadline().log == ()
    assert gateway.state is LifeCycleState.OFFLINE
