"""Listening before the first frame: one gateway per bus, and the positions before anything moves."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from random import Random

import pytest

from firmware_sim.plants.linear_plant import LinearPlant
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.core.wire import codec
from hil.links import Link, Received, open_link
from hil.shells import bus_guard
from hil.shells.bus_guard import (
    MARGIN,
    MAX_RANDOM_S,
    lock_name,
    refuse_gateway_that_was_heard,
    refuse_other_gateway,
    sole_gateway,
)
from hil.shells.first_look import measured_positions
from hil.shells.run_setup import RunSetup, load_setup

INTERVAL_S = 0.02


@pytest.fixture
def ends(request: pytest.FixtureRequest) -> Iterator[tuple[Link, Link]]:
    name = f"inproc:{request.node.name}"
    with open_link(name) as ours, open_link(name) as theirs:
        yield ours, theirs


@pytest.mark.parametrize(
    ("frame", "named"),
    [
        (Frame(codec.SYNC), "its SYNC frame (0x080)"),
        (Frame(codec.HEARTBEAT_GATEWAY, b"\x05"), "its HEARTBEAT_GATEWAY frame (0x701)"),
        (Frame(codec.RPDO1_DAC, bytes(8)), "its RPDO1_DAC frame (0x220)"),
    ],
)
def test_another_gateway_is_named_and_not_disturbed(
    ends: tuple[Link, Link], frame: Frame, named: str
) -> None:
    ours, theirs = ends
    theirs.send(Frame(codec.HEARTBEAT_ADC, b"\x05"))
    theirs.send(frame)
    with pytest.raises(LinkError) as caught:
        refuse_other_gateway(ours, INTERVAL_S)
    assert named in str(caught.value)
    assert theirs.receive(0.0) is None, "nothing was sent"


@pytest.mark.parametrize(
    "frame",
    [
        Frame(codec.HEARTBEAT_ADC, b"\x05"),
        Frame(codec.TPDO1_ADC, bytes(8)),
        Frame(codec.SYNC, is_extended=True),
        Frame(codec.SYNC, is_error=True),
    ],
)
def test_boards_and_other_nodes_are_no_gateway(ends: tuple[Link, Link], frame: Frame) -> None:
    ours, theirs = ends
    theirs.send(frame)
    refuse_other_gateway(ours, INTERVAL_S)


def test_a_silent_bus_is_listened_to_for_longer_than_the_interval(ends: tuple[Link, Link]) -> None:
    began_s = time.monotonic()
    refuse_other_gateway(ends[0], INTERVAL_S)
    assert time.monotonic() - began_s >= INTERVAL_S


def test_a_babbling_bus_ends_the_listening(ends: tuple[Link, Link], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus_guard, "MAX_FRAMES", 10)
    ours, theirs = ends
    for _ in range(20):
        theirs.send(Frame(0x7F0))
    refuse_other_gateway(ours, 1000.0)
    assert ours.receive(0.0) is not None


def test_of_two_gateways_of_this_machine_that_begin_together_one_is_refused(
    ends: tuple[Link, Link],
) -> None:
    ours, theirs = ends
    with (
        sole_gateway(ours, INTERVAL_S),
        pytest.raises(LinkError, match=rf"process {os.getpid()} of this machine is the gateway of this bus"),
        sole_gateway(theirs, INTERVAL_S),
    ):
        pass
    with sole_gateway(theirs, INTERVAL_S):
        assert ours.receive(0.0) is None, "nothing was sent"


@pytest.mark.parametrize(
    ("one", "other", "is_same"),
    [
        ("can0", "socketcan:can0", True),
        ("slcan:/dev/null", "slcan:/dev/../dev/null@9600", True),
        ("can0", "can1", False),
        ("udp:4000", "udp:4001", False),
    ],
)
def test_a_bus_is_held_however_its_name_is_written(one: str, other: str, is_same: bool) -> None:
    assert (lock_name(one) == lock_name(other)) is is_same


def test_a_bus_inside_a_process_is_held_in_this_process_only(monkeypatch: pytest.MonkeyPatch) -> None:
    here = lock_name("inproc:x")
    monkeypatch.setattr(os, "getpid", lambda: 1)
    assert lock_name("inproc:x") != here


def test_a_gateway_that_was_heard_while_this_one_was_prepared_is_refused(ends: tuple[Link, Link]) -> None:
    ours, theirs = ends
    theirs.send(Frame(codec.TPDO1_ADC, bytes(8)))
    refuse_gateway_that_was_heard(ours)
    theirs.send(Frame(codec.SYNC))
    with pytest.raises(LinkError, match="another gateway is on this bus"):
        refuse_gateway_that_was_heard(ours)


class SilentLink:
    """A link on which nothing arrives. Waiting takes no time, and is counted."""

    def __init__(self, spec: str) -> None:
        self.spec = spec
        self.waited_s: list[float] = []

    def receive(self, timeout_s: float) -> None:
        self.waited_s.append(timeout_s)


@pytest.mark.parametrize(("bus", "random_s"), [("can0", MAX_RANDOM_S), ("vcan0", 0.0)])
def test_on_a_bus_of_several_machines_the_time_of_listening_is_random(
    monkeypatch: pytest.MonkeyPatch, bus: str, random_s: float
) -> None:
    monkeypatch.setattr(bus_guard, "_randomness", Random(7))
    monkeypatch.setattr(bus_guard, "monotonic", lambda: 0.0)
    link = SilentLink(bus)
    for _ in range(50):
        refuse_other_gateway(link, INTERVAL_S)  # type: ignore[arg-type]
    least_s = MARGIN * INTERVAL_S
    assert min(link.waited_s) >= least_s
    assert max(link.waited_s) <= least_s + random_s
    assert max(link.waited_s) - min(link.waited_s) >= 0.8 * random_s


class LinkToBoards:
    """Simulated boards that answer at once."""

    def __init__(self, setup: RunSetup) -> None:
        self.boards = SimulatedRig(setup.rig, LinearPlant(setup.rig))
        self.waiting = list(self.boards.start(time.monotonic_ns()))
        self.sent: list[Frame] = []

    def send(self, frame: Frame) -> bool:
        self.sent.append(frame)
        self.waiting += self.boards.receive(frame, time.monotonic_ns())
        return True

    def receive(self, timeout_s: float) -> Received | None:
        end_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        while not self.waiting:
            now_ns = time.monotonic_ns()
            if now_ns >= self.boards.next_deadline_ns:
                self.waiting += self.boards.on_deadline(now_ns)
            elif now_ns >= end_ns:
                return None
        return Received(self.waiting.pop(0), 0, "user")


def test_positions_are_measured_with_centred_valves() -> None:
    setup = load_setup(None, {}, {})
    link = LinkToBoards(setup)
    gateway = setup.gateway(time.monotonic_ns() + setup.rig.loop.period_ns)
    positions = measured_positions(gateway, link)  # type: ignore[arg-type]
    assert positions == pytest.approx([0.0, 0.0, 0.0], abs=0.002)
    commands = [codec.decode_rpdo1_dac(frame.data) for frame in link.sent if frame.id == codec.RPDO1_DAC]
    assert {command[:3] for command in commands} == {(5.0, 5.0, 5.0)}


def test_positions_of_boards_that_do_not_come_up_are_not_known(ends: tuple[Link, Link]) -> None:
    setup = load_setup(None, {}, {})
    gateway = setup.gateway(time.monotonic_ns() + setup.rig.loop.period_ns)
    assert measured_positions(gateway, ends[0], timeout_s=0.03) is None
