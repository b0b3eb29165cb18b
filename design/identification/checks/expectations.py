"""What is known about the rig and the plant before an experiment."""

from __future__ import annotations

from dataclasses import dataclass

from design.identification.models.model import ContinuousModel


@dataclass(frozen=True)
class Expectations:
    """Facts that a record is compared with. None means that a fact is not known."""

    sample_time_s: float | None = None
    """Period of the rig in s."""
    input_range: tuple[float, float] | None = None
    """Limits of the actuator, in the unit of u."""
    travel: tuple[float, float] | None = None
    """End stops, in the unit of y."""
    closed_loop: bool | None = None
    """True if a controller acted during the experiment, False if none did."""
    plant: ContinuousModel | None = None
    """An earlier model of the plant."""


NOTHING_KNOWN = Expectations()
"""Expectations without a single fact."""
