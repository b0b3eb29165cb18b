"""Read what ``hil design`` designs from: design file, plants, and a measured record.

A plant is named by its file, or by the name of a shipped plant. Shipped plants of the simulated arm have a
record beside them that they were not identified from.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hil.core.errors import DocumentError
from hil.core.suggestions import did_you_mean
from hil.host.text_file import MAX_TABLE_BYTES, read_text

if TYPE_CHECKING:
    from design.models.measured_record import ModelFit
    from design.models.plant import Plant
    from design.synthesis.design_file import DesignFile

PLANTS = Path(__file__).parent / "models" / "plants"
_PLANT_OF_RECORDING = "`hil identify` makes a plant file from it; give that file"
EXAMPLE = "design.toml"
"""Name of the example in messages, where no design file is given."""


@dataclass(frozen=True)
class Inputs:
    """Everything that was read for a design."""

    design_file: DesignFile
    plant: Plant
    plant_file: Path | None
    """File of the plant; None for a shipped plant."""
    further_plants: list[Plant]
    measured: ModelFit | None
    """Measured record beside the model; None if there is none."""


def read_inputs(
    plant: str,
    design_file: Path | None = None,
    *,
    structure: str | None = None,
    seed: int | None = None,
    axis_unit: str | None = None,
    record: Path | None = None,
) -> Inputs:
    """Read the inputs of a design.

    ``plant`` is a plant file or the name of a shipped plant. ``structure`` and ``seed`` replace those of the
    design file. ``record`` replaces the record that a shipped plant has. Raises DocumentError for a file that
    cannot be read or is wrong, and for plants in another unit than ``axis_unit`` or that of the design file.
    """
    from design.models.plant import check_plant_fits
    from design.synthesis.design_file import example_text, read_design

    text = read_text(design_file) if design_file else example_text()
    requirements = read_design(text, str(design_file or EXAMPLE))
    if structure is not None:
        requirements = requirements.with_structure(structure)
    if seed is not None:
        requirements = requirements.with_seed(seed)
    nominal = load_plant(plant)
    folder = design_file.parent if design_file else Path()
    names = requirements.further_plants.files
    further_plants = [load_plant(name, folder) for name in names]
    unit = axis_unit or requirements.axis_unit
    if unit is not None:
        check_plant_fits(nominal, plant, unit)
    for other, name in zip(further_plants, names, strict=True):
        check_plant_fits(other, name, nominal.output_unit)
    plant_file = None if plant in shipped_plants() else Path(plant)
    return Inputs(requirements, nominal, plant_file, further_plants, _compare(nominal, plant, record))


def load_design(path: str | os.PathLike[str]) -> DesignFile:
    """Read a design file. Raises DocumentError."""
    from design.synthesis.design_file import read_design

    return read_design(read_text(Path(path)), os.fspath(path))


def load_plant(path: str | os.PathLike[str], folder: Path = Path()) -> Plant:
    """Read a shipped plant by its name, or a plant file relative to ``folder``. Raises DocumentError."""
    from design.models.plant import read_plant

    name = os.fspath(path)
    if name in shipped_plants():
        return read_plant((PLANTS / f"{name}.json").read_text("utf-8"), name)
    file = folder / name
    if not file.exists():
        raise DocumentError(
            f"plant {name!r}: there is no file {file}, and no shipped plant of this name; shipped are "
            f"{', '.join(shipped_plants())}{did_you_mean(name, shipped_plants())}"
        )
    return read_plant(read_text(file, for_recording=_PLANT_OF_RECORDING), name)


def shipped_plants() -> list[str]:
    """Return the names of the shipped plants."""
    return sorted(path.stem for path in PLANTS.glob("*.json"))


def _compare(plant: Plant, name: str, record: Path | None) -> ModelFit | None:
    """Compare a plant with a record, or with the record that is shipped with it, if there is one."""
    from design.models.measured_record import compare

    if record is not None:
        return compare(plant, read_text(record, MAX_TABLE_BYTES), str(record))
    shipped = PLANTS / f"{name}.csv"
    if name in shipped_plants() and shipped.exists():
        return compare(plant, read_text(shipped), f"the shipped {shipped.name}")
    return None
