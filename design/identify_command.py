"""``hil identify``: from records of experiments to a plant file and a report."""

from __future__ import annotations

import argparse
import math
import os
import shlex
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hil.core.errors import DocumentError
from hil.core.suggestions import did_you_mean
from hil.host.command_parser import CommandParser, number

if TYPE_CHECKING:
    from rich.console import Console

    from design.identification.analysis.uncertainty import Root
    from design.identification.identify import Identification
    from design.identification.order_search import OrderTable
    from design.records import Record

SUMMARY = "identify a plant model from records of experiments"
DESCRIPTION = """\
Identify a plant model from records of experiments. Writes a plant file for `hil design` and a report. Without
--validate, the last third of each record is kept from the fit and used to validate the model.
Exit status: 0 if a model was written, 2 if the record allows no model or the arguments are wrong."""
EPILOG = """\
structures:
  OE(nb,nf,nk)        output error, the paper's choice (default OE(1,3,1))
  ARX(na,nb,nk)  ARMAX(na,nb,nc,nk)  BJ(nb,nc,nd,nf,nk)   prediction error
  continuous(real=1,pairs=1,zeros=0,max_dead_time_s=0.05)
                      poles, zeros, gain, and dead time in s

Records: recordings of `hil collect` or `hil run` (.mcap), or tables (.csv, .mat, .parquet) with the columns
time_s,u,y. A missing row or an empty cell is a gap.
"""
COLUMNS = "time_s,u,y"
LABEL_COLUMNS = 12
"""Width of the labels in front of the printed lines."""
UNITS = {
    "m": ("metre", "metres", "meter", "meters", "mtr"),
    "rad": ("radian", "radians", "rads", "r"),
}
"""Units of y, and words that mean them."""
CONVERSIONS = {
    "mm": "1 mm = 0.001 m",
    "cm": "1 cm = 0.01 m",
    "inch": "1 inch = 0.0254 m",
    "in": "1 inch = 0.0254 m",
    "deg": "1 degree = 0.0174533 rad",
    "degree": "1 degree = 0.0174533 rad",
    "degrees": "1 degree = 0.0174533 rad",
    "°": "1 degree = 0.0174533 rad",
}
"""Units that a plant file cannot have, and how to convert them."""


def parser() -> CommandParser:
    """Return the parser of the arguments of ``hil identify``."""
    command = CommandParser(prog="hil identify", description=DESCRIPTION, epilog=EPILOG)
    command.add_argument("records", nargs="+", type=Path, metavar="FILE", help="records, fitted in one model")
    command.add_argument("--axis", metavar="AXIS", help="axis of a recording (default: the excited one)")
    command.add_argument(
        "--validate",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help="record that is not fitted, to validate the model; may be repeated",
    )
    command.add_argument("--structure", default="OE(1,3,1)", metavar="TEXT", help="see below")
    command.add_argument(
        "--orders",
        action="store_true",
        help="compare the usual orders of the kind of --structure, and take the best BIC",
    )
    command.add_argument("--drift", action="store_true", help="estimate a slow drift of the output")
    command.add_argument("--columns", default=COLUMNS, metavar="T,U,Y", help=f"columns (default {COLUMNS})")
    command.add_argument("--sample-time", type=number, metavar="S", help="sample time of a table in s")
    command.add_argument(
        "--input-held",
        action="store_true",
        help="in gaps of a table, the actuator kept its last input (default: the input there is unknown)",
    )
    command.add_argument(
        "--unit", type=_unit_of_y, metavar="UNIT", help="unit of y in a table: m (default) or rad"
    )
    command.add_argument(
        "--condition",
        action="append",
        default=[],
        type=_condition,
        metavar="KEY=VALUE",
        help="condition of the experiment for the plant file, such as load_kg=3 or supply_kpa=400; may be "
        "repeated",
    )
    command.add_argument("--name", metavar="NAME", help="name of the plant (default: the axis)")
    command.add_argument("-o", "--output", type=Path, metavar="FILE", help="plant file")
    command.add_argument("--report", type=Path, metavar="HTML", help="report (default: beside it)")
    command.add_argument("--force", action="store_true", help="overwrite existing files")
    return command


def main(argv: list[str]) -> int:
    """Run ``hil identify`` and return the exit status. Raises HilError for records that allow no model."""
    # Set before numpy is loaded: on small matrices, threads cost more than they gain.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    options = parser().parse_args(argv)
    from rich.console import Console

    from design.identification.findings import RecordRefusedError, most_severe_first
    from design.identified_plant import identified_plant
    from design.output.identification_report import write_identification_report
    from hil.core.documents import to_json

    console = Console(highlight=False, soft_wrap=True, markup=False)
    fitted, validation = _read(options)
    unit = _unit(fitted + validation, options.unit)
    name = options.name or fitted[0].axis or options.records[0].stem
    plant_file = options.output or Path(f"{name}.plant.json")
    report_file = options.report or plant_file.with_name(plant_file.name.removesuffix(".json") + ".html")
    for path in (plant_file, report_file):
        if path.exists() and not options.force:
            raise DocumentError(f"{path} exists already; give another name, or --force to overwrite it")
    try:
        identification, table = _identify(fitted, validation, options)
    except RecordRefusedError as refused:
        raise DocumentError(f"no model was written:\n{refused}") from None
    found = [finding for record in fitted + validation for finding in record.findings]
    identification = replace(identification, findings=most_severe_first([*identification.findings, *found]))
    plant = identified_plant(
        identification,
        name=name,
        output_unit=unit,
        conditions={**fitted[0].conditions, **dict(options.condition)},
        recording=fitted[0].sha256,
    )
    plant_file.write_text(to_json(plant), encoding="utf-8")
    write_identification_report(identification, plant, report_file, table)
    print_identification(console, identification, unit, table)
    console.print(f"plant       {plant_file}")
    console.print(f"report      {report_file}")
    console.print(f"next        hil design {shlex.quote(str(plant_file))}")
    return 0


def _read(options: argparse.Namespace) -> tuple[list[Record], list[Record]]:
    from design.records import read_record

    columns = tuple(options.columns.split(","))
    if len(columns) != 3:
        raise DocumentError(f"--columns {options.columns}: name three columns, such as {COLUMNS}")
    if options.sample_time is not None and not (
        math.isfinite(options.sample_time) and options.sample_time > 0.0
    ):
        raise DocumentError(f"--sample-time {options.sample_time:g}: must be a time over 0 s")
    sides = [
        [
            read_record(
                path,
                axis=options.axis,
                columns=(columns[0], columns[1], columns[2]),
                sample_time_s=options.sample_time,
                unit=options.unit or "",
                input_held_in_gaps=options.input_held,
            )
            for path in paths
        ]
        for paths in (options.records, options.validate)
    ]
    return sides[0], sides[1]


def _unit_of_y(text: str) -> str:
    """Return the unit of y from an argument."""
    if text in UNITS:
        return text
    meant = next((unit for unit, words in UNITS.items() if text.lower() in words), None)
    hint = did_you_mean(text, UNITS) if meant is None else f"; did you mean {meant}?"
    factor = f"; convert y: {CONVERSIONS[text.lower()]}" if text.lower() in CONVERSIONS else ""
    raise argparse.ArgumentTypeError(f"{text!r} must be m or rad{factor or hint}")


def _condition(text: str) -> tuple[str, float | str]:
    """Return the name and the value of a condition from an argument."""
    key, equals, value = (part.strip() for part in text.partition("="))
    if not (key and equals and value):
        raise argparse.ArgumentTypeError(f"{text!r} is not KEY=VALUE, such as load_kg=3")
    try:
        figure = float(value)
    except ValueError:
        return key, value
    return key, figure if math.isfinite(figure) else value


def _unit(records: list[Record], given: str | None) -> Literal["m", "rad"]:
    """Return the unit of y. Raises DocumentError where the records contradict each other."""
    units = {record.unit for record in records if record.unit}
    if given:
        units.add(given)
    if len(units) > 1:
        raise DocumentError(f"the records are in {' and '.join(sorted(units))}; identify each axis apart")
    return "rad" if units == {"rad"} else "m"


def _identify(
    fitted: list[Record], validation: list[Record], options: argparse.Namespace
) -> tuple[Identification, OrderTable | None]:
    """Identify the model, after a search for its orders if that was asked for."""
    from design.identification.findings import refuse_if_needed
    from design.identification.identify import identify_experiments
    from design.identification.order_search import orders_of_kind, search_orders

    refuse_if_needed([finding for record in fitted + validation for finding in record.findings])
    others = [record.experiment for record in validation] or None
    structure: str = options.structure
    chosen = identify_experiments(
        [record.experiment for record in fitted],
        structure=structure,
        validation=others,
        drift=options.drift,
        expected=fitted[0].expected,
    )
    if not options.orders:
        return chosen, None
    table = search_orders(
        chosen.estimate.experiments,
        [comparison.experiment for comparison in chosen.validation],
        orders_of_kind(chosen.structure),
        drift=options.drift,
    )
    best = identify_experiments(
        [record.experiment for record in fitted],
        structure=table.best().structure,
        validation=others,
        drift=options.drift,
        expected=fitted[0].expected,
    )
    return best, table


def print_identification(
    console: Console, identification: Identification, unit: str, table: OrderTable | None
) -> None:
    """Print a model with its uncertainty, its fit and what speaks against it."""
    from rich.table import Table as Grid

    if table is not None:
        grid = Grid("orders", "fit %", "AIC", "BIC", box=None, pad_edge=False)
        for row in sorted(table.rows, key=lambda row: row.bic):
            grid.add_row(str(row.structure), f"{row.fit_percent:.2f}", f"{row.aic:.0f}", f"{row.bic:.0f}")
        console.print(grid)
    console.print(f"structure   {identification.structure}")
    console.print(
        f"fit         {identification.fit_percent:.2f} % on data that were not fitted, "
        f"{identification.estimation_fit_percent:.2f} % on those that were"
    )
    for label, text in model_lines(identification, unit):
        console.print(f"{label:11} {text}")
    for finding in identification.findings:
        style = {"refuse": "red", "warn": "yellow"}.get(finding.severity)
        console.print(labelled(finding.severity, str(finding), console.width), style=style)


def labelled(label: str, text: str, width: int) -> str:
    """Return a text behind its label, filled to ``width`` columns; further lines are indented."""
    indent = " " * LABEL_COLUMNS
    first = f"{label:{LABEL_COLUMNS - 1}} "
    return textwrap.fill(
        text,
        width,
        initial_indent=first,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )


def model_lines(identification: Identification, unit: str) -> list[tuple[str, str]]:
    """Return the properties of a model in words, each with its 95 % interval: (label, text)."""
    known = identification.properties
    lines = []
    if known.gain is not None:
        lines.append(("gain", f"{_interval(known.gain.value, known.gain.std)} {unit}/V"))
    if known.velocity_gain is not None:
        lines.append(
            ("velocity", f"{_interval(known.velocity_gain.value, known.velocity_gain.std)} {unit}/s/V")
        )
    real = [pole for pole in known.poles if abs(pole.value.imag) < 1e-9]
    for pole in real:
        lines.append(("pole", f"{_interval(pole.value.real, pole.std)} rad/s"))
    for mode in known.modes:
        frequency, damping = mode.natural_frequency_rad_s, mode.damping
        damped = _interval(damping.value, damping.std)
        lines.append(("mode", f"{_interval(frequency.value, frequency.std)} rad/s, damping {damped}"))
    for zero in known.zeros or ():
        if zero.value.imag >= 0.0:
            lines.append(("zero", f"{_root(zero)} rad/s"))
    dead = known.dead_time_s
    lines.append(("dead time", f"{_interval(1000.0 * dead.value, 1000.0 * dead.std)} ms"))
    return lines


def _root(root: Root) -> str:
    """Return a zero with the interval of its real part and, for a pair, of its imaginary part."""
    real, imaginary = (1.96 * math.sqrt(max(float(root.covariance[i, i]), 0.0)) for i in (0, 1))
    text = f"{root.value.real:.4g} ± {real:.2g}"
    if root.value.imag == 0.0:
        return text
    return f"{text}, imaginary part {root.value.imag:.4g} ± {imaginary:.2g}"


def _interval(value: float, std: float) -> str:
    return f"{value:.4g} ± {1.96 * std:.2g}" if std > 0.0 else f"{value:.4g}"
