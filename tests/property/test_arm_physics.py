"""Properties of every arm: air and energy are conserved, and no parameters or commands give a NaN."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.arm_files import AIRLESS, FRICTIONLESS, LIMITS, SEALED, arm_text, arm_with
from support.constants import CENTRED

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.arm_file import read_arm
from firmware_sim.arm.events import (
    AnyEvent,
    FrictionFactor,
    Leak,
    Payload,
    StuckSpool,
    SupplyPressure,
    Temperature,
)
from firmware_sim.arm.parameters import AXES, GRAVITY_M_S2, ArmParameters
from hil.core.errors import DocumentError, SimulationError

MILLISECOND_NS = 1_000_000
volts = st.floats(0.0, 10.0)
commands = st.lists(st.tuples(volts, volts, volts), min_size=1, max_size=8)
quick = settings(max_examples=25, deadline=None)


def volumes_m3(arm: Arm) -> list[list[float]]:
    return [
        [
            axis.cylinder.dead_volume_m3
            + axis.cylinder.area_m2 * (0.5 * axis.cylinder.stroke_m + sign * state.position_m)
            for sign in (1.0, -1.0)
        ]
        for axis, state in zip(arm.parameters.ordered, arm.state.axis, strict=True)
    ]


def air_in_the_machine_kg(arm: Arm) -> float:
    tank = arm.state.supply_pa * arm.parameters.supply.volume_m3 / (287.05 * arm.conditions.air_k)
    return tank + sum(sum(axis.air_kg) for axis in arm.state.axis)


@quick
@given(commands=commands, leak=st.floats(0.0, 1e-6), payload_kg=st.floats(0.0, 5.0))
def test_air_is_conserved(commands: list[tuple[float, float, float]], leak: float, payload_kg: float) -> None:
    arm = Arm(arm_with({}), seed=1)
    arm.apply(Leak(at_s=0.0, axis="horizontal", chamber=2, conductance_m3_s_pa=leak))
    arm.apply(Payload(at_s=0.0, mass_kg=payload_kg))
    before = air_in_the_machine_kg(arm) - arm.state.supplied_kg + arm.state.exhausted_kg
    for command in commands:
        arm.advance(50 * MILLISECOND_NS, command)
    after = air_in_the_machine_kg(arm) - arm.state.supplied_kg + arm.state.exhausted_kg
    assert after == pytest.approx(before, rel=1e-11)
    assert arm.state.exhausted_kg > 0.0


def extreme(low: float, high: float) -> st.SearchStrategy[float]:
    """Draw the limits, values between them, and values of small magnitude."""
    small = st.floats(-9.0, 0.0).map(lambda exponent: max(low, high * 10.0**exponent))
    return st.sampled_from((low, high)) | st.floats(low, high) | small


events = st.one_of(
    st.builds(Payload, at_s=st.just(0.0), mass_kg=extreme(0.0, 100.0)),
    st.builds(SupplyPressure, at_s=st.just(0.0), gauge_kpa=extreme(0.0, 1000.0)),
    st.builds(Temperature, at_s=st.just(0.0), celsius=extreme(-20.0, 60.0)),
    st.builds(
        FrictionFactor, at_s=st.just(0.0), axis=st.sampled_from(AXES), factor=extreme(0.0, 20.0)
    ),
    st.builds(
        Leak,
        at_s=st.just(0.0),
        axis=st.sampled_from(AXES),
        chamber=st.sampled_from((1, 2)),
        conductance_m3_s_pa=extreme(0.0, 1e-6),
    ),
    st.builds(StuckSpool, at_s=st.just(0.0), axis=st.sampled_from(AXES), stuck=st.booleans()),
)  # fmt: skip
hard = st.sampled_from((0.0, 5.0, 10.0)) | volts
spans_ms = st.sampled_from((1, 11, 100, 700))


@settings(max_examples=150, deadline=None)
@given(steps=st.lists(st.tuples(events, st.tuples(hard, hard, hard), spans_ms), min_size=1, max_size=12))
def test_the_arm_survives_every_event_within_its_limits(
    steps: list[tuple[AnyEvent, tuple[float, float, float], int]],
) -> None:
    arm = Arm(arm_with({}), seed=1)
    for event, command, span_ms in steps:
        arm.apply(event)
        arm.advance(span_ms * MILLISECOND_NS, command)  # raises SimulationError if the arm diverges
        assert all(0.0 <= reading <= 10.0 for reading in arm.potentiometer_v())
        coldest, hottest = 80.0, 2000.0
        for axis, volumes in zip(arm.state.axis, volumes_m3(arm), strict=True):
            for pressure, volume, air in zip(axis.pressure_pa, volumes, axis.air_kg, strict=True):
                assert coldest < pressure * volume / (air * 287.05) < hottest


keys = st.sampled_from(sorted(key for key in LIMITS if key != "step_s"))


@settings(max_examples=150, deadline=None)
@given(data=st.data(), commands=st.lists(st.tuples(hard, hard, hard), min_size=1, max_size=4))
def test_an_arm_file_within_its_limits_runs_or_is_rejected_with_a_message(
    data: st.DataObject, commands: list[tuple[float, float, float]]
) -> None:
    """A file is rejected with a message or runs. A run that diverges ends with a message, not with NaN."""
    values = {
        key: data.draw(extreme(*LIMITS[key]), key)
        for key in data.draw(st.lists(keys, min_size=1, max_size=5))
    }
    try:
        parameters = read_arm(arm_text(arm_with(values)), "mine.toml")
    except DocumentError as error:
        assert str(error).startswith("mine.toml: ")
        return
    try:
        arm = Arm(parameters, seed=1)
        for command in commands:
            arm.advance(100 * MILLISECOND_NS, command)
            assert all(0.0 <= reading <= 10.0 for reading in arm.potentiometer_v())
            assert all(math.isfinite(axis.position + axis.velocity) for axis in arm.view().axes)
    except SimulationError as error:
        assert "diverged" in str(error)


@quick
@given(speeds=st.tuples(*3 * [st.floats(-1.0, 1.0)]), payload_kg=st.floats(0.0, 5.0))
def test_a_closed_chamber_keeps_its_air(speeds: tuple[float, float, float], payload_kg: float) -> None:
    arm = Arm(arm_with(SEALED), seed=1)
    arm.apply(Payload(at_s=0.0, mass_kg=payload_kg))
    for axis, speed in zip(arm.state.axis, speeds, strict=True):
        axis.velocity_m_s = speed
    air = [tuple(axis.air_kg) for axis in arm.state.axis]
    moved = [0.0, 0.0, 0.0]
    for _ in range(100):
        arm.advance(5 * MILLISECOND_NS, CENTRED)
        moved = [max(far, abs(axis.position_m)) for far, axis in zip(moved, arm.state.axis, strict=True)]
    assert [tuple(axis.air_kg) for axis in arm.state.axis] == air
    assert all(far >= 1e-3 * abs(speed) for far, speed in zip(moved, speeds, strict=True))


@pytest.mark.parametrize(("heat_w_k", "exponent", "tolerance"), [(0.0, 1.4, 1e-3), (1000.0, 1.0, 1e-3)])
def test_closed_chambers_are_isentropic_without_heat_and_isothermal_with_much(
    heat_w_k: float, exponent: float, tolerance: float
) -> None:
    arm = Arm(arm_with(SEALED | {"axes.*.cylinder.heat_w_k": heat_w_k, "step_s": 1e-4}), seed=1)
    arm.state.axis[1].velocity_m_s = 2.0
    invariant = arm.state.axis[1].pressure_pa[0] * volumes_m3(arm)[1][0] ** exponent
    widest = 0.0
    for _ in range(200):
        arm.advance(MILLISECOND_NS, CENTRED)
        now = arm.state.axis[1].pressure_pa[0] * volumes_m3(arm)[1][0] ** exponent
        assert now == pytest.approx(invariant, rel=tolerance)
        widest = max(widest, abs(arm.state.axis[1].position_m))
    assert widest > 0.03


@quick
@given(commands=commands)
def test_without_pressure_nothing_moves(commands: list[tuple[float, float, float]]) -> None:
    arm = Arm(arm_with({"supply.gauge_kpa": 0.0}), seed=1)
    start = [axis.position_m for axis in arm.state.axis]
    for command in commands:
        arm.advance(100 * MILLISECOND_NS, command)
    assert [axis.position_m for axis in arm.state.axis] == pytest.approx(start, abs=1e-6)


def energy_j(arm: Arm) -> float:
    """Return the energy of bodies, springs and gravity."""
    parameters, (vertical, horizontal, rotation) = arm.parameters, arm.state.axis
    body, payload_kg = parameters.body, arm.conditions.payload_kg
    reach_m = body.reach_m + horizontal.position_m
    lifted_kg = body.vertical_kg + body.horizontal_kg + payload_kg
    extended_kg = body.horizontal_kg + payload_kg
    turned_kg_m2 = (
        body.base_kg_m2 + body.horizontal_kg * reach_m**2 + payload_kg * (reach_m + body.tip_m) ** 2
    )
    springs = sum(
        0.5 * axis.spring.rate_n_m * state.position_m**2 - axis.spring.centre_n * state.position_m
        for axis, state in zip(parameters.ordered, arm.state.axis, strict=True)
    )
    return (
        0.5 * lifted_kg * vertical.velocity_m_s**2
        + 0.5 * extended_kg * horizontal.velocity_m_s**2
        + 0.5 * turned_kg_m2 * (rotation.velocity_m_s / body.pulley_m) ** 2
        + lifted_kg * GRAVITY_M_S2 * vertical.position_m
        + springs
    )


def angular_momentum_kg_m2_s(arm: Arm) -> float:
    body, payload_kg = arm.parameters.body, arm.conditions.payload_kg
    reach_m = body.reach_m + arm.state.axis[1].position_m
    inertia = body.base_kg_m2 + body.horizontal_kg * reach_m**2 + payload_kg * (reach_m + body.tip_m) ** 2
    return float(inertia * arm.state.axis[2].velocity_m_s / body.pulley_m)


@quick
@given(
    speeds=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.5, 0.5), st.floats(-0.25, 0.25)),
    payload_kg=st.floats(0.0, 5.0),
)
def test_bodies_without_air_and_friction_conserve_energy_and_angular_momentum(
    speeds: tuple[float, float, float], payload_kg: float
) -> None:
    free = FRICTIONLESS | AIRLESS | {"axes.rotation.spring.rate_n_m": 0.0, "step_s": 1e-4}
    arm = Arm(arm_with(free), seed=1)
    arm.apply(Payload(at_s=0.0, mass_kg=payload_kg))
    arm.state.axis[0].position_m = 0.0
    for axis, speed in zip(arm.state.axis, speeds, strict=True):
        axis.velocity_m_s = speed
    energy, momentum = energy_j(arm), angular_momentum_kg_m2_s(arm)
    scale = max(abs(energy), 0.1)
    for _ in range(40):
        arm.advance(5 * MILLISECOND_NS, CENTRED)
        assert energy_j(arm) == pytest.approx(energy, abs=2e-3 * scale)
        assert angular_momentum_kg_m2_s(arm) == pytest.approx(momentum, abs=1e-3 * max(abs(momentum), 1e-3))


@settings(max_examples=60, deadline=None)
@given(
    coulomb_n=st.floats(0.1, 20.0),
    stick=st.floats(1.0, 3.0),
    stribeck_m_s=st.floats(1e-3, 0.1),
    bristle_n_m=st.floats(1e3, 1e6),
    viscous_n_s_m=st.floats(0.1, 300.0),
    share=st.floats(0.0, 1.0),
    speed=st.floats(-2.0, 2.0),
    stretch=st.floats(-1.0, 1.0),
)
def test_friction_never_generates_energy(
    coulomb_n: float,
    stick: float,
    stribeck_m_s: float,
    bristle_n_m: float,
    viscous_n_s_m: float,
    share: float,
    speed: float,
    stretch: float,
) -> None:
    arm = Arm(_only_friction(coulomb_n, stick, stribeck_m_s, bristle_n_m, viscous_n_s_m, share), seed=1)
    axis = arm.state.axis[1]
    axis.velocity_m_s, axis.bristle_m = speed, stretch * coulomb_n / bristle_n_m
    mass_kg = arm.parameters.body.horizontal_kg
    stored = 0.5 * mass_kg * speed**2 + 0.5 * bristle_n_m * axis.bristle_m**2
    for _ in range(100):
        arm.advance(MILLISECOND_NS // 4, CENTRED)
        now = 0.5 * mass_kg * axis.velocity_m_s**2 + 0.5 * bristle_n_m * axis.bristle_m**2
        assert now <= stored * (1.0 + 1e-4) + 1e-9
        stored = now


def _only_friction(
    coulomb_n: float,
    stick: float,
    stribeck_m_s: float,
    bristle_n_m: float,
    viscous_n_s_m: float,
    share: float,
) -> ArmParameters:
    """Return an arm on whose horizontal axis only friction acts.

    ``share`` is the bristle's damping as a fraction of its limit.
    """
    max_damping = min(viscous_n_s_m / max(stick - 1.0, 1e-9), 1e4)
    friction = {
        "coulomb_n": coulomb_n,
        "static_n": stick * coulomb_n,
        "stribeck_m_s": stribeck_m_s,
        "bristle_n_m": bristle_n_m,
        "bristle_n_s_m": share * max_damping,
        "viscous_n_s_m": viscous_n_s_m,
        "per_moment_1_n_m": 0.0,
    }
    changes = {f"axes.horizontal.friction.{key}": value for key, value in friction.items()}
    return arm_with(
        AIRLESS
        | changes
        | {"axes.horizontal.spring.rate_n_m": 0.0, "axes.horizontal.cylinder.stroke_m": 5.0, "step_s": 1e-4}
    )


@quick
@given(speed=st.floats(-3.0, 3.0), depth_m=st.floats(1e-4, 2e-3), side=st.sampled_from([-1.0, 1.0]))
def test_a_stop_pushes_and_never_pulls(speed: float, depth_m: float, side: float) -> None:
    arm = Arm(arm_with(FRICTIONLESS | AIRLESS | {"axes.horizontal.spring.rate_n_m": 0.0}), seed=1)
    axis = arm.state.axis[1]
    axis.position_m, axis.velocity_m_s = side * (0.15 + depth_m), side * speed
    away = -side * axis.velocity_m_s
    while side * axis.position_m > 0.15:
        arm.advance(MILLISECOND_NS // 4, CENTRED)
        assert -side * axis.velocity_m_s >= away - 1e-6
        away = -side * axis.velocity_m_s
    assert away > 0.0


def test_air_in_the_cylinders_takes_the_temperature_of_its_surroundings() -> None:
    arm = Arm(arm_with({}), seed=1)
    arm.apply(Temperature(at_s=0.0, celsius=40.0))
    arm.advance(5_000 * MILLISECOND_NS, CENTRED)
    for axis, volumes in zip(arm.state.axis, volumes_m3(arm), strict=True):
        for pressure, volume, air in zip(axis.pressure_pa, volumes, axis.air_kg, strict=True):
            assert pressure * volume / (air * 287.05) == pytest.approx(313.15, abs=0.5)
