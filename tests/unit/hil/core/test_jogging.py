"""When a jog ends, and when the next one may begin: to the nanosecond."""

from __future__ import annotations

import pytest
from support.constants import PERIOD_S
from support.gateway_bench import SteppedGateway, make_gateway, make_rig, make_stepped

from hil.core.jogging import RELEASE_NS
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.requests import JogRequest, Request

JOG = JogRequest("vertical", 0.5, 0.2)


def is_accepted(gateway: SteppedGateway, request: Request, now_ns: int) -> bool:
    reply = gateway.core.operate(request, now_ns).reply
    assert reply is not None
    return reply.accepted


@pytest.fixture
def armed() -> SteppedGateway:
    gateway = make_stepped(LifeCycleState.ARMED)
    gateway.period()
    return gateway


def test_a_jog_ends_at_the_deadline_that_is_its_end(armed: SteppedGateway) -> None:
    armed.deadline()
    armed.operate(JOG._replace(duration_s=3 * PERIOD_S))
    armed.sample()
    for _ in range(2):
        armed.period()
        assert armed.state is LifeCycleState.RUNNING
        assert armed.core.is_jogging is True
    armed.deadline()
    assert armed.state is LifeCycleState.ARMED
    assert armed.core.is_jogging is False


def test_a_further_request_counts_its_time_from_when_it_came(armed: SteppedGateway) -> None:
    for periods in (3, 2):
        armed.deadline()
        armed.operate(JOG._replace(duration_s=periods * PERIOD_S))
        armed.sample()
    armed.deadline()
    assert armed.state is LifeCycleState.RUNNING
    armed.deadline()
    assert armed.state is LifeCycleState.ARMED


def test_after_a_stop_the_pause_must_have_its_full_length(armed: SteppedGateway) -> None:
    assert RELEASE_NS == 500_000_000
    armed.operate(JOG)
    stopped_ns = armed.now_ns
    assert is_accepted(armed, Trigger.STOP, stopped_ns)
    asked_ns = stopped_ns + 499_999_999
    assert not is_accepted(armed, JOG, asked_ns)
    again_ns = asked_ns + 499_999_999
    assert not is_accepted(armed, JOG, again_ns)
    assert is_accepted(armed, JOG, again_ns + 500_000_000)


def test_a_jog_that_ended_by_itself_may_be_repeated_at_once(armed: SteppedGateway) -> None:
    armed.operate(JOG._replace(duration_s=PERIOD_S))
    armed.periods(2)
    assert armed.state is LifeCycleState.ARMED
    assert is_accepted(armed, JOG, armed.now_ns)
    assert armed.state is LifeCycleState.RUNNING


def test_after_a_stop_another_axis_can_be_jogged_anew(armed: SteppedGateway) -> None:
    """The stopped jog is not extended: the new one begins, with its own axis."""
    armed.operate(JOG)
    armed.operate(Trigger.STOP)
    later_ns = armed.now_ns + RELEASE_NS
    assert is_accepted(armed, JogRequest("horizontal", -0.5, 0.1), later_ns)
    assert armed.state is LifeCycleState.RUNNING
    armed.period()
    assert [round(volts, 2) for volts in armed.transcript.commands()[-1]] == [5.0, 4.5, 5.0]


def test_the_stop_of_a_controlled_motion_needs_no_pause(armed: SteppedGateway) -> None:
    armed.operate(Trigger.START)
    armed.period()
    armed.operate(Trigger.STOP)
    assert is_accepted(armed, JOG, armed.now_ns)


def test_the_cycle_of_a_jog_has_its_voltage_before_and_after_the_limits(armed: SteppedGateway) -> None:
    armed.operate(JOG)
    cycle = armed.period().cycle
    assert cycle is not None
    assert (cycle.fresh, cycle.receive_ns) == (True, armed.now_ns)
    jogged, *others = cycle.axes
    assert (jogged.output_v, jogged.command_v) == (0.5, 5.5)
    assert (jogged.setpoint, jogged.error) == (jogged.position, 0.0)
    assert [(axis.output_v, axis.command_v) for axis in others] == [(0.0, 5.0)] * 2


def test_a_jog_has_no_tracking_error() -> None:
    rig = make_rig(envelope=f"max_error = 0.01\nmax_error_s = {2 * PERIOD_S}")
    gateway = SteppedGateway(rig, make_gateway(rig, setpoints="hold")).bring_to(LifeCycleState.ARMED)
    gateway.period()
    for _ in range(10):
        gateway.operate(JOG)
        gateway.period()
        assert gateway.state is LifeCycleState.RUNNING


def test_the_sample_that_ends_a_jog_gives_a_fresh_cycle(armed: SteppedGateway) -> None:
    armed.operate(JOG)
    armed.period([8.0, 5.0, 5.0])
    cycle = armed.period([8.65, 5.0, 5.0]).cycle
    assert armed.state is LifeCycleState.ARMED
    assert cycle is not None
    assert (cycle.fresh, cycle.receive_ns, cycle.state) == (True, armed.now_ns, LifeCycleState.ARMED)


def test_a_jog_after_control_begins_where_the_axis_was_moved_by_hand(armed: SteppedGateway) -> None:
    """Neither the envelope nor the travel fence knows the positions from before."""
    armed.operate(Trigger.START)
    armed.periods(6)
    armed.operate(Trigger.STOP)
    armed.volts = (9.0, 5.0, 5.0)  # beyond the fence
    armed.period()
    armed.operate(JOG)
    for _ in range(10):
        armed.period()
        assert armed.state is LifeCycleState.RUNNING
