"""Binding to the compiled dynamics, ``dynamics.c``, by ctypes: its structs and its functions.

Why C: one file of plain C is compiled once, at installation. It loads in a millisecond, needs nothing at run
time, and does its arithmetic in the order in which it is written. numba would compile at start, or keep a
cache and 100 MB of LLVM in the process; Cython would add a language.

Why ctypes: the file needs no Python headers. One call integrates about forty steps, so the microsecond that
ctypes costs does not matter.
"""

from __future__ import annotations

import ctypes
import math
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Final

from firmware_sim.arm.parameters import ArmAxis, ArmParameters, absolute_pa
from hil.core.errors import EnvironmentLackError

_D: Final = ctypes.c_double
_REMEDY: Final = "install it again: apt-get install gcc libc6-dev, then pip install -e ."


class AxisParameters(ctypes.Structure):
    """Mirror of ``struct axis_parameters``."""

    _fields_ = (
        ("area_m2", _D),
        ("half_stroke_m", _D),
        ("dead_volume_m3", _D),
        ("heat_w_k", _D),
        ("conductance_m3_s_pa", _D),
        ("critical_ratio", _D),
        ("overlap", _D),
        ("clearance", _D),
        ("spool_rad_s", _D),
        ("spool_damping", _D),
        ("coulomb_n", _D),
        ("static_n", _D),
        ("stribeck_m_s", _D),
        ("bristle_n_m", _D),
        ("bristle_n_s_m", _D),
        ("viscous_n_s_m", _D),
        ("per_moment_1_n_m", _D),
        ("spring_n_m", _D),
        ("spring_centre_n", _D),
        ("stop_n_m", _D),
        ("stop_s_m", _D),
    )


class PackedParameters(ctypes.Structure):
    """Mirror of ``struct arm_parameters``."""

    _fields_ = (
        ("axis", AxisParameters * 3),
        ("vertical_kg", _D),
        ("horizontal_kg", _D),
        ("base_kg_m2", _D),
        ("reach_m", _D),
        ("tip_m", _D),
        ("pulley_m", _D),
        ("supply_m3", _D),
        ("regulator_kg_s_pa", _D),
        ("regulator_max_kg_s", _D),
        ("regulator_relief_kg_s", _D),
        ("atmosphere_pa", _D),
    )


class AxisConditions(ctypes.Structure):
    """Mirror of ``struct axis_conditions``."""

    _fields_ = (
        ("spool_command", _D),
        ("spool_free", _D),
        ("friction_factor", _D),
        ("leak_m3_s_pa", _D * 2),
    )


class ArmConditions(ctypes.Structure):
    """Mirror of ``struct arm_conditions``."""

    _fields_ = (("axis", AxisConditions * 3), ("payload_kg", _D), ("regulator_pa", _D), ("air_k", _D))


class AxisState(ctypes.Structure):
    """Mirror of ``struct axis_state``."""

    _fields_ = (
        ("spool", _D),
        ("spool_rate_1_s", _D),
        ("position_m", _D),
        ("velocity_m_s", _D),
        ("bristle_m", _D),
        ("pressure_pa", _D * 2),
        ("air_kg", _D * 2),
    )


class ArmState(ctypes.Structure):
    """Mirror of ``struct arm_state``."""

    _fields_ = (("axis", AxisState * 3), ("supply_pa", _D), ("supplied_kg", _D), ("exhausted_kg", _D))


class Dynamics:
    """The compiled library. Raises EnvironmentLackError if it is missing or outdated."""

    def __init__(self) -> None:
        path = _library_path()
        library = ctypes.CDLL(str(path))
        sizes = (ctypes.c_int * 3)()
        library.arm_layout(sizes)
        if [*sizes] != [ctypes.sizeof(kind) for kind in (PackedParameters, ArmConditions, ArmState)]:
            raise EnvironmentLackError(f"{path}: compiled from another version of dynamics.c; {_REMEDY}")
        self.advance = library.arm_advance
        """Integrate: (parameters, conditions, state, duration_s, steps) -> status.

        Status 0 is success. 1, 2, 3 mean that vertical, horizontal, rotation has left the range of possible
        states; 4 means that the supply has.
        """
        self.advance.argtypes = [
            *map(ctypes.POINTER, (PackedParameters, ArmConditions, ArmState)),
            _D,
            ctypes.c_int,
        ]
        self.advance.restype = ctypes.c_int


def _library_path() -> Path:
    here = Path(__file__).parent
    for suffix in EXTENSION_SUFFIXES:
        path = here / f"_dynamics{suffix}"
        if path.exists():
            return path
    raise EnvironmentLackError(f"the simulated arm is not compiled (no _dynamics*.so in {here}); {_REMEDY}")


def pack(arm: ArmParameters) -> PackedParameters:
    """Convert an arm file to the struct that the C code reads."""
    body, supply = arm.body, arm.supply
    return PackedParameters(
        axis=tuple(map(_pack_axis, arm.ordered)),
        vertical_kg=body.vertical_kg,
        horizontal_kg=body.horizontal_kg,
        base_kg_m2=body.base_kg_m2,
        reach_m=body.reach_m,
        tip_m=body.tip_m,
        pulley_m=body.pulley_m,
        supply_m3=supply.volume_m3,
        regulator_kg_s_pa=1e-3 / supply.droop_kpa_s_kg,
        regulator_max_kg_s=supply.max_flow_kg_s,
        regulator_relief_kg_s=supply.max_relief_kg_s,
        atmosphere_pa=absolute_pa(0.0, supply),
    )


def _pack_axis(axis: ArmAxis) -> AxisParameters:
    cylinder, valve, friction = axis.cylinder, axis.valve, axis.friction
    return AxisParameters(
        area_m2=cylinder.area_m2,
        half_stroke_m=0.5 * cylinder.stroke_m,
        dead_volume_m3=cylinder.dead_volume_m3,
        heat_w_k=cylinder.heat_w_k,
        conductance_m3_s_pa=valve.conductance_m3_s_pa,
        critical_ratio=valve.critical_ratio,
        overlap=valve.overlap,
        clearance=valve.clearance,
        spool_rad_s=2.0 * math.pi * valve.spool_hz,
        spool_damping=valve.spool_damping,
        coulomb_n=friction.coulomb_n,
        static_n=friction.static_n,
        stribeck_m_s=friction.stribeck_m_s,
        bristle_n_m=friction.bristle_n_m,
        bristle_n_s_m=friction.bristle_n_s_m,
        viscous_n_s_m=friction.viscous_n_s_m,
        per_moment_1_n_m=friction.per_moment_1_n_m,
        spring_n_m=axis.spring.rate_n_m,
        spring_centre_n=axis.spring.centre_n,
        stop_n_m=axis.stop.stiffness_n_m,
        stop_s_m=axis.stop.damping_s_m,
    )
