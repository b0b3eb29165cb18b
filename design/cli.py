"""``hil design``: from a plant model to a controller file that the daemon runs, with a report.

Reads and writes the files; what is designed is in ``procedure``, what is told in ``report`` and ``closing``.
0: done. 1: the controller should not be run as it is, or (``--paper``) a figure does not reproduce.
"""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from hil.core.errors import DocumentError, HilError
from hil.host.command_parser import CommandParser

if TYPE_CHECKING:
    from design.models.measured_record import ModelFit
    from design.models.plant import Plant
    from design.paper.verdicts import Verdict
    from design.search.searcher import Progress
    from design.synthesis.design_file import DesignFile
    from design.synthesis.procedure import Design, OnProgress

SUMMARY = "design a controller for an identified plant"
DESIGN_NAME = "design.toml"
STRUCTURE_NAMES = "p, pi, pd, pid, pid-2dof, lead-lag, pi-lead"
"""Of ``structures.STRUCTURES``, which is not imported for a help text."""
PLANTS = Path(__file__).parent / "models" / "plants"
PAPER = "paper"


@dataclass(frozen=True)
class _Inputs:
    """Everything that was read."""

    design_file: DesignFile
    plant: Plant
    further: list[Plant]
    measured: ModelFit | None


def main(argv: list[str]) -> int:
    """Run ``hil design``; returns the exit status. Raises HilError for what the user can put right."""
    # Before numpy is loaded: on thousands of small matrices, threads cost more than they give.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    options = parser().parse_args(argv)
    if options.init:
        return _write_example()
    if options.paper:
        return _reproduce_paper(options)
    inputs = _read(options)
    from rich.console import Console

    from design.output.closing import tell
    from design.output.controller_files import controller_files
    from design.output.results_folder import ResultsFolder
    from design.synthesis.procedure import design_controller

    plant = inputs.plant
    directory: Path = options.out or Path("designs") / re.sub(r"[^\w.-]+", "-", plant.name)
    folder = ResultsFolder(directory, f"Controller design: {plant.name}")
    folder.check()
    console = Console(highlight=False)
    with _progress_bars() as on_progress:
        design = design_controller(inputs.design_file, plant, inputs.further, on_progress)
    controllers = controller_files(design)
    folder.replace(_report_files(design, folder.title, inputs.measured) | controllers)
    return tell(console, design, inputs.measured, directory)


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil design``."""
    parser = CommandParser(
        prog="hil design",
        description="Design a controller for an identified plant: H-infinity loop shaping, fixed structure.",
        epilog="Without PLANT: the paper's, eq. (15). The design file has everything else that can be "
        "asked for, with its default; --init writes one.",
    )
    shipped = ", ".join(_shipped_plants())
    parser.add_argument(
        "plant", nargs="?", default=PAPER, metavar="PLANT", help=f"plant file, or a shipped one: {shipped}"
    )
    parser.add_argument("--design", type=Path, metavar="FILE", help="design file, TOML (the shipped example)")
    parser.add_argument(
        "--structure", metavar="NAME", help=f"{STRUCTURE_NAMES}, or your own file.py:Class (pid)"
    )
    parser.add_argument("--seed", type=_seed, metavar="N", help="seed of every search (1)")
    parser.add_argument("--axis-unit", choices=("m", "rad"), help="refuse a plant in another unit")
    parser.add_argument(
        "--measured",
        type=Path,
        metavar="CSV",
        help="record time_s,u,y to hold the model against (a shipped plant's own)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="where results go (designs/<plant's name>); only the same plant's are replaced",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--paper", action="store_true", help="reproduce the paper's figures, with verdicts")
    what.add_argument("--init", action="store_true", help=f"write {DESIGN_NAME}, commented, to begin from")
    return parser


def _write_example() -> int:
    from rich.console import Console

    from design.synthesis.design_file import example_text

    path = Path(DESIGN_NAME)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(example_text())
    except FileExistsError:
        raise DocumentError(f"{path} exists already; it is left as it is") from None
    Console(highlight=False).print(f"{path} written: change it, then `hil design PLANT --design {path}`")
    return 0


def _read(options: argparse.Namespace) -> _Inputs:
    from design.models.plant import check_plant_fits
    from design.synthesis.design_file import ControllerStructure, example_text, read_design

    text = _text(options.design) if options.design else example_text()
    design_file = read_design(text, str(options.design or DESIGN_NAME))
    if options.structure:
        kept = design_file.controller.must_meet_specifications
        structure = ControllerStructure(structure=options.structure, must_meet_specifications=kept)
        design_file = msgspec.structs.replace(design_file, controller=structure)
    if options.seed is not None:
        design_file = design_file.with_seed(options.seed)
    plant = _plant(options.plant)
    base = options.design.parent if options.design else Path()
    further = [_plant(name, base) for name in design_file.further_plants.files]
    unit = options.axis_unit or design_file.axis_unit
    if unit is not None:
        check_plant_fits(plant, options.plant, unit)
    for other, name in zip(further, design_file.further_plants.files, strict=True):
        check_plant_fits(other, name, plant.output_unit)
    measured = None
    record = options.measured or _shipped_record(options.plant)
    if record:
        from design.models.measured_record import compare

        measured = compare(plant, _table(record), str(options.measured or f"the shipped {record.name}"))
    return _Inputs(design_file, plant, further, measured)


def _reproduce_paper(options: argparse.Namespace) -> int:
    others = (options.design, options.structure, options.seed, options.axis_unit, options.measured)
    if options.plant != PAPER or any(value is not None for value in others):
        raise HilError(
            "--paper carries out the paper's own design; of the other options it takes --out alone"
        )
    from rich.console import Console
    from rich.table import Table

    from design.output.results_folder import ResultsFolder
    from design.paper.reproduction import reproduce

    directory: Path = options.out or Path("designs") / "paper-reproduction"
    folder = ResultsFolder(directory, "The paper, reproduced")
    folder.check()
    console = Console(highlight=False)
    with _progress_bars() as on_progress:
        reproduction = reproduce(on_progress)
    verdicts = reproduction.verdicts
    folder.replace(_report_files(reproduction.design, folder.title, None, verdicts))
    table = Table("where", "what", "paper", "here", "verdict", box=None, pad_edge=False)
    for verdict in verdicts:
        style = "red" if verdict.failed else ("green" if verdict.agrees else "yellow")
        table.add_row(
            verdict.where, verdict.what, verdict.printed, verdict.ours, f"[{style}]{verdict.text}[/{style}]"
        )
    console.print(table)
    for verdict in verdicts:
        if not verdict.agrees:
            console.print(f"[bold]{verdict.where}, {verdict.what}:[/bold] {verdict.why}")
    failed = sum(verdict.failed for verdict in verdicts)
    agreeing = sum(verdict.agrees for verdict in verdicts)
    console.print(
        f"{agreeing} of {len(verdicts)} reproduced, {len(verdicts) - agreeing - failed} differ for the "
        f"reasons above, {failed} should agree and do not\nreport  {directory / 'report.html'}"
    )
    return 1 if failed else 0


def _report_files(
    design: Design, title: str, measured: ModelFit | None, verdicts: Sequence[Verdict] = ()
) -> dict[str, str]:
    """The report, and each figure as a file of its own: texts by file name."""
    from design.output.report import design_figures, render
    from design.output.results_folder import FIGURES, REPORT

    drawn = design_figures(design, measured)
    html = render(design, drawn, title=title, measured=measured, verdicts=verdicts)
    return {REPORT: html} | {f"{FIGURES}/{figure.key}.svg": figure.svg for figure in drawn}


@contextmanager
def _progress_bars() -> Iterator[OnProgress]:
    """A bar for each stage of the search with the best fitness so far; silent where nobody watches."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TextColumn("{task.fields[best]}"),
    )
    with Bars(*columns, console=Console(stderr=True)) as bars:
        tasks = {}

        def on_progress(stage: str, progress: Progress, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total, best="")
            best = (
                f"best ε {progress.best_fitness:.4f}" if progress.best_fitness > 0.0 else "none feasible yet"
            )
            bars.update(tasks[stage], completed=progress.evaluations, best=best)

        yield on_progress
        for task in tasks.values():
            # A search that has converged stops early.
            bars.update(task, total=bars.tasks[task].completed)


def _plant(name: str, base: Path = Path()) -> Plant:
    """A shipped plant, or a file relative to ``base``."""
    from design.models.plant import read_plant

    if name in _shipped_plants():
        return read_plant((PLANTS / f"{name}.json").read_text("utf-8"), name)
    path = base / name
    if not path.exists():
        raise DocumentError(
            f"plant {name!r}: no such file, and none of the shipped {', '.join(_shipped_plants())}"
        )
    return read_plant(_text(path), name)


def _shipped_plants() -> list[str]:
    return sorted(path.stem for path in PLANTS.glob("*.json"))


def _shipped_record(name: str) -> Path | None:
    """The record beside a shipped plant; the paper's was not printed."""
    path = PLANTS / f"{name}.csv"
    return path if name in _shipped_plants() and path.exists() else None


def _text(path: Path) -> str:
    from hil.host.text_file import read_text

    return read_text(path)


def _table(path: Path) -> str:
    from hil.host.text_file import MAX_TABLE_BYTES, read_text

    return read_text(path, MAX_TABLE_BYTES)


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text} is not a whole number from 0")
    return int(text)
