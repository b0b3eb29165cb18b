"""Requests for the setpoint and the controller of one axis: what is refused, and what the reply says."""

from __future__ import annotations

import json

import pytest
from support.constants import PERIOD_S
from support.gateway_bench import make_rig

from hil.core.axis_loops import AxisLoops
from hil.core.axis_requests import MAX_NAME, SMALL_BUMP_V, AxisRequests, Prepared
from hil.core.control_law import ControlLaw, Matching
from hil.core.controller_change import prepare_controller
from hil.core.controller_file import PidLaw
from hil.core.output import Output
from hil.core.requests import ControllerRequest, Reply, SetpointRequest
from hil.core.setpoint_change import PreparedSetpoint, prepare_setpoint
from hil.core.setpoints import parse_setpoint

RIG = make_rig()
CONTROLLER = ControllerRequest(
    "vertical",
    "new.json",
    json.dumps(
        {
            "format": "hil-controller",
            "version": 1,
            "name": "test",
            "description": "",
            "sample_time_s": PERIOD_S,
            "input_unit": "m",
            "output_unit": "V",
            "law": {"kind": "pid", "kp": 5.0, "ki": 1.0},
            "origin": {},
        }
    ),
)
TABLE = SetpointRequest("vertical", "csv:table.csv", "0,0\n1,0.05\n")


class Subject(AxisRequests):
    """The requests, with loops that no sample has reached. ``matching`` is what a changed law reports."""

    def __init__(self, matching: Matching | None = None) -> None:
        law = PidLaw(kp=20.0, ki=0.0)
        loops = AxisLoops(
            RIG,
            {name: ControlLaw(law, PERIOD_S) for name in RIG.axes},
            {name: parse_setpoint("hold") for name in RIG.axes},
        )
        if matching is not None:
            loops.change_law = lambda *_: matching  # type: ignore[method-assign]
        super().__init__(RIG, loops)

    def reply(self, request: SetpointRequest | ControllerRequest, prepared: Prepared | None = None) -> Reply:
        """The reply, which is that of the output too."""
        output: Output = self.change(request, True, prepared)
        assert output.reply is not None
        assert [entry.text for entry in output.log] == [output.reply.text]
        return output.reply


def test_the_longest_name_of_an_axis_is_repeated_and_a_longer_one_is_not() -> None:
    assert MAX_NAME == 200
    longest = Subject().reply(SetpointRequest("x" * 200, "0.1"))
    assert longest.text.startswith(f"refused: no axis '{'x' * 200}'; the rig has vertical, horizontal, ")
    longer = Subject().reply(SetpointRequest("x" * 201, "0.1"))
    assert longer == Reply(False, "refused: the axis has a name of 201 characters")


def test_a_controller_may_have_the_longest_name_and_no_longer_one() -> None:
    assert Subject().reply(CONTROLLER._replace(name="x" * 200)).accepted
    longer = Subject().reply(CONTROLLER._replace(name="x" * 201))
    assert longer == Reply(False, "controller refused: its name must have at most 200 printable characters")


def test_what_was_prepared_for_another_kind_of_request_is_not_used() -> None:
    controller = prepare_controller(CONTROLLER, RIG)
    table = prepare_setpoint(TABLE, RIG)
    assert table is not None
    assert Subject().reply(TABLE, controller).accepted
    assert Subject().reply(CONTROLLER, table).accepted


def test_what_was_prepared_for_this_request_is_used() -> None:
    controller = prepare_controller(CONTROLLER, RIG)._replace(numbers=None, refusal="marked")
    assert Subject().reply(CONTROLLER, controller) == Reply(False, "controller refused: marked")
    table = prepare_setpoint(TABLE, RIG)
    assert table is not None
    marked = table._replace(refusal="marked")
    assert Subject().reply(TABLE, marked) == Reply(False, "setpoint refused: marked")


def test_a_setpoint_can_be_judged_without_being_given() -> None:
    subject = Subject()
    assert subject.refuse_setpoint(SetpointRequest("vertical", "0.1"), None) is None
    beyond = subject.refuse_setpoint(SetpointRequest("vertical", "0.2"), None)
    assert beyond is not None
    assert not beyond.accepted
    assert beyond.text.startswith("setpoint refused: vertical: setpoint 'step:0.2@0' reaches 0.2 m")
    unknown = subject.refuse_setpoint(SetpointRequest("elbow", "0.1"), None)
    assert unknown is not None
    assert unknown.text.startswith("refused: no axis 'elbow'")
    prepared = prepare_setpoint(TABLE, RIG)
    assert prepared is not None
    assert subject.refuse_setpoint(TABLE, prepared) is None
    marked: PreparedSetpoint = prepared._replace(refusal="marked")
    assert subject.refuse_setpoint(TABLE, marked) == Reply(False, "setpoint refused: marked")


ABOVE_V = 1.1 * SMALL_BUMP_V


@pytest.mark.parametrize(
    ("matching", "said"),
    [
        (Matching(SMALL_BUMP_V, SMALL_BUMP_V, 0.5), "takes over at the last command, without a bump"),
        (Matching(-SMALL_BUMP_V, -SMALL_BUMP_V, 0.5), "takes over at the last command, without a bump"),
        (Matching(ABOVE_V, 0.0, 0.0), "takes over with a bump of +1.1e-06 V, because it has no state that"),
        (Matching(-0.25, 0.0, 0.0), "takes over with a bump of -0.25 V, because it has no state that"),
        (
            Matching(0.0, ABOVE_V, 0.5),
            "takes over at the last command; it has no integrator, so its output then moves by +1.1e-06 V "
            "with a time constant of 0.5 s, at most 400 V/s (rig: axes.vertical.valve.max_rate_v_s)",
        ),
        (Matching(0.0, -0.25, 0.5), "its output then moves by -0.25 V with a time constant of 0.5 s"),
        (Matching(0.0, -0.25, 1000.4), "with a time constant of 1000 s"),
        (Matching(0.0, -0.25, 0.012345), "with a time constant of 0.0123 s"),
        (None, "acts from the next start on"),
    ],
)
def test_the_reply_says_how_a_controller_takes_over(matching: Matching | None, said: str) -> None:
    reply = Subject(matching).reply(CONTROLLER)
    assert reply.accepted
    assert reply.text.startswith("controller new.json ")
    assert said in reply.text
    assert reply.text.endswith("; the file holds no plant as numbers, so the closed loop was not checked")
    assert ("bump of" in reply.text) is ("bump of" in said)
