"""The scenario file: an experiment on the simulated arm as one TOML document.

A scenario has setpoints, controllers, a duration, and the events that happen to the arm. The package ships
the paper's experiments ``fig13``, ``fig14`` and ``fig15``.

    title = "step under load"
    duration_s = 8.0

    [setpoints]
    vertical = "step:0.1@2"

    [[events]]
    at_s = 4.0
    change = "payload"
    mass_kg = 3.0
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import msgspec

from firmware_sim.arm.events import AnyEvent
from firmware_sim.faults.kinds import AnyFault
from hil.core.documents import Document, from_toml
from hil.core.errors import DocumentError
from hil.core.suggestions import did_you_mean

SHIPPED = Path(__file__).parent / "scenarios"


class Scenario(Document, frozen=True):
    """Content of a scenario file.

    The times of events count from the boards' first sample, which is two periods before control begins.
    """

    title: str
    duration_s: Annotated[float, msgspec.Meta(gt=0.0, le=86400.0)]
    setpoints: dict[str, str] = msgspec.field(default_factory=dict)
    """Setpoint of an axis, as ``hil run --setpoint`` takes it. Other axes keep that of the rig file."""
    controllers: dict[str, str] = msgspec.field(default_factory=dict)
    """Controller of an axis, as ``hil run --controller`` takes it. Other axes keep that of the rig file."""
    figure_axes: list[str] = msgspec.field(default_factory=list)
    """Axes that the figure of the run shows; all axes if empty."""
    events: list[AnyEvent] = msgspec.field(default_factory=list)
    """Events that happen to the arm, in any order."""
    faults: list[AnyFault] = msgspec.field(default_factory=list)
    """Faults of frames, bus, boards, sensors, valves and host; ``firmware_sim.faults.kinds`` lists them."""


def check_axes(scenario: Scenario, axes: Iterable[str], source: str) -> None:
    """Check that a rig with ``axes`` has every axis that the scenario names. Raises DocumentError."""
    known = list(axes)
    for key in ("setpoints", "controllers", "figure_axes"):
        for name in getattr(scenario, key):
            if name not in known:
                raise DocumentError(
                    f"{source}: {key}: no axis {name!r}; the rig has {', '.join(known)}"
                    f"{did_you_mean(name, known)}"
                )


def find_scenario(name: str) -> Path:
    """Return the file of a scenario: a shipped one by its name, or a path. Raises DocumentError."""
    shipped = sorted(path.stem for path in SHIPPED.glob("*.toml"))
    path = SHIPPED / f"{name}.toml" if name in shipped else Path(name)
    if not path.is_file():
        raise DocumentError(
            f"--scenario {name}: no such file, and not one of the shipped {', '.join(shipped)}"
            f"{did_you_mean(name, shipped)}"
        )
    return path


def read_scenario(text: str, source: str) -> Scenario:
    """Read the TOML text of a scenario. ``source`` is the file's name for errors. Raises DocumentError."""
    return from_toml(text, Scenario, source)
