"""What an arm is made of: one TOML, read once, into one frozen :class:`ArmParameters`.

Lives here: the parameters, their physical limits, and the cross-checks between them. Does not live here: the
equations that use them (``dynamics.c``) or what changes during a run (``conditions``). The commented example
is ``arm.toml``; keys carry their units.

The rigid body is a cylindrical arm, eq. (1) of the paper as Lagrange's equations give it. With h the height,
r the reach of the horizontal link (m2), theta the turn, and a payload mp at r + d:

    (m1 + m2 + mp) (h'' + g)                                                    = f2
    (m2 + mp) r'' - (m2 r + mp (r + d)) theta'^2                                = f3
    (J + m2 r^2 + mp (r + d)^2) theta'' + 2 (m2 r + mp (r + d)) r' theta'       = n1

Eq. (1) as printed has gravity as (m1 + m2) g h, an energy in a row of forces, and 2 m2 r theta' where the
Coriolis torque is 2 m2 r r' theta'.
"""

from __future__ import annotations

import math
from importlib import resources
from typing import Annotated

import msgspec

from hil.core.documents import Document, from_toml
from hil.core.errors import DocumentError

AXES = ("vertical", "horizontal", "rotation")
"""In the order of the boards' channels 1, 2, 3."""

GRAVITY_M_S2 = 9.80665
GAS_J_KG_K = 287.05
HEAT_RATIO = 1.4


def _between(low: float, high: float) -> msgspec.Meta:
    return msgspec.Meta(ge=low, le=high)


class Body(Document, frozen=True):
    """The rigid bodies of eq. (1)."""

    vertical_kg: Annotated[float, _between(0.01, 1000.0)]
    """m1: carriage of the vertical axis without the horizontal link."""
    horizontal_kg: Annotated[float, _between(0.01, 1000.0)]
    """m2: the horizontal link."""
    base_kg_m2: Annotated[float, _between(1e-4, 1000.0)]
    """J: what turns, without the horizontal link."""
    reach_m: Annotated[float, _between(0.0, 10.0)]
    """r at mid-stroke of the horizontal axis."""
    tip_m: Annotated[float, _between(0.0, 10.0)]
    """d, from the centre of mass of the horizontal link out to the payload."""
    pulley_m: Annotated[float, _between(1e-3, 1.0)]
    """Radius at which the rotation's cylinder turns the arm."""


class Supply(Document, frozen=True):
    """Compressed air: a regulator that fills a volume shared by the three valves."""

    gauge_kpa: Annotated[float, _between(0.0, 1000.0)]
    atmosphere_kpa: Annotated[float, _between(50.0, 120.0)]
    temperature_c: Annotated[float, _between(-20.0, 60.0)]
    volume_m3: Annotated[float, _between(1e-5, 1.0)]
    droop_kpa_s_kg: Annotated[float, _between(1.0, 1e6)]
    """How far the regulator's pressure sinks for a mass flow of 1 kg/s."""
    max_flow_kg_s: Annotated[float, _between(1e-5, 10.0)]
    max_relief_kg_s: Annotated[float, _between(0.0, 10.0)]
    """Most that the regulator lets out when the volume is above its setting."""


class Cylinder(Document, frozen=True):
    """A rodless double-acting cylinder with its tubes."""

    bore_m: Annotated[float, _between(1e-4, 0.5)]
    stroke_m: Annotated[float, _between(1e-3, 5.0)]
    dead_volume_m3: Annotated[float, _between(1e-7, 0.1)]
    """At each end, tube included."""
    tube_m: Annotated[float, _between(0.0, 50.0)]
    """Length from valve to cylinder; sound takes that long to bring a change of flow."""
    heat_w_k: Annotated[float, _between(0.0, 1000.0)]
    """Heat from the walls into each chamber for a kelvin of difference."""

    @property
    def area_m2(self) -> float:
        """Piston area."""
        return 0.25 * math.pi * self.bore_m**2


class Valve(Document, frozen=True):
    """A 5/3-way proportional valve: a spool with four edges. Its lengths are fractions of full travel."""

    centre_v: Annotated[float, _between(4.0, 6.0)]
    """Voltage at which the spool stands in the middle."""
    hysteresis_v: Annotated[float, _between(0.0, 1.0)]
    """Half the width of the play between command and spool."""
    spool_hz: Annotated[float, _between(1.0, 500.0)]
    spool_damping: Annotated[float, _between(0.05, 10.0)]
    conductance_m3_s_pa: Annotated[float, _between(0.0, 1e-5)]
    """ISO 6358 sonic conductance C of one edge, fully open, valve and tube together."""
    critical_ratio: Annotated[float, _between(0.0, 0.98)]
    """ISO 6358 b: the flow is choked under this ratio of pressures."""
    overlap: Annotated[float, _between(-0.5, 0.9)]
    """How far the spool moves before an edge opens; negative when edges are open at the centre."""
    clearance: Annotated[float, _between(0.0, 1.0)]
    """Rounds the opening and leaves a leak around the centre: C(x) = C ((x-d) + sqrt((x-d)^2 + w^2)) / 2."""


class Friction(Document, frozen=True):
    """LuGre friction at the cylinder: F = s0 z + s1 z' + s2 v, z' = v - s0 |v| z / g(v)."""

    coulomb_n: Annotated[float, _between(1e-6, 1e4)]
    static_n: Annotated[float, _between(1e-6, 1e4)]
    stribeck_m_s: Annotated[float, _between(1e-4, 1.0)]
    """g(v) = coulomb + (static - coulomb) / (1 + (v/stribeck)^2)."""
    bristle_n_m: Annotated[float, _between(0.0, 1e7)]
    bristle_n_s_m: Annotated[float, _between(0.0, 1e5)]
    viscous_n_s_m: Annotated[float, _between(0.0, 1e5)]
    per_moment_1_n_m: Annotated[float, _between(0.0, 10.0)]
    """Share by which coulomb, static and bristle stiffness rise for a newton metre of moment on the guides,
    over that at mid-reach without payload."""


class Spring(Document, frozen=True):
    """Counterbalance, hoses, cable chain: force = centre_n - rate_n_m x."""

    rate_n_m: Annotated[float, _between(0.0, 1e6)]
    centre_n: Annotated[float, _between(-1e4, 1e4)]


class Stop(Document, frozen=True):
    """End stops: force = stiffness x depth x (1 + damping x velocity), and never a pull."""

    stiffness_n_m: Annotated[float, _between(1e3, 1e8)]
    damping_s_m: Annotated[float, _between(0.0, 100.0)]


class Potentiometer(Document, frozen=True):
    """The sensor as it is; the rig file has the gateway's idea of it."""

    y_at_0v: Annotated[float, _between(-100.0, 100.0)]
    y_at_10v: Annotated[float, _between(-100.0, 100.0)]
    noise_v: Annotated[float, _between(0.0, 1.0)]
    """Standard deviation of the white noise on a reading."""
    nonlinearity: Annotated[float, _between(-0.05, 0.05)]
    """Largest departure from the straight line, a fraction of the span: an S through ends and middle."""


class ArmAxis(Document, frozen=True):
    """One axis, in its cylinder's coordinate: metres and newtons, for the rotation too."""

    cylinder: Cylinder
    valve: Valve
    friction: Friction
    spring: Spring
    stop: Stop
    potentiometer: Potentiometer


class ArmAxes(Document, frozen=True):
    """The three axes, by name."""

    vertical: ArmAxis
    horizontal: ArmAxis
    rotation: ArmAxis


class ArmParameters(Document, frozen=True):
    """The whole arm file."""

    step_s: Annotated[float, _between(1e-6, 1e-3)]
    """Longest step of the integration."""
    body: Body
    supply: Supply
    axes: ArmAxes

    @property
    def ordered(self) -> tuple[ArmAxis, ArmAxis, ArmAxis]:
        """The axes in the order of :data:`AXES`."""
        return self.axes.vertical, self.axes.horizontal, self.axes.rotation

    @property
    def travel(self) -> tuple[float, float, float]:
        """Travel in the axis' unit for a metre of the cylinder: 1 m, 1 m, 1/pulley rad."""
        return 1.0, 1.0, 1.0 / self.body.pulley_m

    @property
    def least_masses_kg(self) -> tuple[float, float, float]:
        """What each cylinder moves at least: without payload, the rotation's without the horizontal link."""
        body = self.body
        return (
            body.vertical_kg + body.horizontal_kg,
            body.horizontal_kg,
            body.base_kg_m2 / body.pulley_m**2,
        )


def read_arm(text: str, source: str) -> ArmParameters:
    """Read and check the TOML text of an arm file; ``source`` is its name for errors.

    Raises DocumentError naming key, value and limit of whatever physics does not allow.
    """
    arm = from_toml(text, ArmParameters, source)
    _check_reach(arm, source)
    for name, axis, travel, mass_kg in zip(AXES, arm.ordered, arm.travel, arm.least_masses_kg, strict=True):
        where = f"{source}: axes.{name}"
        _check_friction(axis.friction, f"{where}.friction")
        _check_load(axis.friction, arm, f"{where}.friction")
        _check_sensor(axis, travel, f"{where}.potentiometer")
        _check_stop(axis, arm.supply, f"{where}.stop")
        _check_step(axis, mass_kg, arm.step_s, f"{where}.stop")
    return arm


def shipped_arm() -> ArmParameters:
    """The paper's arm, ``arm.toml``."""
    return read_arm(shipped_arm_text(), "arm.toml")


def shipped_arm_text() -> str:
    """The text of ``arm.toml``."""
    return (resources.files(__package__) / "arm.toml").read_text(encoding="utf-8")


def absolute_pa(gauge_kpa: float, supply: Supply) -> float:
    """Absolute pressure in Pa of a gauge pressure in kPa."""
    return 1e3 * (gauge_kpa + supply.atmosphere_kpa)


def kelvin(celsius: float) -> float:
    """Absolute temperature."""
    return celsius + 273.15


def _check_reach(arm: ArmParameters, source: str) -> None:
    least = 0.5 * arm.axes.horizontal.cylinder.stroke_m
    if arm.body.reach_m < least:
        raise DocumentError(
            f"{source}: body.reach_m: {arm.body.reach_m} m is under {least} m, half of the horizontal "
            "cylinder.stroke_m: the link would pass through the axis of rotation"
        )


def _check_friction(friction: Friction, where: str) -> None:
    if friction.static_n < friction.coulomb_n:
        raise DocumentError(
            f"{where}.static_n: {friction.static_n} N is under coulomb_n, {friction.coulomb_n} N"
        )
    # Barabanov and Ortega, IEEE TAC 45 (2000): LuGre friction never gives energy if and only if this holds.
    most = friction.viscous_n_s_m / max(friction.static_n / friction.coulomb_n - 1.0, 1e-12)
    if friction.bristle_n_s_m > most:
        raise DocumentError(
            f"{where}.bristle_n_s_m: {friction.bristle_n_s_m} N s/m exceeds {most:.4g} N s/m "
            "(viscous_n_s_m / (static_n / coulomb_n - 1)): such friction would give energy"
        )


def _check_sensor(axis: ArmAxis, travel: float, where: str) -> None:
    low, high = sorted((axis.potentiometer.y_at_0v, axis.potentiometer.y_at_10v))
    end = 0.5 * axis.cylinder.stroke_m * travel
    if low > -end or high < end:
        raise DocumentError(
            f"{where}: its track from {low} to {high} does not cover the stroke, {-end:.4g} to {end:.4g} "
            "(cylinder.stroke_m, for the rotation over body.pulley_m)"
        )


def _check_stop(axis: ArmAxis, supply: Supply, where: str) -> None:
    area = axis.cylinder.area_m2
    least = area**2 * 1e3 * supply.gauge_kpa / axis.cylinder.dead_volume_m3
    if axis.stop.stiffness_n_m < least:
        raise DocumentError(
            f"{where}.stiffness_n_m: {axis.stop.stiffness_n_m} N/m is under {least:.4g} N/m: at "
            f"supply.gauge_kpa {supply.gauge_kpa} kPa the piston would use up cylinder.dead_volume_m3"
        )


def _check_step(axis: ArmAxis, mass_kg: float, step_s: float, where: str) -> None:
    most = mass_kg / step_s**2 - axis.spring.rate_n_m
    if axis.stop.stiffness_n_m > most:
        raise DocumentError(
            f"{where}.stiffness_n_m: {axis.stop.stiffness_n_m} N/m exceeds {most:.4g} N/m, the stiffest that "
            f"step_s {step_s} s can follow with {mass_kg:.4g} kg"
        )


def _check_load(friction: Friction, arm: ArmParameters, where: str) -> None:
    relief_n_m = GRAVITY_M_S2 * arm.body.horizontal_kg * 0.5 * arm.axes.horizontal.cylinder.stroke_m
    if friction.per_moment_1_n_m * relief_n_m >= 1.0:
        raise DocumentError(
            f"{where}.per_moment_1_n_m: {friction.per_moment_1_n_m} exceeds {1.0 / relief_n_m:.4g}: with the "
            "horizontal link drawn in, dry friction would be negative"
        )
