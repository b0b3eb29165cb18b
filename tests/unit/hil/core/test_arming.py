"""The checks before arming: what refuses it, what overrides a check, and for how long."""

from __future__ import annotations

import json

import pytest
from support.constants import PERIOD_S
from support.gateway_bench import START_NS, SteppedGateway, make_rig

from hil.core.check_names import check_overrides
from hil.core.control_law import ControlLaw
from hil.core.controller_file import PidLaw
from hil.core.core_state import restore, state_of
from hil.core.errors import DocumentError
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Severity
from hil.core.requests import ArmRequest, CheckFailure, ControllerRequest, JogRequest, arm_request
from hil.core.setpoints import parse_setpoint

NO_FIFO = CheckFailure("SCHED_FIFO", "this machine refuses it")
NO_LOCK = CheckFailure("memory-lock", "this machine refuses it too")
ENVELOPE = "min_y = -0.15\nmax_error = 0.15"
BEYOND_V = (0.3, 5.0, 5.0)
"""Voltages at which the vertical axis is at -0.155 m, outside ENVELOPE."""
STABLE = {
    "format": "hil-controller",
    "version": 1,
    "name": "test",
    "description": "",
    "sample_time_s": PERIOD_S,
    "input_unit": "m",
    "output_unit": "V",
    "law": {"kind": "pid", "kp": 5.0, "ki": 0.0},
    "origin": {},
}


def ready(envelope: str = ENVELOPE, controller_failure: str | None = None) -> SteppedGateway:
    """A gateway with one axis in state ready."""
    rig = make_rig(axes=["vertical"], envelope=envelope)
    core = Gateway(
        rig,
        {"vertical": ControlLaw(PidLaw(kp=5.0, ki=0.0), PERIOD_S)},
        {"vertical": parse_setpoint("hold")},
        START_NS,
        controller_failures={} if controller_failure is None else {"vertical": controller_failure},
    )
    return SteppedGateway(rig, core).bring_to(LifeCycleState.READY)


def refusal(gateway: SteppedGateway, request: Trigger | ArmRequest) -> str:
    """The text with which a request to arm is refused."""
    output = gateway.operate(request)
    assert output.reply is not None
    assert not output.reply.accepted
    assert gateway.state is LifeCycleState.READY
    assert [entry.severity for entry in output.log] == [Severity.WARNING]
    return output.reply.text


def arm(gateway: SteppedGateway, request: Trigger | ArmRequest) -> list[str]:
    """The warnings with which a request to arm is accepted."""
    output = gateway.operate(request)
    assert output.reply is not None
    assert output.reply.accepted
    assert gateway.state is LifeCycleState.ARMED
    return [entry.text for entry in output.log if entry.severity is Severity.WARNING]


def test_a_gateway_without_failed_checks_arms_without_warnings() -> None:
    assert arm(ready(), Trigger.ARM) == []
    gateway = ready()
    assert arm(gateway, ArmRequest()) == []
    assert gateway.core.overridden_checks == ()


def test_a_failed_check_of_the_machine_refuses_to_arm() -> None:
    text = refusal(ready(), ArmRequest((NO_FIFO, NO_LOCK)))
    assert text == (
        "arm refused: SCHED_FIFO: this machine refuses it; memory-lock: this machine refuses it too; or arm "
        "all the same with --override SCHED_FIFO memory-lock"
    )


def test_a_position_outside_the_envelope_refuses_to_arm() -> None:
    gateway = ready()
    gateway.period(BEYOND_V)
    text = refusal(gateway, Trigger.ARM)
    assert "position-vertical: position -0.1551 m is below the lower soft end stop -0.15 m" in text
    assert "by hand, because `hil start` and a jog of this axis stay refused, also with an override" in text
    assert arm(gateway, ArmRequest((), ("position-vertical",)))
    for request in (Trigger.START, JogRequest("vertical", 0.3, 0.1)):
        reply = gateway.operate(request).reply
        assert reply is not None
        assert not reply.accepted
    gateway.operate(Trigger.DISARM)
    gateway.period((5.0, 5.0, 5.0))
    assert arm(gateway, Trigger.ARM) == []


def test_an_unstable_loop_refuses_to_arm_until_another_controller_is_there() -> None:
    gateway = ready(controller_failure="its loop is unstable")
    assert "controller-vertical: its loop is unstable; or" in refusal(gateway, Trigger.ARM)
    refused = gateway.operate(ControllerRequest("vertical", "broken.json", "{}"))
    assert refused.reply is not None
    assert not refused.reply.accepted
    assert "controller-vertical" in refusal(gateway, Trigger.ARM)
    gateway.operate(ControllerRequest("vertical", "new.json", json.dumps(STABLE)))
    assert arm(gateway, Trigger.ARM) == []


def test_every_failed_check_must_be_overridden() -> None:
    gateway = ready(controller_failure="its loop is unstable")
    gateway.period(BEYOND_V)
    text = refusal(gateway, ArmRequest((NO_FIFO,), ("controller-vertical",)))
    assert text.endswith("--override SCHED_FIFO position-vertical")
    names = ("SCHED_FIFO", "position-vertical", "controller-vertical")
    warnings = arm(gateway, ArmRequest((NO_FIFO,), names))
    assert len(warnings) == 3
    assert warnings[0] == "SCHED_FIFO is overridden: this machine refuses it"
    assert gateway.core.overridden_checks == names


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("foo", ""),
        ("position-vertikal", "; did you mean position-vertical?"),
        ("memory lock", "; did you mean memory-lock?"),
    ],
)
def test_an_override_of_a_check_that_does_not_exist_is_refused(name: str, hint: str) -> None:
    rig = make_rig(axes=["vertical"])
    check_overrides(["position-vertical", "controller-vertical", "SCHED_FIFO", "memory-lock"], rig)
    with pytest.raises(DocumentError) as raised:
        check_overrides(["SCHED_FIFO", name], rig)
    assert str(raised.value) == (
        f"--override {name}: no check has this name; the checks are position-vertical, controller-vertical, "
        f"SCHED_FIFO, memory-lock{hint}"
    )


def test_an_override_that_was_not_needed_is_not_shown() -> None:
    gateway = ready()
    assert arm(gateway, ArmRequest((), ("memory-lock",))) == []
    assert gateway.core.overridden_checks == ()


@pytest.mark.parametrize("end", ["disarm", "fault"])
def test_an_override_ends_with_state_armed(end: str) -> None:
    gateway = ready()
    arm(gateway, ArmRequest((NO_FIFO,), ("SCHED_FIFO",)))
    gateway.operate(Trigger.START)
    gateway.period()
    assert gateway.core.overridden_checks == ("SCHED_FIFO",)
    if end == "fault":
        gateway.core.link_failed("test")
    else:
        gateway.operate(Trigger.STOP)
        gateway.operate(Trigger.DISARM)
        assert "SCHED_FIFO" in refusal(gateway, ArmRequest((NO_FIFO,)))
    assert gateway.core.overridden_checks == ()


def test_an_overridden_position_still_refuses_motion() -> None:
    gateway = ready()
    gateway.period(BEYOND_V)
    arm(gateway, ArmRequest((), ("position-vertical",)))
    for request in (Trigger.START, JogRequest("vertical", 0.3, 0.2)):
        output = gateway.operate(request)
        assert output.reply is not None
        assert not output.reply.accepted


def test_no_override_replaces_the_boards() -> None:
    gateway = SteppedGateway(make_rig(axes=["vertical"], envelope=ENVELOPE))
    gateway.deadline()
    output = gateway.operate(ArmRequest((), ("position-vertical", "boards")))
    assert output.reply is not None
    assert "arm refused in state offline" in output.reply.text


def test_disabled_checks_of_the_envelope_are_named_when_it_arms() -> None:
    gateway = ready(envelope='disabled = ["max_error"]')
    expected = ["not protected by max_error (rig: axes.vertical.envelope.disabled)"]
    assert arm(gateway, Trigger.ARM) == expected


def test_the_state_of_a_core_has_its_overrides() -> None:
    gateway = ready()
    arm(gateway, ArmRequest((NO_FIFO,), ("SCHED_FIFO",)))
    copy = ready().core
    restore(copy, json.loads(json.dumps(state_of(gateway.core))))
    assert copy.overridden_checks == ("SCHED_FIFO",)


def test_a_request_without_anything_to_add_is_the_plain_trigger() -> None:
    assert arm_request((), ()) is Trigger.ARM
    assert arm_request((NO_FIFO,), ()) == ArmRequest((NO_FIFO,))
    assert arm_request((), ("memory-lock",)) == ArmRequest((), ("memory-lock",))


@pytest.mark.parametrize(
    ("max_v", "far_open_v", "disabled", "is_warned"),
    [
        ("8.0", 3.0, "", False),  # the valve opens just far enough
        ("7.9", 3.0, "", True),
        ("7.9", 2.9, "", True),
        ("7.9", 3.0, "max_still_s", False),  # named as disabled already
    ],
)
def test_a_valve_that_cannot_be_far_open_is_named_when_it_arms(
    max_v: str, far_open_v: float, disabled: str, is_warned: bool
) -> None:
    keys = [disabled] if disabled else []
    envelope = f"{ENVELOPE}\ndisabled = {json.dumps(keys)}"
    rig = make_rig({"axes.vertical.valve.max_v": max_v}, axes=["vertical"], envelope=envelope)
    assert rig.axes["vertical"].limits.far_open_v == 3.0
    gateway = SteppedGateway(rig).bring_to(LifeCycleState.READY)
    warnings = arm(gateway, Trigger.ARM)
    assert any("not protected by max_still_s, because the valve opens by" in text for text in warnings) is (
        is_warned
    )
    assert len(warnings) == (1 if is_warned or disabled else 0)
