"""Eq. (2), with and without its two further terms, against the numerically linearised dynamics."""

import ctypes

import numpy as np
import pytest
from numpy.typing import NDArray
from support.arm_files import FRICTIONLESS, arm_with

from firmware_sim.arm import native
from firmware_sim.arm.arm import Arm
from firmware_sim.arm.linearisation import linearise
from firmware_sim.arm.parameters import AXES, ArmParameters


@pytest.mark.parametrize("axis", range(3), ids=AXES)
def test_an_arm_without_leak_and_spring_responds_as_equation_2(axis: int) -> None:
    """Without leak, spring and heat the numerically linearised dynamics are those of eq. (2)."""
    ideal = {"axes.*.valve.clearance": 1e-3, "axes.*.spring.rate_n_m": 0.0, "axes.*.cylinder.heat_w_k": 0.0}
    linear = linearise(_smooth(ideal), axis)
    for w in (0.3, 1.0, 3.0, 10.0, 30.0):
        assert _response(_smooth(ideal), axis, w) == pytest.approx(linear.equation_2(1j * w), rel=0.01)


@pytest.mark.parametrize("axis", range(3), ids=AXES)
def test_the_shipped_arm_responds_as_equation_2_with_leak_and_spring(axis: int) -> None:
    """The calibrated arm, with heat through its walls, is within 15 % of eq. (2) with leak and spring."""
    linear = linearise(_smooth({}), axis)
    for w in (0.05, 0.3, 1.0, 5.0):
        assert _response(_smooth({}), axis, w) == pytest.approx(linear.with_leak_and_spring(1j * w), rel=0.15)
        assert abs(_response(_smooth({}), axis, w)) < 0.75 * abs(linear.equation_2(1j * w))


def _smooth(changes: dict[str, float]) -> ArmParameters:
    """Return an arm without dry friction, which has no derivative at rest."""
    viscous = {key: value for key, value in FRICTIONLESS.items() if "viscous" not in key}
    return arm_with(viscous | {"axes.vertical.spring.centre_n": 10.0 * 9.80665} | changes)


def _response(parameters: ArmParameters, axis: int, w: float) -> complex:
    """Return the response from valve voltage to position at ``w`` rad/s, by central differences."""
    arm = Arm(parameters, seed=1)
    for number, (part, state) in enumerate(zip(parameters.ordered, arm.state.axis, strict=True)):
        pressure_pa = linearise(parameters, number).pressure_pa
        state.position_m = state.velocity_m_s = state.spool = state.spool_rate_1_s = 0.0
        volume_m3 = part.cylinder.dead_volume_m3 + 0.5 * part.cylinder.area_m2 * part.cylinder.stroke_m
        for chamber in range(2):
            state.pressure_pa[chamber] = pressure_pa
            state.air_kg[chamber] = pressure_pa * volume_m3 / (287.05 * 293.15)
        arm.conditions.axis[number].spool_free = 0.0
    arm.state.supply_pa = arm.conditions.regulator_pa
    rest = np.frombuffer(bytes(arm.state))
    packed, dynamics, dt = native.pack(parameters), native.Dynamics(), 1e-6
    names = [9 * axis + k for k in (2, 3, 5, 6, 7, 8)]
    nudges = (1e-5, 1e-4, 10.0, 10.0, 1e-8, 1e-8)

    def rates(index: int, nudge: float) -> NDArray[np.float64]:
        moved = rest.copy()
        moved[index] += nudge
        state = native.ArmState.from_buffer_copy(moved.tobytes())
        arguments = (ctypes.byref(part) for part in (packed, arm.conditions, state))
        assert dynamics.advance(*arguments, dt, 1) == 0
        return np.asarray((np.frombuffer(bytes(state)) - moved)[names] / dt)

    def slope(index: int, nudge: float) -> NDArray[np.float64]:
        return (rates(index, nudge) - rates(index, -nudge)) / (2.0 * nudge)

    A = np.column_stack([slope(index, nudge) for index, nudge in zip(names, nudges, strict=True)])
    b = slope(9 * axis, 1e-4) / 5.0
    return complex(np.linalg.solve(1j * w * np.eye(6) - A, b)[0]) * parameters.travel[axis]
