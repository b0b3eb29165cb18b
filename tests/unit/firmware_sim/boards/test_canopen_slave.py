"""The CANopen part of both boards: NMT states, boot-up, heartbeats."""

from __future__ import annotations

import pytest
from support.board_bench import (
    ADC_BOOT,
    DAC_BOOT,
    HEARTBEAT_NS,
    MS,
    PRE_OPERATIONAL,
    RESET_COMMUNICATION,
    RESET_NODE,
    RIG,
    START,
    STOP,
    SYNC,
    Bench,
    HandPlant,
    command,
    nmt,
)

from firmware_sim.simulated_rig import SimulatedRig
from hil.core.frames import Frame


def test_boot_up_then_pre_operational() -> None:
    bench = Bench()
    assert bench.booted == (ADC_BOOT, DAC_BOOT)
    assert bench.wait(HEARTBEAT_NS) == [Frame(0x710, b"\x7f"), Frame(0x720, b"\x7f")]


def test_without_power_nothing_happens() -> None:
    plant = HandPlant()
    rig = SimulatedRig(RIG, plant)
    assert rig.next_deadline_ns > 10**18
    for frame in (nmt(START), SYNC, command((6, 6, 6), 0)):
        assert rig.receive(frame, 10**9) == ()
    assert rig.on_deadline(2 * 10**9) == ()
    assert plant.held == []


@pytest.mark.parametrize(
    ("sent", "state"), [(START, 5), (STOP, 4), (PRE_OPERATIONAL, 127)], ids=["start", "stop", "pre-op"]
)
def test_nmt_commands_change_the_state_in_the_heartbeat(sent: int, state: int) -> None:
    bench = Bench().started()
    assert bench.give(nmt(sent)) == []
    assert bench.wait(HEARTBEAT_NS) == [Frame(0x710, bytes((state,))), Frame(0x720, bytes((state,)))]


@pytest.mark.parametrize(("node", "states"), [(0x10, (5, 127)), (0x20, (127, 5)), (0x30, (127, 127))])
def test_an_nmt_command_reaches_the_node_that_it_names(node: int, states: tuple[int, int]) -> None:
    bench = Bench()
    bench.give(nmt(START, node))
    assert bench.wait(HEARTBEAT_NS) == [
        Frame(0x710, bytes((states[0],))),
        Frame(0x720, bytes((states[1],))),
    ]


@pytest.mark.parametrize("reset", [RESET_NODE, RESET_COMMUNICATION])
def test_a_reset_sends_the_boot_up_message_and_restarts_the_heartbeat_timer(reset: int) -> None:
    bench = Bench().started()
    bench.wait(HEARTBEAT_NS // 2)
    assert bench.give(nmt(reset)) == [ADC_BOOT, DAC_BOOT]
    assert bench.wait(HEARTBEAT_NS - 1) == []
    assert bench.wait(1) == [Frame(0x710, b"\x7f"), Frame(0x720, b"\x7f")]


@pytest.mark.parametrize("data", [b"", b"\x01", b"\x01\x00\x00", b"\x03\x00"])
def test_an_invalid_nmt_frame_changes_nothing(data: bytes) -> None:
    bench = Bench()
    assert bench.give(Frame(0x000, data)) == []
    assert bench.rig.adc.state == bench.rig.dac.state == 127


def test_extended_remote_and_error_frames_are_ignored() -> None:
    bench = Bench()
    start = nmt(START)
    for kind in ("is_extended", "is_remote", "is_error"):
        assert bench.give(start._replace(**{kind: True})) == []
    assert bench.rig.adc.state == bench.rig.dac.state == 127


def test_overdue_heartbeats_are_sent_once_and_the_schedule_is_kept() -> None:
    bench = Bench(heartbeat_ns=50 * MS)
    start_ns = bench.now_ns
    late_ns = start_ns + 230 * MS
    assert len(bench.rig.on_deadline(late_ns)) == 2
    assert bench.rig.next_deadline_ns == start_ns + 250 * MS
