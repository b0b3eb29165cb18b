"""Events that reach the simulated arm while it runs."""

from __future__ import annotations

import socket

import pytest

from firmware_sim import Arm, read_arm, wiring
from firmware_sim.arm.arm_file import shipped_arm_text
from firmware_sim.event_input import EventInput, parse_present_event
from hil.core.errors import DocumentError
from hil.shells.run_setup import load_rig


@pytest.fixture
def arm() -> Arm:
    return Arm(read_arm(shipped_arm_text(), "arm.toml"), seed=0, wiring=wiring(load_rig(None)))


def test_an_event_happens_when_it_arrives(arm: Arm) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    events = EventInput(arm, theirs.detach())
    events.update(0)
    assert arm.view().payload_kg == 0.0
    ours.send(b"payload:3")
    events.update(1)
    assert arm.view().payload_kg == 3.0
    for garbage in (b"\xff\xfe", b"payload", b"payload:heavy", b"leak:elbow,1,1e-8"):
        ours.send(garbage)
        events.update(2)
    ours.close()
    events.update(3)
    assert arm.view().payload_kg == 3.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("payload", "the forms are: payload:KG, supply-pressure:"),
        ("payload:3@4", "happens at once; omit '@4'"),
        ("friction:vertical", "takes the values"),
    ],
)
def test_a_text_that_is_no_event_is_explained(text: str, words: str) -> None:
    with pytest.raises(DocumentError, match=words):
        parse_present_event(text)
