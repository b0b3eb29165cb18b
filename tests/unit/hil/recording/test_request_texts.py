"""Requests as texts: readable, complete, and with the texts of earlier recordings."""

from __future__ import annotations

import json

import pytest

from hil.core.life_cycle import Trigger
from hil.core.requests import ArmRequest, CheckFailure, ControllerRequest, JogRequest, SetpointRequest
from hil.recording.request_texts import describe_request, read_request, request_text


@pytest.mark.parametrize("trigger", Trigger)
def test_a_trigger_without_an_asker_is_its_bare_value(trigger: Trigger) -> None:
    assert request_text(trigger, "") == trigger.value
    assert read_request(trigger.value) == (trigger, "")


def test_a_request_is_an_object_with_named_fields() -> None:
    text = request_text(JogRequest("vertical", 0.5, 0.2), "uid 1000")
    assert json.loads(text) == {
        "request": "jog",
        "axis": "vertical",
        "offset_v": 0.5,
        "duration_s": 0.2,
        "asked_by": "uid 1000",
    }
    assert json.loads(request_text(Trigger.ARM, "uid 1000")) == {"request": "arm", "asked_by": "uid 1000"}


def test_a_request_to_arm_has_its_checks_and_overrides() -> None:
    request = ArmRequest((CheckFailure("SCHED_FIFO", "not permitted"),), ("SCHED_FIFO", "memory-lock"))
    text = request_text(request, "uid 1000")
    assert json.loads(text) == {
        "request": "arm",
        "failures": [["SCHED_FIFO", "not permitted"]],
        "overrides": ["SCHED_FIFO", "memory-lock"],
        "asked_by": "uid 1000",
    }
    assert read_request(text) == (request, "uid 1000")
    assert describe_request(request) == "arm, overriding SCHED_FIFO, memory-lock"
    assert describe_request(ArmRequest()) == "arm"
    assert read_request('{"request": "arm", "asked_by": "uid 1000"}') == (Trigger.ARM, "uid 1000")


def test_a_field_with_its_default_is_left_out() -> None:
    without = SetpointRequest("a", "0.1")
    assert json.loads(request_text(without, "")) == {
        "request": "setpoint",
        "axis": "a",
        "setpoint": "0.1",
        "asked_by": "",
    }
    for request in (without, SetpointRequest("a", "csv:f", "0,0\n")):
        assert read_request(request_text(request, "")) == (request, "")


def test_whole_numbers_are_read_as_floats() -> None:
    text = '{"request": "jog", "axis": "a", "offset_v": 1, "duration_s": 2, "asked_by": ""}'
    request, _ = read_request(text)
    assert request == JogRequest("a", 1.0, 2.0)
    assert isinstance(request, JogRequest)
    assert isinstance(request.offset_v, float)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("dance", "'dance' is not a command of the operator"),
        ('{"request": "dance"}', "'dance' is not a command of the operator"),
        ("{}", "'' is not a command of the operator"),
        ("{", "Expecting property name"),
        ('{"request": "jog", "axis": "a"}', "must have the keys axis, offset_v, duration_s"),
        ('{"request": "setpoint", "axis": "a", "setpoint": 1.0}', "not a request of the kind setpoint"),
    ],
)
def test_a_text_that_is_no_request_is_refused(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        read_request(text)


def test_requests_in_words() -> None:
    assert describe_request(Trigger.ARM) == "arm"
    assert describe_request(SetpointRequest("a", "0.1")) == "setpoint of a: 0.1"
    assert describe_request(ControllerRequest("a", "ppid", "{}")) == "controller of a: ppid"
    assert describe_request(JogRequest("a", -0.5, 0.2)) == "jog a by -0.5 V for 0.2 s"


def test_a_request_in_words_cannot_act_on_a_terminal() -> None:
    assert describe_request(SetpointRequest("a\x1b[2J", "0.1\nb")) == "setpoint of a?[2J: 0.1?b"
