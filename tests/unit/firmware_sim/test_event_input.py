"""Events that reach the simulated arm while it runs."""

from __future__ import annotations

import socket

import pytest

from firmware_sim import Arm, FaultyRig, SimulatedRig, read_arm, wiring
from firmware_sim.arm.arm_file import shipped_arm_text
from firmware_sim.arm.event_text import parse_event
from firmware_sim.event_input import EventInput, check_arm_event, check_model_event, parse_present_event
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.shells.run_setup import load_rig


@pytest.fixture
def arm() -> Arm:
    return Arm(read_arm(shipped_arm_text(), "arm.toml"), seed=0, wiring=wiring(load_rig(None)))


@pytest.fixture
def rig(arm: Arm) -> FaultyRig:
    settings = load_rig(None)
    made = FaultyRig(settings, SimulatedRig(settings, arm), is_told_states=True)
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


def test_a_fault_with_a_time_or_a_condition_is_armed(arm: Arm, rig: FaultyRig) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    events = EventInput(rig, theirs.detach())
    for text in (b"payload:3@0.5", b"lose:sample,50%@vertical>0.05", b"hang:adc@running+1/0.2"):
        ours.send(text)
        events.update(10)
    rig.on_deadline(10)
    assert rig.begun == []
    rig.on_deadline(500_000_010)
    assert [text for _, text in rig.begun] == ["payload:3@0.5"]
    assert arm.view().payload_kg == 3.0


def test_a_fault_that_begins_is_reported_with_its_instant(rig: FaultyRig) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    events = EventInput(rig, theirs.detach())
    ours.send(b"unplug/0.5")
    events.update(10)
    ours.send(b"hang:adc@0.5")
    events.update(20)
    with pytest.raises(BlockingIOError):
        ours.recv(1000)
    rig.on_deadline(500_000_020)
    assert [ours.recv(1000), ours.recv(1000)] == [b"10 fault unplug@0/0.5", b"500000020 fault hang:adc@0.5"]
    ours.close()
    rig.plan("hang:dac@0", 600_000_000)
    rig.on_deadline(600_000_000)
    assert rig.begun[-1] == (600_000_000, "hang:dac@0"), "also without a gateway to report to"


def test_a_planned_event_that_begins_is_reported_with_its_instant() -> None:
    settings = load_rig(None)
    parameters = read_arm(shipped_arm_text(), "arm.toml")
    arm = Arm(parameters, seed=0, wiring=wiring(settings), events=[parse_event("payload:3@0.005")])
    rig = FaultyRig(settings, SimulatedRig(settings, arm))
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    EventInput(rig, theirs.detach())
    rig.start(0)
    rig.receive(Frame(0x000, bytes((1, 0))), 1_000_000)
    rig.receive(Frame(0x080, bytes((1,))), 7_000_000)
    with pytest.raises(BlockingIOError):
        ours.recv(1000)
    rig.receive(Frame(0x080, bytes((2,))), 18_200_000)
    assert ours.recv(1000) == b"12000000 event payload:3@0.005"
    assert rig.begun == [], "an event is no fault"


def test_a_fault_can_wait_for_a_state_of_the_gateway(rig: FaultyRig) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    events = EventInput(rig, theirs.detach())
    for now_ns, text in enumerate((b"state ready", b"hang:adc@armed", b"state armed")):
        assert rig.begun == []
        ours.send(text)
        events.update(now_ns)
        rig.on_deadline(now_ns)
    assert rig.begun == [(2, "hang:adc@armed")]


def test_events_are_checked_with_the_rig_and_the_plant() -> None:
    settings = load_rig(None)
    check_arm_event("payload:3", settings)
    check_arm_event("freeze-sensor:vertical@running", settings)
    check_model_event("freeze-sensor:vertical@rotation<0.1/2", settings)
    for text in ("freeze-sensor:elbow", "hang:adc@elbow>0.1"):
        with pytest.raises(DocumentError, match="elbow"):
            check_model_event(text, settings)
    with pytest.raises(DocumentError, match="acts on the pneumatic arm, but a linear model is simulated"):
        check_model_event("leak:vertical,1,1e-8", settings)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("payload", "event 'payload': its values are missing; write payload:KG"),
        ("paylod:3", r"did you mean payload\? Write payload:KG"),
        ("hnag:adc", r"not an event; did you mean hang\? Write hang:BOARD$"),
        ("elephant:3", "not an event; the forms are: payload:KG, supply-pressure:GAUGE_KPA"),
        ("payload:heavy", "event 'payload:heavy': mass_kg is 'heavy', but must be a number"),
        ("payload:3@soon", "event 'payload:3@soon': 'soon' is neither a time nor a condition"),
        ("friction:vertical", "takes the values"),
        ("hang:third", "board is 'third'"),
        ("stall:1", "acts on the gateway's host in simulated time only"),
        ("stall:1@2", "acts on the gateway's host in simulated time only"),
    ],
)
def test_a_text_that_is_no_event_is_explained(text: str, words: str) -> None:
    with pytest.raises(DocumentError, match=words):
        parse_present_event(text)
