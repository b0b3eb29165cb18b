"""The shipped rig file, and the facts of it that tests use as numbers."""

from __future__ import annotations

from importlib.resources import files
from typing import Final

from hil.core.rig import Rig, read_rig

RIG_TEXT: Final = (files("hil.shipped") / "rig.toml").read_text(encoding="utf-8")
SHIPPED_RIG: Final[Rig] = read_rig(RIG_TEXT, "rig.toml")
PERIOD_S: Final = 0.0112
PERIOD_NS: Final = 11_200_000
CENTRED: Final = (5.0, 5.0, 5.0)
"""Valve voltages at which the shipped rig's valves are centred."""
