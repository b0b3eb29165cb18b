"""The envelope in the gateway: what a start refuses and warns of, and what a violation does."""

from __future__ import annotations

import pytest
from support.constants import CENTRED
from support.gateway_bench import (
    SteppedGateway,
    commands,
    faults,
    make_gateway,
    make_rig,
    make_stepped,
    texts,
)

from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Severity


def armed(setpoint: str, envelope: str = "") -> SteppedGateway:
    rig = make_rig(axes=("vertical",), envelope=envelope)
    return SteppedGateway(rig, make_gateway(rig, setpoints=setpoint)).bring_to(LifeCycleState.ARMED)


def volts_at(position: float) -> tuple[float, float, float]:
    return (5.0 + position / 0.033, 5.0, 5.0)


class TestStart:
    @pytest.mark.parametrize(("setpoint", "is_refused"), [("step:0.049@0", False), ("step:0.051@0", True)])
    def test_a_first_setpoint_far_from_the_position_is_refused(self, setpoint: str, is_refused: bool) -> None:
        gateway = armed(setpoint, "max_error = 0.05")
        output = gateway.operate(Trigger.START)
        assert (gateway.state is LifeCycleState.ARMED) is is_refused
        assert any("start refused" in text for text in texts(output)) is is_refused
        assert {entry.severity for entry in output.log} == {Severity.WARNING if is_refused else Severity.INFO}

    def test_after_a_refusal_the_valves_stay_centred_and_a_good_position_starts(self) -> None:
        gateway = armed("step:0.1@0", "max_error = 0.05")
        gateway.operate(Trigger.START)
        gateway.periods(3)
        assert set(gateway.transcript.commands()) == {CENTRED}
        gateway.period(volts_at(0.06))
        gateway.operate(Trigger.START)
        assert gateway.state is LifeCycleState.RUNNING

    def test_a_setpoint_that_holds_the_position_starts_anywhere_inside(self) -> None:
        gateway = armed("hold")
        gateway.period(volts_at(-0.14))
        gateway.operate(Trigger.START)
        assert gateway.state is LifeCycleState.RUNNING

    def test_a_position_beyond_a_soft_end_stop_is_refused(self) -> None:
        gateway = armed("hold", "max_y = 0.155")
        gateway.period(volts_at(0.158))
        (said,) = texts(gateway.operate(Trigger.START))
        assert said.startswith("vertical: start refused: position 0.158 m is above the upper soft end stop")
        assert gateway.state is LifeCycleState.ARMED

    def test_disabled_checks_are_a_warning_of_each_start(self) -> None:
        gateway = armed("hold", 'disabled = ["max_speed", "max_error"]')
        said = "vertical: not protected by max_speed, max_error (rig: axes.vertical.envelope.disabled)"
        assert texts(gateway.operate(Trigger.START))[1:] == [said]
        gateway.operate(Trigger.STOP)
        assert texts(gateway.operate(Trigger.START))[1:] == [said]

    def test_a_valve_that_cannot_be_far_open_is_a_warning_of_the_start(self) -> None:
        gateway = make_stepped(LifeCycleState.ARMED, axes__vertical__valve__max_v="5.5")
        (said,) = texts(gateway.operate(Trigger.START))[1:]
        assert said == (
            "vertical: not protected by max_still_s, because the valve opens by 0.5 V (rig: "
            "axes.vertical.valve) and is far open from 3 V on; give axes.vertical.envelope.far_open_v"
        )


class TestViolation:
    def test_a_position_beyond_a_soft_end_stop_centres_the_valves_at_once(self) -> None:
        gateway = armed("hold", 'max_y = 0.155\ndisabled = ["max_speed"]')
        gateway.operate(Trigger.START)
        gateway.period(volts_at(0.1549))
        assert gateway.state is LifeCycleState.RUNNING
        output = gateway.period(volts_at(0.1551))
        assert faults(output) == [
            "vertical: position 0.1551 m is above the upper soft end stop 0.155 m "
            "(rig: axes.vertical.envelope.max_y)"
        ]
        assert commands(output) == [CENTRED]
        assert gateway.state is LifeCycleState.FAULT
        assert output.cycle is not None
        assert (output.cycle.fresh, output.cycle.state) == (True, LifeCycleState.FAULT)
        assert output.cycle.axes[0].position == pytest.approx(0.1551, abs=2e-5)
        assert output.cycle.axes[0].command_v == 5.0

    def test_the_signals_of_every_axis_are_those_of_the_sample_that_faults(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.periods(6)
        output = gateway.period((9.5, 5.5, 5.5))
        assert gateway.state is LifeCycleState.FAULT
        assert output.cycle is not None
        assert [axis.potentiometer_v for axis in output.cycle.axes] == pytest.approx(
            (9.5, 5.5, 5.5), abs=1e-3
        )

    def test_after_a_reset_the_envelope_begins_again(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.periods(6)
        gateway.period((9.0, 5.0, 5.0))
        assert gateway.state is LifeCycleState.FAULT
        gateway.operate(Trigger.RESET)
        gateway.bring_to(LifeCycleState.RUNNING)
        gateway.periods(6)
        assert gateway.state is LifeCycleState.RUNNING
