"""Find and read the plant files of ``--plant``: files of the user, or plants that ``hil design`` ships."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from firmware_sim.plants.linear_model import LinearModel
from firmware_sim.plants.plant_file import check_plant_fits, read_plant_file
from hil.core.errors import DocumentError
from hil.core.rig import Rig
from hil.core.suggestions import did_you_mean
from hil.host.text_file import read_text


class AxisPlant(NamedTuple):
    """The plant file of one axis."""

    name: str
    """Name of the plant, from its document."""
    model: LinearModel
    text: str
    """Text of the plant document."""


def read_axis_plants(rig: Rig, named: Mapping[str, str]) -> dict[str, AxisPlant]:
    """Read the plant file of each axis; ``named`` maps an axis to a file or to the name of a shipped plant.

    Raises DocumentError if the rig has no such axis, or a document is not valid or does not fit its axis.
    """
    plants = {}
    for axis, name in named.items():
        if axis not in rig.axes:
            raise DocumentError(
                f"--plant {axis}={name}: no such axis; the rig has {', '.join(rig.axes)}"
                f"{did_you_mean(axis, rig.axes)}"
            )
        path = _find(axis, name)
        text = read_text(path)
        plant = read_plant_file(text, str(path))
        check_plant_fits(plant, str(path), axis, rig.axes[axis].unit)
        plants[axis] = AxisPlant(plant.name, plant.model, text)
    return plants


def _find(axis: str, name: str) -> Path:
    shipped = _shipped_plants()
    path = shipped.get(name, Path(name))
    if not path.exists():
        known = (
            f"not one of the shipped {', '.join(shipped)}"
            if shipped
            else "no plants are installed with design"
        )
        raise DocumentError(
            f"--plant {axis}={name}: no file {path}, and {known}{did_you_mean(name, shipped)}"
        )
    return path


def _shipped_plants() -> dict[str, Path]:
    """Return the plant files of the package ``design`` by name. Its code is not imported."""
    spec = find_spec("design")
    if spec is None or spec.origin is None:
        return {}
    folder = Path(spec.origin).parent / "models" / "plants"
    return {path.stem: path for path in sorted(folder.glob("*.json"))}
