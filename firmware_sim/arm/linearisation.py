"""Transfer function of one axis about rest at mid-stroke, from its physical parameters: eq. (2) of the paper.

G(s) = k1 / (s (s^2 + C/M s + k2)),  k1 = gamma R T G / M (A/V1 + A/V2),  k2 = gamma A^2 / M (P1/V1 + P2/V2),

where G is the valve's change of mass flow per volt (the paper's R = 29.2 m/K is for weight flow).

Eq. (2) has a pole at 0. Eq. (15), which the paper identified on the hardware, has a slow pole in its place.
Two effects that eq. (2) neglects make the slow pole: a spring k, and the leak around the valve's centre,
whose flow rises by Kp per pascal of chamber pressure. With both,

G(s) = k1 / ((s + L) (s^2 + C/M s + k/M) + k2 s),  L = gamma R T Kp / V.

Both forms neglect dry friction, heat through the walls, the valve's own dynamics and the tube's delay.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from firmware_sim.arm.parameters import GAS_J_KG_K, HEAT_RATIO, ArmParameters, Supply, absolute_pa, kelvin
from firmware_sim.arm.pins import FULL_TRAVEL_V

REFERENCE_KG_M3: Final = 1.185
REFERENCE_K: Final = 293.15
"""Density and temperature of air at the reference conditions of ISO 6358."""


class Linearisation(NamedTuple):
    """Coefficients of G(s): from volts of offset from the valve's centre to position in the axis' unit."""

    k1: float
    """Gain k1 in axis units per (V s^3)."""
    drag_1_s: float
    """Viscous friction over mass, C/M, in 1/s."""
    k2: float
    """Stiffness of the air over mass, k2, in 1/s^2."""
    leak_1_s: float
    """Rate L at which the leak around the valve's centre discharges a chamber, in 1/s."""
    spring_1_s2: float
    """Spring rate over mass, k/M, in 1/s^2."""
    pressure_pa: float
    """Absolute pressure of both chambers at rest."""

    def equation_2(self, s: complex) -> complex:
        """Return G(s) of eq. (2), as printed in the paper."""
        return self.k1 / (s * (s * s + self.drag_1_s * s + self.k2))

    def with_leak_and_spring(self, s: complex) -> complex:
        """Return G(s) with leak and spring, which make the slow pole."""
        body = s * s + self.drag_1_s * s + self.spring_1_s2
        return self.k1 / ((s + self.leak_1_s) * body + self.k2 * s)


def linearise(arm: ArmParameters, axis: int) -> Linearisation:
    """Linearise one axis about mid-stroke, without payload and with balanced chambers.

    ``axis`` is 0 for vertical, 1 for horizontal, 2 for rotation.
    """
    part, body = arm.ordered[axis], arm.body
    mass_kg = (
        body.vertical_kg + body.horizontal_kg,
        body.horizontal_kg,
        (body.base_kg_m2 + body.horizontal_kg * body.reach_m**2) / body.pulley_m**2,
    )[axis]
    area = part.cylinder.area_m2
    volume_m3 = part.cylinder.dead_volume_m3 + 0.5 * area * part.cylinder.stroke_m
    temperature_k = kelvin(arm.supply.temperature_c)
    pressure_pa, flow_pa, slope = _balance(arm.supply, part.valve.critical_ratio)
    sonic = part.valve.conductance_m3_s_pa * REFERENCE_KG_M3 * math.sqrt(REFERENCE_K / temperature_k)
    lift, clearance = -part.valve.overlap, part.valve.clearance
    opening = 0.5 * (lift + math.hypot(lift, clearance))
    widening_1_v = 0.5 * (1.0 + lift / math.hypot(lift, clearance)) / FULL_TRAVEL_V
    pressure_per_kg = HEAT_RATIO * GAS_J_KG_K * temperature_k / volume_m3
    return Linearisation(
        k1=2.0 * area / mass_kg * pressure_per_kg * sonic * 2.0 * widening_1_v * flow_pa * arm.travel[axis],
        drag_1_s=part.friction.viscous_n_s_m / mass_kg,
        k2=2.0 * area**2 / mass_kg * HEAT_RATIO * pressure_pa / volume_m3,
        leak_1_s=pressure_per_kg * sonic * opening * slope,
        spring_1_s2=part.spring.rate_n_m / mass_kg,
        pressure_pa=pressure_pa,
    )


def _balance(supply: Supply, critical: float) -> tuple[float, float, float]:
    """Find the equilibrium of a chamber between two equally open edges, to the supply and to the atmosphere.

    Returns its pressure in Pa, the flow through either edge over its sonic conductance in Pa, and the
    decrease of net inflow (likewise over sonic conductance) per pascal of chamber pressure.
    """
    high_pa, low_pa = absolute_pa(supply.gauge_kpa, supply), absolute_pa(0.0, supply)

    def surplus_pa(pressure_pa: float) -> float:
        return _flow_pa(high_pa, pressure_pa, critical) - _flow_pa(pressure_pa, low_pa, critical)

    below, above = low_pa, high_pa
    for _ in range(60):
        middle = 0.5 * (below + above)
        below, above = (middle, above) if surplus_pa(middle) > 0.0 else (below, middle)
    pressure_pa, nudge_pa = 0.5 * (below + above), 1.0
    slope = (surplus_pa(pressure_pa - nudge_pa) - surplus_pa(pressure_pa + nudge_pa)) / (2.0 * nudge_pa)
    return pressure_pa, _flow_pa(high_pa, pressure_pa, critical), slope


def _flow_pa(up_pa: float, down_pa: float, critical: float) -> float:
    """Return upstream pressure times the ratio of flow to choked flow (ISO 6358), in Pa."""
    excess = max(down_pa / up_pa - critical, 0.0) / (1.0 - critical)
    return up_pa * math.sqrt(1.0 - excess**2)
