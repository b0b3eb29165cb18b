"""The arm file: a TOML text becomes :class:`ArmParameters`, checked against what is physically possible.

The limits of each single value are in ``parameters``. This module has the checks between several values.
"""

from __future__ import annotations

from importlib import resources

from firmware_sim.arm.parameters import AXES, GRAVITY_M_S2, ArmAxis, ArmParameters, Friction, Supply
from hil.core.documents import from_toml
from hil.core.errors import DocumentError


def read_arm(text: str, source: str) -> ArmParameters:
    """Read and check the TOML text of an arm file. ``source`` is the file's name for errors.

    Raises DocumentError, with key, value and limit, for values that are physically impossible or cannot be
    simulated.
    """
    return check_arm(from_toml(text, ArmParameters, source), source)


def check_arm(arm: ArmParameters, source: str) -> ArmParameters:
    """Check an arm against what is physically possible, and return it. Raises DocumentError."""
    _check_reach(arm, source)
    for name, axis, travel, mass_kg in zip(AXES, arm.ordered, arm.travel, arm.min_masses_kg, strict=True):
        where = f"{source}: axes.{name}"
        _check_friction(axis.friction, f"{where}.friction")
        _check_load(axis.friction, arm, f"{where}.friction")
        _check_sensor(axis, travel, f"{where}.potentiometer")
        _check_stop(axis, arm.supply, f"{where}.stop")
        _check_step(axis, mass_kg, arm.step_s, f"{where}.stop")
    return arm


def shipped_arm() -> ArmParameters:
    """Return the arm that the package ships: the paper's, ``arm.toml``."""
    return read_arm(shipped_arm_text(), "arm.toml")


def shipped_arm_text() -> str:
    """Return the text of the shipped ``arm.toml``."""
    return (resources.files(__package__) / "arm.toml").read_text(encoding="utf-8")


def _check_reach(arm: ArmParameters, source: str) -> None:
    min_reach_m = 0.5 * arm.axes.horizontal.cylinder.stroke_m
    if arm.body.reach_m < min_reach_m:
        raise DocumentError(
            f"{source}: body.reach_m: {arm.body.reach_m} m is less than {min_reach_m} m, half of "
            "axes.horizontal.cylinder.stroke_m: the link would pass through the axis of rotation"
        )


def _check_friction(friction: Friction, where: str) -> None:
    if friction.static_n < friction.coulomb_n:
        raise DocumentError(
            f"{where}.static_n: {friction.static_n} N is less than coulomb_n, {friction.coulomb_n} N"
        )
    # Barabanov and Ortega, IEEE TAC 45 (2000): LuGre friction is passive if and only if this holds.
    max_damping = friction.viscous_n_s_m / max(friction.static_n / friction.coulomb_n - 1.0, 1e-12)
    if friction.bristle_n_s_m > max_damping:
        raise DocumentError(
            f"{where}.bristle_n_s_m: {friction.bristle_n_s_m} N s/m exceeds {max_damping:.4g} N s/m "
            "(viscous_n_s_m / (static_n / coulomb_n - 1)): such friction would generate energy"
        )


def _check_sensor(axis: ArmAxis, travel: float, where: str) -> None:
    low, high = sorted((axis.potentiometer.y_at_0v, axis.potentiometer.y_at_10v))
    end = 0.5 * axis.cylinder.stroke_m * travel
    if low > -end or high < end:
        raise DocumentError(
            f"{where}: y_at_0v and y_at_10v ({low} to {high}) do not cover the stroke, "
            f"{-end:.4g} to {end:.4g} (cylinder.stroke_m; for the rotation divided by body.pulley_m)"
        )


def _check_stop(axis: ArmAxis, supply: Supply, where: str) -> None:
    area = axis.cylinder.area_m2
    min_stiffness = area**2 * 1e3 * supply.gauge_kpa / axis.cylinder.dead_volume_m3
    if axis.stop.stiffness_n_m < min_stiffness:
        raise DocumentError(
            f"{where}.stiffness_n_m: {axis.stop.stiffness_n_m} N/m is less than {min_stiffness:.4g} N/m: at "
            f"supply.gauge_kpa {supply.gauge_kpa} kPa the piston would fill cylinder.dead_volume_m3"
        )


def _check_step(axis: ArmAxis, mass_kg: float, step_s: float, where: str) -> None:
    max_stiffness = mass_kg / step_s**2 - axis.spring.rate_n_m
    if axis.stop.stiffness_n_m > max_stiffness:
        raise DocumentError(
            f"{where}.stiffness_n_m: {axis.stop.stiffness_n_m} N/m exceeds {max_stiffness:.4g} N/m, the "
            f"limit for a mass of {mass_kg:.4g} kg at step_s {step_s} s; use a softer stop or a shorter step"
        )


def _check_load(friction: Friction, arm: ArmParameters, where: str) -> None:
    relief_n_m = GRAVITY_M_S2 * arm.body.horizontal_kg * 0.5 * arm.axes.horizontal.cylinder.stroke_m
    if friction.per_moment_1_n_m * relief_n_m >= 1.0:
        raise DocumentError(
            f"{where}.per_moment_1_n_m: {friction.per_moment_1_n_m} exceeds {1.0 / relief_n_m:.4g}: dry "
            "friction would be negative when the horizontal link is drawn in"
        )
