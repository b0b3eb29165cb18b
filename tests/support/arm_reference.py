"""Reference solution of the arm's dynamics: the same physics as a right-hand side in plain Python, for scipy.

It was written from the equations and not from ``dynamics.c``. The state of an axis is spool, spool rate,
position, velocity, bristle, pressures 1 and 2, air masses 1 and 2. The supply's pressure is the last number
of the state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.parameters import ArmAxis, ArmParameters

GAMMA, R, G = 1.4, 287.05, 9.80665
SCALES = np.array(3 * [0.01, 10.0, 1e-3, 1e-2, 1e-5, 1e3, 1e3, 1e-6, 1e-6] + [1e3])


class Drive(NamedTuple):
    """Constant inputs of an interval: spool commands (-1 to 1) and conditions."""

    spools: tuple[float, float, float]
    payload_kg: float = 0.0
    regulator_pa: float = 550e3
    air_k: float = 293.15
    leak: tuple[int, int, float] = (0, 0, 0.0)
    """Axis and chamber, both counted from 0, and conductance."""


def mass_flow(conductance: float, b: float, up: float, up_k: float, down: float, down_k: float) -> float:
    """Return the mass flow of ISO 6358 in kg/s, linear above a pressure ratio of 0.99; negative backwards."""
    if up < down:
        return -mass_flow(conductance, b, down, down_k, up, up_k)
    ratio = down / up
    sonic = conductance * 1.185 * up * math.sqrt(293.15 / up_k)
    if ratio <= b:
        return sonic
    if ratio <= 0.99:
        return sonic * math.sqrt(1.0 - ((ratio - b) / (1.0 - b)) ** 2)
    return sonic * math.sqrt(1.0 - ((0.99 - b) / (1.0 - b)) ** 2) * (1.0 - ratio) / 0.01


def opening(axis: ArmAxis, spool: float) -> float:
    lift = spool - axis.valve.overlap
    return axis.valve.conductance_m3_s_pa * (lift + math.hypot(lift, axis.valve.clearance)) / 2.0


def derivative(arm: ArmParameters, drive: Drive, y: Sequence[float]) -> list[float]:
    body, supply = arm.body, arm.supply
    atmosphere, ambient_k = 1e3 * supply.atmosphere_kpa, drive.air_k
    rows = [list(y[9 * a : 9 * a + 9]) for a in range(3)]
    ps = y[27]
    m1, m2, mp = body.vertical_kg, body.horizontal_kg, drive.payload_kg
    r = body.reach_m + rows[1][2]
    rp = r + body.tip_m
    r_dot, theta_dot = rows[1][3], rows[2][3] / body.pulley_m
    J = body.base_kg_m2 + m2 * r**2 + mp * rp**2
    masses = (m1 + m2 + mp, m2 + mp, J / body.pulley_m**2)
    forces = (
        -(m1 + m2 + mp) * G,
        (m2 * r + mp * rp) * theta_dot**2,
        -2.0 * (m2 * r + mp * rp) * r_dot * theta_dot / body.pulley_m,
    )
    tilt = G * (m2 * (r - body.reach_m) + mp * rp)
    drawn = 0.0
    out: list[float] = []
    for a, axis in enumerate(arm.ordered):
        spool, spool_rate, x, v, z, p1, p2, air1, air2 = rows[a]
        area, half = math.pi * axis.cylinder.bore_m**2 / 4.0, axis.cylinder.stroke_m / 2.0
        w = 2.0 * math.pi * axis.valve.spool_hz
        spool_acceleration = (
            w * w * (drive.spools[a] - spool) - 2.0 * axis.valve.spool_damping * w * spool_rate
        )
        p_dots, air_dots = [], []
        for chamber, (p, air, sign) in enumerate(((p1, air1, 1.0), (p2, air2, -1.0))):
            V = axis.cylinder.dead_volume_m3 + area * (half + sign * x)
            T = p * V / (air * R)
            inward = mass_flow(opening(axis, sign * spool), axis.valve.critical_ratio, ps, ambient_k, p, T)
            outlet = opening(axis, -sign * spool) + (drive.leak[2] if drive.leak[:2] == (a, chamber) else 0.0)
            outward = mass_flow(outlet, axis.valve.critical_ratio, p, T, atmosphere, ambient_k)
            enthalpy = inward * (ambient_k if inward > 0 else T) - outward * (T if outward > 0 else ambient_k)
            heat = axis.cylinder.heat_w_k * (ambient_k - T)
            p_dots.append((GAMMA * (R * enthalpy - p * sign * area * v) + (GAMMA - 1.0) * heat) / V)
            air_dots.append(inward - outward)
            drawn += inward
        f = axis.friction
        g = f.coulomb_n + (f.static_n - f.coulomb_n) / (1.0 + (v / f.stribeck_m_s) ** 2)
        z_dot = v - f.bristle_n_m * abs(v) / g * z
        stiffer = 1.0 + f.per_moment_1_n_m * tilt
        friction = stiffer * f.bristle_n_m * z + f.bristle_n_s_m * z_dot + f.viscous_n_s_m * v
        stop = 0.0
        if abs(x) > half:
            into = math.copysign(1.0, x)
            pushed = axis.stop.stiffness_n_m * (abs(x) - half) * (1.0 + axis.stop.damping_s_m * into * v)
            stop = into * max(pushed, 0.0)
        spring = axis.spring.centre_n - axis.spring.rate_n_m * x
        acceleration = ((p1 - p2) * area + spring + forces[a] - friction - stop) / masses[a]
        out += [spool_rate, spool_acceleration, v, acceleration, z_dot, *p_dots, *air_dots]
    supplied = 1e-3 / supply.droop_kpa_s_kg * (drive.regulator_pa - ps)
    supplied = min(max(supplied, -supply.max_relief_kg_s), supply.max_flow_kg_s)
    return [*out, R * ambient_k / supply.volume_m3 * (supplied - drawn)]


def state_of(arm: Arm) -> NDArray[np.float64]:
    """Return the arm's state in the order of this module."""
    return np.frombuffer(arm.state, dtype=np.float64)[:28].copy()


def solve(
    arm: ArmParameters,
    start: NDArray[np.float64],
    drives: Sequence[tuple[float, Drive]],
    sample_s: float,
    method: str = "LSODA",
    tolerance: float = 1e-8,
) -> NDArray[np.float64]:
    """Return states (n, 28) every ``sample_s``. ``drives`` are (seconds, drive) of whole samples."""
    states, y = [], start
    for seconds, drive in drives:
        samples = round(seconds / sample_s)
        solution = solve_ivp(
            lambda _t, y, drive=drive: derivative(arm, drive, y),
            (0.0, samples * sample_s),
            y,
            method=method,
            rtol=tolerance,
            atol=10.0 * tolerance * SCALES,
            t_eval=np.arange(1, samples + 1) * sample_s,
        )
        y = solution.y[:, -1]
        states.append(solution.y.T)
    return np.vstack(states)
