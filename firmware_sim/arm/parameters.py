"""Parameters of the simulated arm: the typed documents that an arm file consists of, with their limits.

``arm_file`` reads an arm file and checks its parameters against each other. ``dynamics.c`` has the equations
that use them. The commented example is ``arm.toml``. The name of each key ends with its unit.

The rigid body is a cylindrical arm: eq. (1) of the paper, derived from Lagrange's equations. With the height
h, the reach r of the horizontal link (mass m2), the angle theta, and a payload mp at r + d:

    (m1 + m2 + mp) (h'' + g)                                                    = f2
    (m2 + mp) r'' - (m2 r + mp (r + d)) theta'^2                                = f3
    (J + m2 r^2 + mp (r + d)^2) theta'' + 2 (m2 r + mp (r + d)) r' theta'       = n1

Eq. (1) as printed in the paper has two misprints: gravity is (m1 + m2) g h, which is an energy and not a
force, and the Coriolis torque is 2 m2 r theta', which lacks the factor r'.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec

from hil.core.documents import Document

AXES = ("vertical", "horizontal", "rotation")
"""Names of the axes in the order of the boards' channels 1, 2, 3."""

GRAVITY_M_S2 = 9.80665
GAS_J_KG_K = 287.05
HEAT_RATIO = 1.4


def _between(low: float, high: float) -> msgspec.Meta:
    return msgspec.Meta(ge=low, le=high)


class Body(Document, frozen=True):
    """Rigid bodies of eq. (1)."""

    vertical_kg: Annotated[float, _between(0.01, 1000.0)]
    """Mass m1 of the vertical axis' carriage, without the horizontal link."""
    horizontal_kg: Annotated[float, _between(0.01, 1000.0)]
    """Mass m2 of the horizontal link."""
    base_kg_m2: Annotated[float, _between(1e-4, 1000.0)]
    """Moment of inertia J of all turning parts except the horizontal link."""
    reach_m: Annotated[float, _between(0.0, 10.0)]
    """Reach r of the horizontal link's centre of mass at mid-stroke."""
    tip_m: Annotated[float, _between(0.0, 10.0)]
    """Distance d from the centre of mass of the horizontal link to the payload."""
    pulley_m: Annotated[float, _between(1e-3, 1.0)]
    """Radius of the pulley over which the rotation's cylinder turns the arm."""


class Supply(Document, frozen=True):
    """Compressed air supply: a regulator that fills a volume, from which all three valves are fed."""

    gauge_kpa: Annotated[float, _between(0.0, 1000.0)]
    atmosphere_kpa: Annotated[float, _between(50.0, 120.0)]
    temperature_c: Annotated[float, _between(-20.0, 60.0)]
    volume_m3: Annotated[float, _between(1e-5, 1.0)]
    droop_kpa_s_kg: Annotated[float, _between(1.0, 1e6)]
    """Drop of the regulator's pressure per mass flow, in kPa per kg/s."""
    max_flow_kg_s: Annotated[float, _between(1e-5, 10.0)]
    max_relief_kg_s: Annotated[float, _between(0.0, 10.0)]
    """Largest mass flow that the regulator vents when the volume's pressure is above its setting."""


class Cylinder(Document, frozen=True):
    """Rodless double-acting cylinder with its tubes."""

    bore_m: Annotated[float, _between(1e-4, 0.5)]
    stroke_m: Annotated[float, _between(1e-3, 5.0)]
    dead_volume_m3: Annotated[float, _between(1e-7, 0.1)]
    """Dead volume at each end, including the tube."""
    tube_m: Annotated[float, _between(0.0, 50.0)]
    """Length of the tube from valve to cylinder. A change of flow travels it at the speed of sound."""
    heat_w_k: Annotated[float, _between(0.0, 1000.0)]
    """Heat flow from the walls into each chamber per kelvin of temperature difference."""

    @property
    def area_m2(self) -> float:
        """Area of the piston in m2."""
        return 0.25 * math.pi * self.bore_m**2


class Valve(Document, frozen=True):
    """5/3-way proportional valve: a spool with four edges. Lengths are fractions of its full travel."""

    centre_v: Annotated[float, _between(4.0, 6.0)]
    """Voltage at which the spool is in the middle."""
    hysteresis_v: Annotated[float, _between(0.0, 1.0)]
    """Half of the play (hysteresis) between command and spool."""
    spool_hz: Annotated[float, _between(1.0, 500.0)]
    spool_damping: Annotated[float, _between(0.05, 10.0)]
    conductance_m3_s_pa: Annotated[float, _between(0.0, 1e-5)]
    """ISO 6358 sonic conductance C of one fully open edge, including the tube."""
    critical_ratio: Annotated[float, _between(0.0, 0.98)]
    """ISO 6358 critical pressure ratio b: below it the flow is choked."""
    overlap: Annotated[float, _between(-0.5, 0.9)]
    """Travel d of the spool before an edge opens. Negative if the edges are open at the centre."""
    clearance: Annotated[float, _between(0.0, 1.0)]
    """Clearance w of an edge, which leaks at the centre: C(x) = C ((x-d) + sqrt((x-d)^2 + w^2)) / 2."""


class Friction(Document, frozen=True):
    """LuGre friction at the cylinder: F = s0 z + s1 z' + s2 v, z' = v - s0 |v| z / g(v)."""

    coulomb_n: Annotated[float, _between(1e-6, 1e4)]
    static_n: Annotated[float, _between(1e-6, 1e4)]
    stribeck_m_s: Annotated[float, _between(1e-4, 1.0)]
    """Stribeck velocity. Dry friction is g(v) = coulomb + (static - coulomb) / (1 + (v/stribeck)^2)."""
    bristle_n_m: Annotated[float, _between(0.0, 1e7)]
    bristle_n_s_m: Annotated[float, _between(0.0, 1e5)]
    viscous_n_s_m: Annotated[float, _between(0.0, 1e5)]
    per_moment_1_n_m: Annotated[float, _between(0.0, 10.0)]
    """Relative increase of dry friction per newton metre of moment on the guides.

    Dry friction is ``coulomb_n``, ``static_n`` and ``bristle_n_m``. The moment is counted from that at
    mid-reach without payload.
    """


class Spring(Document, frozen=True):
    """Spring force of counterbalance, hoses and cable chain: centre_n - rate_n_m x."""

    rate_n_m: Annotated[float, _between(0.0, 1e6)]
    centre_n: Annotated[float, _between(-1e4, 1e4)]


class Stop(Document, frozen=True):
    """End stops: force = stiffness x depth x (1 + damping x velocity). A stop pushes; it never pulls."""

    stiffness_n_m: Annotated[float, _between(1e3, 1e8)]
    damping_s_m: Annotated[float, _between(0.0, 100.0)]


class Potentiometer(Document, frozen=True):
    """The true potentiometer. The rig file has the values that the gateway assumes."""

    y_at_0v: Annotated[float, _between(-100.0, 100.0)]
    y_at_10v: Annotated[float, _between(-100.0, 100.0)]
    noise_v: Annotated[float, _between(0.0, 1.0)]
    """Standard deviation of the white noise of a reading."""
    nonlinearity: Annotated[float, _between(-0.05, 0.05)]
    """Largest deviation from a straight line as a fraction of the span.

    The curve is an S, which meets the line at both ends and in the middle.
    """


class ArmAxis(Document, frozen=True):
    """One axis in the coordinate of its cylinder: metres and newtons, also for the rotation."""

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
    """Content of an arm file."""

    step_s: Annotated[float, _between(1e-6, 1e-3)]
    """Largest step of the integration."""
    body: Body
    supply: Supply
    axes: ArmAxes

    @property
    def ordered(self) -> tuple[ArmAxis, ArmAxis, ArmAxis]:
        """The axes in the order of :data:`AXES`."""
        return self.axes.vertical, self.axes.horizontal, self.axes.rotation

    @property
    def travel(self) -> tuple[float, float, float]:
        """Travel of each axis in its unit per metre of its cylinder: 1 m, 1 m, 1/pulley_m rad."""
        return 1.0, 1.0, 1.0 / self.body.pulley_m

    @property
    def min_masses_kg(self) -> tuple[float, float, float]:
        """Smallest mass that each cylinder moves: no payload, and no horizontal link on the rotation."""
        body = self.body
        return (
            body.vertical_kg + body.horizontal_kg,
            body.horizontal_kg,
            body.base_kg_m2 / body.pulley_m**2,
        )


def absolute_pa(gauge_kpa: float, supply: Supply) -> float:
    """Convert a gauge pressure in kPa to an absolute pressure in Pa."""
    return 1e3 * (gauge_kpa + supply.atmosphere_kpa)


def kelvin(celsius: float) -> float:
    """Convert a temperature to kelvin."""
    return celsius + 273.15
