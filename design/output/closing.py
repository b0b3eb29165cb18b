"""What ``hil design`` says in the terminal when a design is finished.

Words and a table alone; every figure in them comes from the design.
"""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from design.closed_loop.comparison import eps_text, table_rows
from design.models.measured_record import ModelFit
from design.models.plant import Plant, paper_plant
from design.output.advice import hints, warnings
from design.output.controller_files import runs_unstable
from design.synthesis.procedure import Design

AXES = ("vertical", "horizontal", "rotation")
AXIS_OF_UNIT = {"m": "vertical", "rad": "rotation"}
"""The axis of the shipped rig that the closing hint names, where the plant does not bear an axis' name."""


def tell(console: Console, design: Design, measured: ModelFit | None, directory: Path) -> int:
    """What was found, what speaks against it, what to do next. Returns 1 if it should not be run, else 0."""
    console.print(_table(design))
    values = ", ".join(f"{name} {value:.5g}" for name, value in design.designed.parameters.items())
    share = 100.0 * design.eps / design.problem.eps_opt
    console.print(f"\n[bold]{design.designed.name}[/bold]  {values}")
    console.print(f"ε {design.eps:.4f}, {share:.1f} % of what any controller could have with this weight")
    for guarantee in design.guarantees:
        sure = "guaranteed stable" if guarantee.guaranteed else "not guaranteed by ε alone"
        console.print(
            f"plant {guarantee.plant.name}: ν-gap {guarantee.gap:.3f}, {sure}; "
            f"ε there {eps_text(guarantee.eps_there)}"
        )
    for note in design.notes:
        console.print(f"not compared: {note}")
    for hint in hints(design):
        console.print(hint, style="yellow")
    if measured is not None:
        console.print(f"the model follows {measured.source} to {measured.fit_percent:.1f} %", markup=False)
    unstable = [c.name for c, m in zip(design.candidates, design.measures, strict=True) if runs_unstable(m)]
    if unstable:
        console.print(f"not written, unstable in the rig's loop: {', '.join(unstable)}")
    against = warnings(design)
    if measured is not None and measured.doubt:
        against.append(measured.doubt)
    for warning in against:
        console.print(warning, style="red", markup=False)
    controller = directory / "controller.json"
    where = [f"\nreport      {directory / 'report.html'}"]
    is_written = not runs_unstable(design.measures[0])
    if is_written:
        where.append(f"controller  {controller}")
    is_to_be_run = is_written and not against
    if not is_to_be_run:
        where.append("next        put right what is said above: this controller should not be run as it is")
    else:
        where.append(f"next        {_next_command(design.plant, controller)}")
    console.print("\n".join(where), soft_wrap=True, markup=False)
    return 0 if is_to_be_run else 1


def _table(design: Design) -> Table:
    """The comparison, for the terminal."""
    table = Table("", "", box=None, pad_edge=False)
    for i, candidate in enumerate(design.candidates):
        table.add_column(candidate.name, justify="right", style="bold" if i == 0 else None)
    for row in table_rows(design.plant.output_unit):
        table.add_row(row.label, row.unit, *(row.text(m) for m in design.measures))
    return table


def _next_command(plant: Plant, controller: Path) -> str:
    """How to run what was designed, on what it was designed for."""
    paper = paper_plant()
    axis = plant.name if plant.name in AXES else AXIS_OF_UNIT[plant.output_unit]
    if (plant.name, plant.num, plant.den) == (paper.name, paper.num, paper.den):
        return (
            f"hil run --linear --controller {axis}={controller}\n"
            "            --linear is eq. (15) itself; the simulated arm's own vertical axis comes near it "
            "but is another plant: hil design vertical"
        )
    return f"hil run --controller {axis}={controller}"
