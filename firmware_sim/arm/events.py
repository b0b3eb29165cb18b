"""Events: what happens to the simulated arm while it runs, as typed documents.

A scenario file (``firmware_sim.scenario``) lists events; ``event_text`` has their form on a command line.
``Arm`` applies an event when its own time reaches ``at_s``, so lockstep and real time give the same run.

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


class Event(Document, frozen=True, tag_field="change"):
    """Base of every event.

    ``at_s`` is a time of the arm in seconds. The arm's time is 0 when its simulation starts, at the first
    sample. In a file, the key ``change`` says what kind of event it is.
    """

    at_s: Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]


class Payload(Event, frozen=True, tag="payload"):
    """The mass in the gripper becomes ``mass_kg``; 0 is an empty gripper.

    A mass that is picked up was at rest. A mass that is dropped keeps its speed.
    """

    mass_kg: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)]


class SupplyPressure(Event, frozen=True, tag="supply pressure"):
    """The regulator's setting becomes ``gauge_kpa``."""

    gauge_kpa: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)]


class Temperature(Event, frozen=True, tag="temperature"):
    """Supply air, walls and surroundings take the temperature ``celsius``.

    The air in the cylinders follows through the walls.
    """

    celsius: Annotated[float, msgspec.Meta(ge=-20.0, le=60.0)]


class FrictionFactor(Event, frozen=True, tag="friction"):
    """All friction of an axis becomes ``factor`` times the friction of the arm file."""

    axis: AxisName
    factor: Annotated[float, msgspec.Meta(ge=0.0, le=20.0)]


class Leak(Event, frozen=True, tag="leak"):
    """A chamber gets a hole to the atmosphere with this ISO 6358 sonic conductance; 0 closes the hole.

    Chamber 1 is the one that fills at voltages above the valve's centre.
    """

    axis: AxisName
    chamber: Literal[1, 2]
    conductance_m3_s_pa: Annotated[float, msgspec.Meta(ge=0.0, le=1e-6)]


class StuckSpool(Event, frozen=True, tag="stuck spool"):
    """The valve's spool sticks at its present position, or comes loose."""

    axis: AxisName
    stuck: bool = True


class BrokenWire(Event, frozen=True, tag="broken wire"):
    """The potentiometer's wire breaks, so that its channel reads 0 V, or is repaired."""

    axis: AxisName
    broken: bool = True


class EmergencyStop(Event, frozen=True, tag="emergency stop"):
    """The emergency stop beside the arm is pressed or released. A rig file says which frame shows it."""

    button: Literal["pressed", "released"]


class EnableSwitch(Event, frozen=True, tag="enable switch"):
    """The enable switch is released or held. It is held at first. A rig file says which frame shows it."""

    switch: Literal["released", "held"]


AnyEvent = (
    Payload
    | SupplyPressure
    | Temperature
    | FrictionFactor
    | Leak
    | StuckSpool
    | BrokenWire
    | EmergencyStop
    | EnableSwitch
)
"""An event of any kind. Events of the same instant happen in the order in which they are listed."""
