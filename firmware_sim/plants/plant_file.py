"""The plant document (``plant.json``): an identified linear model of one axis.

``hil design`` reads the same documents. This module reads the keys that a simulation needs and ignores the
others (description, origin, …), so it shares no code with ``design``.

    {
      "format": "hil-plant", "version": 1, "name": "mine",
      "input_unit": "V", "output_unit": "m",
      "num": [0.47947, 43.5166972],
      "den": [1.0, 17.3931, 175.080007, 71.03849],
      "dead_time_s": 0.0056
    }
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
    dead_time_s: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.0
    """Dead time of the plant in seconds."""

    @property
    def model(self) -> LinearModel:
        """The document's transfer function with its dead time."""
        return LinearModel(tuple(self.num), tuple(self.den), self.dead_time_s)


def read_plant_file(text: str, source: str) -> PlantFile:
    """Read and check the JSON text of a plant document. ``source`` is the file's name for errors.

    Raises DocumentError, with the key, for a document that is not valid or a model that cannot be simulated.
    """
    plant = from_json(text, PlantFile, source)
    if not any(plant.num):
        raise DocumentError(f"{source}: num: all coefficients are 0: the valve would not move the axis")
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
