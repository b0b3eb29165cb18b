"""The loops of all axes: their time, their failures, and outputs that are not finite numbers."""

from __future__ import annotations

import math

import pytest
from support.constants import CENTRED, COUNT_V, PERIOD_NS, PERIOD_S
from support.gateway_bench import (
    ADC_UP,
    DAC_UP,
    SteppedGateway,
    commands,
    faults,
    make_gateway,
    make_rig,
    make_stepped,
)

from hil.core.axis_loops import AxisLoops
from hil.core.control_law import ControlLaw
from hil.core.controller_file import PidLaw, TransferFunctionLaw
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.references import GivenSetpoint
from hil.core.setpoints import Setpoint, parse_setpoint


class TestNotFinite:
    GROWING = TransferFunctionLaw(num=[1.0], den=[1.0, -1e10])
    """A control law whose output overflows within 40 samples."""

    def test_an_output_that_is_not_finite_is_a_fault_and_sends_only_the_centre(self) -> None:
        rig = make_rig()
        laws = {
            "vertical": PidLaw(kp=20.0, ki=0.0),
            "horizontal": self.GROWING,
            "rotation": PidLaw(kp=1.0, ki=0.0),
        }
        gateway = SteppedGateway(rig, make_gateway(rig, laws))
        gateway.core._loops._axes[1].law._L = [0.0]  # without feedback of the limits, the output grows
        gateway.bring_to(LifeCycleState.RUNNING)
        for _ in range(60):
            gateway.deadline()
            gateway.receive(ADC_UP, DAC_UP)
            output = gateway.sample()
            if gateway.state is LifeCycleState.FAULT:
                break
        assert commands(output) == [CENTRED]
        (text,) = faults(output)
        assert text.startswith("horizontal: control law gave ")
        assert text.endswith(" V at setpoint 0.05, position 0")
        assert output.cycle is not None
        assert output.cycle.state is LifeCycleState.FAULT
        assert not math.isfinite(output.cycle.axes[1].output_v)
        assert [axis.command_v for axis in output.cycle.axes] == list(CENTRED)

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    @pytest.mark.parametrize("axis", [0, 1, 2])
    def test_a_setpoint_that_is_not_finite_is_a_fault_on_any_axis(self, value: float, axis: int) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.core._loops._axes[axis].reference = GivenSetpoint(Setpoint("", lambda t: value, 0.0, 0.0))
        gateway.deadline()
        output = gateway.sample()
        assert commands(output) == [CENTRED]
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output)[0].startswith(f"{gateway.core._loops._axes[axis].name}: control law gave ")


def test_the_failed_sample_is_recorded_with_its_error() -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    gateway.core._loops._axes[1].law.output = lambda r, y: math.nan  # type: ignore[method-assign]
    gateway.deadline()
    output = gateway.sample((5.0, 5.5, 5.0))
    assert output.cycle is not None
    signals = output.cycle.axes[1]
    assert (signals.setpoint, signals.potentiometer_v) == (0.05, pytest.approx(5.5, abs=1e-3))
    assert signals.error == signals.setpoint - signals.position == pytest.approx(0.05 - 0.0165, abs=1e-4)


def test_no_number_that_is_not_finite_reaches_the_valve_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    gateway = make_stepped(LifeCycleState.RUNNING)
    asked: list[float] = []
    command = gateway.core._loops._valves.command

    def spied(index: int, offset_v: float) -> float:
        asked.append(offset_v)
        return command(index, offset_v)

    monkeypatch.setattr(gateway.core._loops._valves, "command", spied)
    gateway.core._loops._axes[1].reference = GivenSetpoint(Setpoint("", lambda t: math.nan, 0.0, 0.0))
    gateway.deadline()
    gateway.sample()
    assert len(asked) == 1
    assert math.isfinite(asked[0])


def loops_of(setpoint: Setpoint, envelope: str = "", **changes: str) -> AxisLoops:
    """The loops of all axes, each with a law of 20 V/m (V/rad) and this setpoint."""
    rig = make_rig({key.replace("__", "."): text for key, text in changes.items()}, envelope=envelope)
    laws = {name: ControlLaw(PidLaw(kp=20.0, ki=0.0), PERIOD_S) for name in rig.axes}
    return AxisLoops(rig, laws, dict.fromkeys(rig.axes, setpoint))


def test_the_time_of_a_setpoint_is_exact_after_a_long_run() -> None:
    asked: list[float] = []

    def at(t: float) -> float:
        asked.append(t)
        return 0.0

    loops = loops_of(Setpoint("", at, 0.0, 0.0))
    loops.control(CENTRED, 7, 7)
    asked.clear()
    loops.control(CENTRED, 10**15 + 7, 10**15 + 7)
    assert set(asked) == {1e6}


def test_the_first_axis_that_leaves_its_envelope_is_named() -> None:
    loops = loops_of(parse_setpoint("hold"))
    failure = loops.control((5.0, 9.95, 0.05), 0, 0)
    assert failure is not None
    assert failure.axis == "horizontal"
    assert "above the upper soft end stop" in failure.reason


def test_after_a_stop_the_rate_limit_allows_the_change_of_a_whole_period() -> None:
    """The valves are centred then, so that a late sample before the stop does not matter any more."""
    gateway = make_stepped(LifeCycleState.RUNNING, axes__vertical__valve__max_rate_v_s="10.0")
    gateway.periods(3)
    gateway.deadline()
    gateway.sample(after_ns=PERIOD_NS - 1_000_000)
    gateway.operate(Trigger.STOP)
    gateway.operate(Trigger.START)
    gateway.deadline()
    (command,) = commands(gateway.sample())
    assert command[0] == pytest.approx(5.0 + 10.0 * PERIOD_S, abs=COUNT_V)


def test_a_controller_that_comes_before_the_first_sample_acts_from_it_on() -> None:
    gateway = make_stepped(LifeCycleState.ARMED)
    gateway.periods(2)
    gateway.operate(Trigger.START)
    loops = gateway.core._loops
    assert not loops.have_begun
    law = ControlLaw(PidLaw(kp=10.0, ki=0.0), PERIOD_S)
    assert loops.change_law("vertical", law, is_running=True) is None
    (command,) = commands(gateway.period())
    assert command[0] == pytest.approx(5.0 + 10.0 * 0.05, abs=COUNT_V)
