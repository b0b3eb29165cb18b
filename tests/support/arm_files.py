"""Arm files that differ from the shipped one in a few numbers."""

from __future__ import annotations

from importlib import resources
from typing import Any

import msgspec

from firmware_sim.arm.arm_file import shipped_arm
from firmware_sim.arm.parameters import AXES, ArmParameters

SHIPPED_TEXT = (resources.files("firmware_sim.arm") / "arm.toml").read_text(encoding="utf-8")


def arm_with(changes: dict[str, float]) -> ArmParameters:
    """Return the shipped arm with values changed by dotted key (``*``: every axis), without checks."""
    plain = msgspec.to_builtins(shipped_arm())
    for dotted, value in changes.items():
        for name in AXES if "*" in dotted else ("",):
            *path, key = dotted.replace("*", name).split(".")
            table: dict[str, Any] = plain
            for step in path:
                table = table[step]
            assert key in table, dotted
            table[key] = value
    return msgspec.convert(plain, ArmParameters)


def arm_text(arm: ArmParameters) -> str:
    """Return an arm file with these parameters."""
    lines: list[str] = []

    def write(table: dict[str, Any], path: tuple[str, ...]) -> None:
        lines.extend(f"{key} = {value!r}" for key, value in table.items() if not isinstance(value, dict))
        for key, inner in table.items():
            if isinstance(inner, dict):
                lines.append(f"[{'.'.join((*path, key))}]")
                write(inner, (*path, key))

    write(msgspec.to_builtins(arm), ())
    return "\n".join(lines)


def _limits(table: type[msgspec.Struct]) -> dict[str, tuple[float, float]]:
    found: dict[str, tuple[float, float]] = {}
    for field in msgspec.structs.fields(table):
        if isinstance(field.type, type):
            found |= {f"{field.name}.{key}": limits for key, limits in _limits(field.type).items()}
        else:
            (meta,) = field.type.__metadata__
            found[field.name] = (meta.ge, meta.le)
    return found


LIMITS = _limits(ArmParameters)
"""Lower and upper limit of every number of an arm file, by dotted key."""


def text_with(dotted: str, value: str) -> str:
    """Return the text of the shipped file with one value changed, by dotted key."""
    *path, key = dotted.split(".")
    lines, here = [], ""
    replaced = 0
    for line in SHIPPED_TEXT.splitlines():
        if line.startswith("["):
            here = line[1 : line.index("]")]
        if here == ".".join(path) and line.split("=")[0].strip() == key:
            line, replaced = f"{key} = {value}", replaced + 1
        lines.append(line)
    assert replaced == 1, dotted
    return "\n".join(lines)


FRICTIONLESS = {
    "axes.*.friction.coulomb_n": 1e-6,
    "axes.*.friction.static_n": 1e-6,
    "axes.*.friction.bristle_n_m": 0.0,
    "axes.*.friction.bristle_n_s_m": 0.0,
    "axes.*.friction.viscous_n_s_m": 0.0,
}
AIRLESS = {"axes.*.cylinder.bore_m": 1e-4, "supply.gauge_kpa": 0.0}
SEALED = {"axes.*.valve.overlap": 0.2, "axes.*.valve.clearance": 0.0}
