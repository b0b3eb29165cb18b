"""Error frames of the bus, and the failure of the link."""

from __future__ import annotations

import pytest
from support.constants import CENTRED
from support.gateway_bench import LIVE_STATES, commands, error_frame, faults, make_stepped, texts

from hil.core.life_cycle import LifeCycleState
from hil.core.output import LogEntry, Output, Severity


@pytest.mark.parametrize("state", LIVE_STATES)
def test_bus_off_is_a_fault(state: LifeCycleState) -> None:
    gateway = make_stepped(state)
    output = gateway.receive(error_frame(0x40))
    assert gateway.state is LifeCycleState.FAULT
    assert faults(output) == ["bus: bus-off: check wiring, termination and bit rate"]
    assert commands(output) == [CENTRED]


@pytest.mark.parametrize("bit", [bit for bit in range(29) if 1 << bit != 0x40])
def test_no_other_error_class_is_a_fault(bit: int) -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.receive(error_frame(1 << bit))
    assert gateway.state is LifeCycleState.RUNNING


def test_bus_off_together_with_another_error_class_is_a_fault() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.receive(error_frame(0x40 | 0x04))
    assert gateway.state is LifeCycleState.FAULT


def test_other_error_frames_are_counted_and_their_reports_are_throttled() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    reports = [text for _ in range(20) for text in texts(gateway.receive(error_frame(0x04)))]
    assert gateway.core.error_frames == 20
    assert reports == [
        f"bus: error frame 00000004#0000000000000000, {number} so far" for number in (*range(1, 9), 16)
    ]
    assert gateway.state is LifeCycleState.RUNNING


def test_a_failed_link_is_a_fault() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    output = gateway.core.link_failed("vcan0: network is down")
    assert gateway.state is LifeCycleState.FAULT
    assert faults(output) == ["link: vcan0: network is down"]
    assert commands(output) == [CENTRED]


def test_a_second_fault_is_reported_and_the_first_reason_stays() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.core.link_failed("first")
    output = gateway.core.link_failed("second")
    assert output == Output(log=(LogEntry(Severity.WARNING, "link", "second"),))
    assert gateway.core.fault_reason == "link: first"
