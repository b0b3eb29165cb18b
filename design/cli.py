"""The command ``hil design``: from a plant model to a controller file that the gateway runs, with a report.

Exit status 0: done. 1: the controller should not be run as it is, or (``--paper``) a figure that must agree
with the paper does not. 2: wrong use or input.
"""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path

from design.inputs import read_inputs, shipped_plants
from hil.core.errors import DocumentError, HilError
from hil.host.command_parser import CommandParser

SUMMARY = "design a controller for an identified plant"
"""Line for this command in the help of ``hil``."""
DESIGN_NAME = "design.toml"
STRUCTURE_NAMES = "p, pi, pd, pid, pid-2dof, lead-lag, pi-lead"
"""Names of ``structures.STRUCTURES``, which takes too long to import for a help text."""
PAPER = "paper"


def main(argv: list[str]) -> int:
    """Run ``hil design`` and return the exit status. Raises HilError for what the user can correct."""
    # Set before numpy is loaded: on thousands of small matrices, threads cost more than they gain.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    options = parser().parse_args(argv)
    if options.init:
        return _write_example()
    if options.paper:
        return _reproduce_paper(options)
    return _design(options)


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil design``."""
    parser = CommandParser(
        prog="hil design",
        description="Design a controller for an identified plant by H-infinity loop shaping with a fixed "
        "structure. Writes a controller file for `hil run` and a report.",
        epilog="The design file contains all other requirements (loop, specifications, search ranges, "
        "further plants), each with a default. Exit status: 0 done; 1 the controller should not be run as it "
        "is; 2 wrong use or input.",
    )
    parser.add_argument(
        "plant",
        nargs="?",
        default=PAPER,
        metavar="PLANT",
        help=f"plant file, or a shipped plant: {', '.join(shipped_plants())} (default: {PAPER}, eq. (15))",
    )
    parser.add_argument(
        "--design", type=Path, metavar="FILE", help="design file, TOML (default: that of --init)"
    )
    parser.add_argument(
        "--structure",
        metavar="NAME",
        help=f"controller structure: {STRUCTURE_NAMES}, or your own file.py:Class (default: pid)",
    )
    parser.add_argument("--seed", type=_seed, metavar="N", help="seed of every search (default: 1)")
    parser.add_argument("--axis-unit", choices=("m", "rad"), help="refuse plants in another unit")
    parser.add_argument(
        "--measured",
        type=Path,
        metavar="CSV",
        help="measured record to compare the model with, columns time_s,u,y (default: a shipped plant's)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for the results (default: designs/NAME, NAME being the plant's name); only results for "
        "the same plant name are replaced, and those that differ are kept in DIR/earlier-1, earlier-2, ...",
    )
    action = parser.add_mutually_exclusive_group()
    action.add_argument(
        "--paper",
        action="store_true",
        help="repeat the paper's design and compare every printed figure with the computed one",
    )
    action.add_argument(
        "--init", action="store_true", help=f"write the commented example {DESIGN_NAME} and stop"
    )
    return parser


def _design(options: argparse.Namespace) -> int:
    inputs = read_inputs(
        options.plant,
        options.design,
        structure=options.structure,
        seed=options.seed,
        axis_unit=options.axis_unit,
        record=options.measured,
    )
    from design.output.progress import progress_bars
    from design.output.results import design_folder, write_design
    from design.output.terminal import make_console, print_design
    from design.synthesis.procedure import design_controller
    from design.synthesis.recommendation import Action

    plant = inputs.plant
    directory: Path = options.out or Path("designs") / re.sub(r"[^\w.-]+", "-", plant.name)
    design_folder(directory, plant).check()
    with progress_bars() as on_progress:
        design = design_controller(inputs.design_file, plant, inputs.further_plants, on_progress)
    written = write_design(design, directory, inputs.measured)
    print_design(make_console(), design, written, inputs.measured, inputs.plant_file)
    return 0 if written.recommendation.action is Action.RUN else 1


def _reproduce_paper(options: argparse.Namespace) -> int:
    others = (options.design, options.structure, options.seed, options.axis_unit, options.measured)
    if options.plant != PAPER or any(value is not None for value in others):
        raise HilError(
            "--paper repeats the paper's own design: it takes no plant, and no option but --out; remove them"
        )
    from design.output.progress import progress_bars
    from design.output.results import paper_folder, write_reproduction
    from design.output.terminal import make_console, print_reproduction
    from design.paper.reproduction import reproduce

    directory: Path = options.out or Path("designs") / "paper-reproduction"
    paper_folder(directory).check()
    with progress_bars() as on_progress:
        reproduction = reproduce(on_progress)
    report = write_reproduction(reproduction, directory)
    print_reproduction(make_console(), reproduction, report)
    return 1 if reproduction.failed else 0


def _write_example() -> int:
    from design.synthesis.design_file import example_text

    path = Path(DESIGN_NAME)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(example_text())
    except FileExistsError:
        raise DocumentError(
            f"{path} exists already and is left as it is; move it away, or pass it as --design {path}"
        ) from None
    print(f"{path} written. Change it, then: hil design PLANT --design {path}")
    return 0


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of 0 or more")
    return int(text)
