"""The shipped rig file, as text and read."""

from __future__ import annotations

from importlib.resources import files
from typing import Final

from hil.core.rig import Rig, read_rig

RIG_TEXT: Final = (files("hil.shipped") / "rig.toml").read_text(encoding="utf-8")
SHIPPED_RIG: Final[Rig] = read_rig(RIG_TEXT, "rig.toml")
