"""What can change on the arm while it runs: typed changes with their times, listed in a scenario file.

Lives here: the changes. Applying them is the arm's (``arm``), which does so as its own time passes: the same
in lockstep and in a process of its own. The file is ``firmware_sim.scenario``'s, the form on a command line
``event_text``'s.

    [[events]]
    at_s = 2.0
    change = "payload"
    mass_kg = 3.0
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from hil.core.documents import Document

AxisName = Literal["vertical", "horizontal", "rotation"]


class Change(Document, frozen=True, tag_field="change"):
    """Base of every change. ``at_s`` counts on the arm's own time, from 0 at its start."""

    at_s: Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]


class Payload(Change, frozen=True, tag="payload"):
    """The gripper holds ``mass_kg``: picked up from rest, or dropped with the speed it has. 0 is empty."""

    mass_kg: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]


class SupplyPressure(Change, frozen=True, tag="supply pressure"):
    """The regulator is set to ``gauge_kpa``."""

    gauge_kpa: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)]


class Temperature(Change, frozen=True, tag="temperature"):
    """Supply air, walls and surroundings have ``celsius``; air in the cylinders follows through the walls."""

    celsius: Annotated[float, msgspec.Meta(ge=-20.0, le=60.0)]


class FrictionChange(Change, frozen=True, tag="friction"):
    """All friction of an axis becomes ``factor`` times that of the arm file."""

    axis: AxisName
    factor: Annotated[float, msgspec.Meta(ge=0.0, le=20.0)]


class Leak(Change, frozen=True, tag="leak"):
    """A hole from a chamber to the atmosphere, with ISO 6358 sonic conductance; 0 mends it.

    Chamber 1 is the one that fills on voltages over the valve's centre.
    """

    axis: AxisName
    chamber: Literal[1, 2]
    conductance_m3_s_pa: Annotated[float, msgspec.Meta(ge=0.0, le=1e-6)]


class StuckSpool(Change, frozen=True, tag="stuck spool"):
    """The valve's spool stops where it is, or comes loose."""

    axis: AxisName
    stuck: bool = True


class BrokenWire(Change, frozen=True, tag="broken wire"):
    """The potentiometer's wire breaks, so that its channel reads 0 V, or is mended."""

    axis: AxisName
    broken: bool = True


AnyChange = Payload | SupplyPressure | Temperature | FrictionChange | Leak | StuckSpool | BrokenWire
"""What a scenario lists, in any order; those of one instant happen in the list's."""
