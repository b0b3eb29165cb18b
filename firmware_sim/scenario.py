"""A scenario: an experiment on the simulated arm, as one TOML. What axes are asked, what happens to the arm.

``hil run --scenario`` takes setpoints, controllers and duration from it, the arm its events. Shipped are the
paper's experiments, ``fig13``, ``fig14`` and ``fig15``.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import msgspec

from firmware_sim.arm.conditions import AnyChange
from hil.core.documents import Document, from_toml
from hil.core.errors import DocumentError

SHIPPED = Path(__file__).parent / "scenarios"


class Scenario(Document, frozen=True):
    """Event times count from the boards' first sample, two periods before control begins."""

    title: str
    duration_s: Annotated[float, msgspec.Meta(gt=0.0, le=86400.0)]
    setpoints: dict[str, str] = msgspec.field(default_factory=dict)
    """By axis, as ``hil run --setpoint`` takes them; the rig file's for the others."""
    controllers: dict[str, str] = msgspec.field(default_factory=dict)
    """By axis, as ``hil run --controller`` takes them."""
    figure_axes: list[str] = msgspec.field(default_factory=list)
    """The axes that the figure shows; all of them when empty."""
    events: list[AnyChange] = msgspec.field(default_factory=list)


def check_axes(scenario: Scenario, axes: Iterable[str], source: str) -> None:
    """Refuse a scenario for axes that the rig, which has ``axes``, has not. Raises DocumentError."""
    known = list(axes)
    for key in ("setpoints", "controllers", "figure_axes"):
        for name in getattr(scenario, key):
            if name not in known:
                raise DocumentError(f"{source}: {key}: {name!r}: the rig has only {', '.join(known)}")


def find_scenario(name: str) -> Path:
    """A shipped scenario by its name, or a file. Raises DocumentError."""
    shipped = sorted(path.stem for path in SHIPPED.glob("*.toml"))
    path = SHIPPED / f"{name}.toml" if name in shipped else Path(name)
    if not path.is_file():
        raise DocumentError(f"scenario {name!r}: no such file, and none of the shipped {', '.join(shipped)}")
    return path


def read_scenario(text: str, source: str) -> Scenario:
    """Read the TOML text of a scenario; ``source`` is its name for errors. Raises DocumentError."""
    return from_toml(text, Scenario, source)
