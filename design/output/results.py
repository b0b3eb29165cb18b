"""Write the results of a design into a folder: report, figures and controller files.

From Python::

    design = design_controller(DesignFile(), plant)
    written = write_design(design, Path("designs/vertical"))
    print(written.report, written.controller)
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from design.models.measured_record import ModelFit
from design.models.plant import Plant
from design.output.controller_files import DESIGNED_FILE, controller_files
from design.output.figure_set import PAPER_NUMBERS, design_figures
from design.output.figures import Figure
from design.output.report import render
from design.output.results_folder import REPORT, ResultsFolder
from design.synthesis.procedure import Design
from design.synthesis.recommendation import Recommendation, recommend

if TYPE_CHECKING:
    from design.paper.reproduction import Reproduction

PAPER_TITLE = "Reproduction of the paper"

_CONTROLLER_FILES = (DESIGNED_FILE, *(f"{stem}.json" for stem in ("hls", "pi", "zn", "tlc")))
_NAMES = (*_CONTROLLER_FILES, *(f"figures/{key}.svg" for key in PAPER_NUMBERS))
"""Names of all files that a design may have besides its report."""


@dataclass(frozen=True)
class WrittenDesign:
    """Paths of the written results, and what should be done with the controller."""

    report: Path
    controller: Path | None
    """Controller file of the designed controller; None if its loop is unstable on the rig."""
    recommendation: Recommendation
    earlier: Path | None = None
    """Folder that different results of an earlier design were moved to; None if there were none."""


def design_folder(directory: Path, plant: Plant) -> ResultsFolder:
    """Return the folder for the results of a plant; its ``check`` should be called before a long search."""
    return ResultsFolder(directory, f"Controller design: {plant.name}", _NAMES)


def paper_folder(directory: Path) -> ResultsFolder:
    """Return the folder for the results of the paper's reproduction."""
    return ResultsFolder(directory, PAPER_TITLE, _NAMES)


def write_design(
    design: Design, directory: Path, measured: ModelFit | None = None, *, keeps_earlier: bool = True
) -> WrittenDesign:
    """Write report, figures and controller files into a folder, which is made if it does not exist.

    ``measured`` is a record of the plant, which the report shows beside the model. Results of an earlier
    design for the same plant name are replaced; with ``keeps_earlier``, those that differ are moved into a
    folder ``earlier-1``, ``earlier-2``, ... beside them. Raises HilError if the folder holds anything else,
    or cannot be written.
    """
    folder = design_folder(directory, design.plant)
    folder.check()
    recommendation = recommend(design, measured)
    figures = design_figures(design, measured)
    report = render(design, figures, recommendation, title=folder.title, measured=measured)
    controllers = controller_files(design)
    texts = {REPORT: report} | _svg_files(figures) | controllers
    earlier = folder.replace(texts, keeps_earlier=keeps_earlier)
    controller = directory / DESIGNED_FILE if DESIGNED_FILE in controllers else None
    return WrittenDesign(directory / REPORT, controller, recommendation, earlier)


def write_reproduction(reproduction: Reproduction, directory: Path) -> Path:
    """Write report and figures of the paper's reproduction into a folder, and return the report's path.

    Raises HilError as :func:`write_design`.
    """
    folder = paper_folder(directory)
    folder.check()
    design = reproduction.design
    figures = design_figures(design)
    report = render(design, figures, recommend(design), title=folder.title, claims=reproduction.claims)
    folder.replace({REPORT: report} | _svg_files(figures))
    return directory / REPORT


def _svg_files(figures: list[Figure]) -> dict[str, str]:
    return {f"figures/{figure.key}.svg": figure.svg for figure in figures}
