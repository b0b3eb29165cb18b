"""Events that reach the simulated arm while it runs."""

from __future__ import annotations

import socket

import pytest

from firmware_sim import Arm, FaultyRig, SimulatedRig, read_arm, wiring
from firmware_sim.arm.arm_file import shipped_arm_text
from firmware_sim.event_input import EventInput, parse_present_event
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.shells.run_setup import load_rig


@pytest.fixture
def arm() -> Arm:
    return Arm(read_arm(shipped_arm_text(), "arm.toml"), seed=0, wiring=wiring(load_rig(None)))


@pytest.fixture
def rig(arm: Arm) -> FaultyRig:
    settings = load_rig(None)
    made = FaultyRig(settings, SimulatedRig(settings, arm))
    made.start(0)
    return made


def test_a_fault_begins_when_it_arrives_and_its_frames_leave_at_the_next_deadline(rig: FaultyRig) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    events = EventInput(rig, theirs.detach())
    ours.send(b"reset:adc")
    events.update(5)
    assert rig.next_deadline_ns == 5
    assert rig.on_deadline(5) == (Frame(0x710, b"\x00"),)
    ours.send(b"unplug/0.5")
    events.update(10)
    rig.on_deadline(10)
    assert [text for _, text in rig.begun] == ["reset:adc@0", "unplug@0/0.5"]


def test_an_event_happens_when_it_arrives(arm: Arm, rig: FaultyRig) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    events = EventInput(rig, theirs.detach())
    events.update(0)
    assert arm.view().payload_kg == 0.0
    ours.send(b"payload:3")
    events.update(1)
    rig.on_deadline(1)
    assert arm.view().payload_kg == 3.0
    for garbage in (b"\xff\xfe", b"payload", b"payload:heavy", b"leak:elbow,1,1e-8"):
        ours.send(garbage)
        events.update(2)
    rig.on_deadline(2)
    ours.close()
    events.update(3)
    rig.on_deadline(3)
    assert arm.view().payload_kg == 3.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("payload", "the forms are: payload:KG, supply-pressure:GAUGE_KPA"),
        ("payload:3@4", "happens at once; omit '@4'"),
        ("friction:vertical", "takes the values"),
        ("hang:third", "board is 'third'"),
        ("stall:1", "acts on the gateway's host in simulated time only"),
    ],
)
def test_a_text_that_is_no_event_is_explained(text: str, words: str) -> None:
    with pytest.raises(DocumentError, match=words):
        parse_present_event(text)
