"""A second node that sends the ADC board's identifier. Its samples never move a valve."""

from __future__ import annotations

import pytest
from support.constants import CENTRED
from support.gateway_bench import (
    ADC_UP,
    DAC_UP,
    PATIENT,
    SYNC,
    commands,
    faults,
    make_stepped,
    sample_frame,
    texts,
)

from hil.core.life_cycle import LifeCycleState
from hil.core.sync_matching import ANSWER_TIMEOUT_PERIODS


@pytest.mark.parametrize("is_ahead", [True, False])
@pytest.mark.parametrize("state", [LifeCycleState.ARMED, LifeCycleState.RUNNING])
def test_samples_of_another_node_are_a_fault_or_are_rejected(state: LifeCycleState, is_ahead: bool) -> None:
    gateway = make_stepped(state, **PATIENT)
    gateway.period()
    other = sample_frame((9.0, 9.0, 9.0), gateway.counter + (40 if is_ahead else -40))
    output = gateway.receive(other)
    assert (gateway.state is LifeCycleState.FAULT) == is_ahead
    assert gateway.core.rejected_frames == 1
    if is_ahead:
        assert commands(output) == [CENTRED]
        assert faults(output)[0].startswith(
            "adc: TPDO1_ADC: counter 42 after 1 shows more answers than unanswered SYNCs (0): another node "
            "sends the same identifier"
        )
        return
    assert commands(output) == []
    assert "an old sample" in texts(output)[0]
    before = len(gateway.transcript.cycles)
    gateway.periods(5)
    assert [cycle.fresh for cycle in gateway.transcript.cycles[before:]] == [True] * 5


def test_a_second_board_with_the_same_node_id_and_counter_is_a_fault() -> None:
    """Two boards with one node id are started by one NMT command, and their counters are equal."""
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.deadline()
    assert len(commands(gateway.sample())) == 1
    twin = sample_frame((5.0, 5.0, 5.1), gateway.counter - 1)
    output = gateway.receive(twin)
    assert commands(output) == [CENTRED]
    assert faults(output) == [
        "adc: TPDO1_ADC: counter 1 twice, with different voltages: another node sends the same identifier; "
        "check the node ids"
    ]


def test_a_frame_that_arrives_twice_is_no_fault() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.deadline()
    gateway.sample()
    gateway.counter -= 1
    assert commands(gateway.sample()) == []
    assert gateway.state is LifeCycleState.RUNNING


@pytest.mark.parametrize("protected", ["true", "false"])
@pytest.mark.parametrize("is_first", [True, False])
@pytest.mark.parametrize("ahead", [0, -40])
def test_a_second_board_that_answers_is_a_fault_whatever_its_counter(
    protected: str, is_first: bool, ahead: int
) -> None:
    gateway = make_stepped(LifeCycleState.RUNNING, adc__protected=protected, **PATIENT)
    gateway.periods(3)
    for number in range(4):
        assert gateway.state is LifeCycleState.RUNNING, number
        gateway.deadline()
        other = sample_frame((5.0, 5.0, 5.0), gateway.counter + ahead, protected=protected == "true")
        if is_first:
            gateway.receive(other)
        gateway.sample()
        if not is_first:
            gateway.receive(other)
        if gateway.state is LifeCycleState.FAULT:
            break
    assert number == 2
    assert str(gateway.core.fault_reason).startswith(
        "adc: TPDO1_ADC: more answers than SYNCs in 3 periods: another node sends the same identifier"
    )


def test_frames_that_arrive_twice_now_and_then_are_no_fault() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    for _ in range(40):
        gateway.period()
        gateway.counter -= 1
        gateway.sample()
        gateway.period()
    assert gateway.state is LifeCycleState.RUNNING


def test_two_boards_from_the_beginning_are_never_ready_at_a_deadline() -> None:
    gateway = make_stepped()
    for _ in range(100):
        output = gateway.deadline()
        assert gateway.state is LifeCycleState.OFFLINE
        gateway.receive(ADC_UP, DAC_UP)
        if SYNC in output.frames:
            gateway.sample()
            gateway.counter -= 1
            gateway.sample()
    assert "more answers than SYNCs" in gateway.core.readiness
    gateway.periods(ANSWER_TIMEOUT_PERIODS + 7)
    assert gateway.state is LifeCycleState.READY


def test_a_sample_of_another_node_before_the_boards_own_is_a_fault() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.period()
    gateway.deadline()
    gateway.receive(sample_frame((9.0, 9.0, 9.0), gateway.counter + 1))
    assert gateway.state is LifeCycleState.FAULT


def test_with_a_second_sender_the_gateway_is_never_ready_at_a_deadline() -> None:
    gateway = make_stepped(LifeCycleState.READY)
    gateway.period()
    gateway.receive(sample_frame(CENTRED, gateway.counter + 3))
    assert gateway.state is LifeCycleState.OFFLINE
    for _ in range(50):
        gateway.deadline()
        assert gateway.state is LifeCycleState.OFFLINE
        gateway.receive(ADC_UP, DAC_UP)
        gateway.sample()
        gateway.receive(sample_frame(CENTRED, gateway.counter + 3))
