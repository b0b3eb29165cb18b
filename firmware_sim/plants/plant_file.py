"""The plant document (``plant.json``): an identified linear model of one axis.

``hil design`` reads the same documents. This module reads the keys that a simulation needs and ignores the
others (description, origin, …), so it shares no code with ``design``.

    {
      "format": "hil-plant", "version": 1, "name": "mine",
      "input_unit": "V", "output_unit": "m",
      "num": [0.47947, 43.5166972],
      "den": [1.0, 17.3931, 175.080007, 71.03849],
      "dead_time_s": 0.0168, "contains_delay_samples": 1, "sample_time_s": 0.0112
    }

The dead time of a model may contain the transport delay of the rig on which the plant was identified: so many
periods as ``contains_delay_samples`` says, of ``sample_time_s`` each. The simulated boards have a transport
delay of their own, so the simulated plant has the rest only. In the example that is 0.0168 s - 0.0112 s =
0.0056 s.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from firmware_sim.plants.linear_model import LinearModel
from firmware_sim.plants.step_table import step_table
from hil.core.documents import from_json
from hil.core.errors import DocumentError

Coefficients = Annotated[list[float], msgspec.Meta(min_length=1, max_length=100)]


class PlantFile(msgspec.Struct, frozen=True, kw_only=True):
    """Keys of a plant document that a simulation needs."""

    format: Literal["hil-plant"]
    version: Literal[1]
    name: str
    input_unit: Literal["V"]
    output_unit: Literal["m", "rad"]
    num: Coefficients
    """Numerator coefficients in falling powers of s, output unit per volt."""
    den: Coefficients
    """Denominator coefficients in falling powers of s."""
    sample_time_s: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    """Period of the record from which the plant was identified."""
    dead_time_s: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.0
    """Dead time of the model in seconds, in addition to num/den."""
    contains_delay_samples: Annotated[int, msgspec.Meta(ge=0, le=20)] = 0
    """Number of periods of the rig's transport delay that the model contains."""

    @property
    def own_dead_time_s(self) -> float:
        """Dead time of the plant itself, without the rig's transport delay, rounded to a nanosecond."""
        contained_s = self.contains_delay_samples * (self.sample_time_s or 0.0)
        return round(self.dead_time_s - contained_s, 9)

    @property
    def model(self) -> LinearModel:
        """Model of the plant itself, without the rig's transport delay."""
        return LinearModel(tuple(self.num), tuple(self.den), self.own_dead_time_s)


def read_plant_file(text: str, source: str) -> PlantFile:
    """Read and check the JSON text of a plant document. ``source`` is the file's name for errors.

    Raises DocumentError, with the key, for a document that is not valid or a model that cannot be simulated.
    """
    plant = from_json(text, PlantFile, source)
    if not any(plant.num):
        raise DocumentError(f"{source}: num: all coefficients are 0: the valve would not move the axis")
    if plant.contains_delay_samples and plant.sample_time_s is None:
        raise DocumentError(
            f"{source}: contains_delay_samples: {plant.contains_delay_samples} periods, but sample_time_s, "
            "the length of a period, is missing; add it"
        )
    if plant.own_dead_time_s < 0.0:
        raise DocumentError(
            f"{source}: contains_delay_samples: {plant.contains_delay_samples} periods of "
            f"{plant.sample_time_s:g} s are longer than dead_time_s, {plant.dead_time_s:g} s: num/den "
            "contain a part of the rig's transport delay, which the simulated boards would add again. "
            "Identify the plant with its dead time separate from num/den"
        )
    try:
        step_table(plant.model)
    except ValueError as error:
        raise DocumentError(f"{source}: {error}") from None
    return plant


def check_plant_fits(plant: PlantFile, source: str, axis: str, unit: str) -> None:
    """Check that a plant's output has the unit of the axis. Raises DocumentError."""
    if plant.output_unit != unit:
        raise DocumentError(
            f"{source}: output_unit: {plant.output_unit}, but axis {axis} is in {unit} (rig file: "
            f"axes.{axis}.unit); choose a plant that was identified in {unit}"
        )
