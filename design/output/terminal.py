"""Print the results of ``hil design`` to the terminal.

Only words and tables: every figure and every decision comes from the design and its recommendation. On a
terminal no word is cut: text is wrapped at blanks, and a table that is too wide is printed in parts. Piped
output is not wrapped.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from design.closed_loop.comparison import eps_text, table_rows
from design.models.measured_record import ModelFit
from design.output.results import WrittenDesign
from design.output.run_command import run_command, run_notes
from design.paper.checked_claim import CheckedClaim
from design.paper.reproduction import Reproduction
from design.synthesis.procedure import Design, Guarantee
from design.synthesis.recommendation import Action, Recommendation

_UNLIMITED_WIDTH = 10_000
"""Width of piped output, which nothing reaches."""


def make_console() -> Console:
    """Return a console on stdout that is as wide as the terminal, or unlimited if the output is piped."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = _UNLIMITED_WIDTH
    return console


def print_design(
    console: Console,
    design: Design,
    written: WrittenDesign,
    measured: ModelFit | None,
    plant_file: Path | None,
) -> None:
    """Print the comparison, the designed controller, objections, the written files, and what to do next.

    ``plant_file`` is the file of a user's own plant; None means a shipped plant.
    """
    _print_comparison(console, design)
    values = ", ".join(f"{name} {value:.5g}" for name, value in design.designed.parameters.items())
    share_percent = 100.0 * design.eps / design.problem.eps_opt
    print_wrapped(console, "")
    print_wrapped(console, f"{design.designed.name}  {values}", "bold")
    print_wrapped(
        console,
        f"ε {design.eps:.4f}: {share_percent:.1f} % of the largest margin that any controller has with this "
        "weight",
    )
    for guarantee in design.guarantees:
        print_wrapped(console, _guarantee_text(guarantee))
    if measured is not None:
        print_wrapped(console, f"the model follows {measured.source} to {measured.fit_percent:.1f} %")
    _print_recommendation(console, design, written.recommendation)
    _print_files(console, design, written, plant_file)


def print_reproduction(console: Console, reproduction: Reproduction, report: Path) -> None:
    """Print every claim of the paper, why some differ, and a summary."""
    _print_claims(console, reproduction.claims)
    for claim in reproduction.claims:
        if not claim.agrees:
            print_wrapped(console, f"{claim.where}, {claim.what}: {claim.explanation}")
    print_wrapped(
        console,
        f"{reproduction.agreeing} of {len(reproduction.claims)} reproduced, {reproduction.explained} differ "
        f"for the reasons above, {reproduction.failed} must agree and do not",
    )
    print_wrapped(console, f"report  {report}")


def _print_recommendation(console: Console, design: Design, recommendation: Recommendation) -> None:
    for note in design.notes:
        print_wrapped(console, f"not compared: {note}")
    if recommendation.unstable:
        names = ", ".join(recommendation.unstable)
        print_wrapped(console, f"no controller file, unstable in the rig's loop: {names}")
    for hint in recommendation.hints:
        print_wrapped(console, f"hint: {hint}", "yellow")
    for warning in recommendation.warnings:
        print_wrapped(console, f"warning from the plant file: {warning}", "yellow")
    for objection in recommendation.objections:
        print_wrapped(console, f"do not run: {objection}", "red")


def _print_files(console: Console, design: Design, written: WrittenDesign, plant_file: Path | None) -> None:
    print_wrapped(console, "")
    if written.earlier is not None:
        print_wrapped(console, f"earlier     results of another design were moved to {written.earlier}")
    print_wrapped(console, f"report      {written.report}")
    if written.controller is not None:
        print_wrapped(console, f"controller  {written.controller}")
    if written.controller is None or written.recommendation.action is not Action.RUN:
        print_wrapped(console, "next        correct what is said above; do not run this controller as it is")
        return
    # A command is not wrapped, so that it can be copied.
    command = run_command(design, written.controller, plant_file)
    console.print(Text(f"next        {command}"), soft_wrap=True)
    for note in run_notes(design, plant_file):
        print_wrapped(console, note, indent=12)


def _guarantee_text(guarantee: Guarantee) -> str:
    stability = (
        "stability is guaranteed" if guarantee.guaranteed else "stability is not guaranteed by ε alone"
    )
    return (
        f"plant {guarantee.plant.name}: ν-gap {guarantee.gap:.3f}, {stability}; "
        f"ε on this plant {eps_text(guarantee.eps_there)}"
    )


def _print_comparison(console: Console, design: Design) -> None:
    """Print the comparison of all candidates, in several tables if one is too wide."""
    count = len(design.candidates)
    for per_table in range(count, 0, -1):
        tables = [
            _comparison_table(design, range(start, min(start + per_table, count)))
            for start in range(0, count, per_table)
        ]
        if per_table == 1 or all(_fits(console, table) for table in tables):
            for table in tables:
                console.print(table)
            return


def _comparison_table(design: Design, columns: Sequence[int]) -> Table:
    table = Table("", "", box=None, pad_edge=False)
    for i in columns:
        style = "bold" if i == 0 else None
        table.add_column(Text(design.candidates[i].name), justify="right", style=style)
    for row in table_rows(design.plant.output_unit):
        table.add_row(row.label, row.unit, *(row.text(design.measures[i]) for i in columns))
    return table


def _print_claims(console: Console, claims: Sequence[CheckedClaim]) -> None:
    """Print the claims as a table, or, if it is too wide, each in two lines."""
    table = Table("place", "figure or statement", "paper", "computed", "result", box=None, pad_edge=False)
    for claim in claims:
        result = Text(claim.result, _style(claim))
        table.add_row(*map(Text, (claim.where, claim.what, claim.printed, claim.computed)), result)
    if _fits(console, table):
        console.print(table)
        return
    for claim in claims:
        print_wrapped(console, f"{claim.where}, {claim.what}: {claim.result}", _style(claim))
        print_wrapped(console, f"paper: {claim.printed}; computed: {claim.computed}", indent=4)


def _style(claim: CheckedClaim) -> str:
    if claim.has_failed:
        return "red"
    return "green" if claim.agrees else "yellow"


def print_wrapped(console: Console, text: str, style: str = "", indent: int = 0) -> None:
    """Print a text, its lines wrapped at blanks; what is wrapped keeps the indentation of its line."""
    for line in text.split("\n"):
        blanks = " " * (indent + len(line) - len(line.lstrip()))
        wrapped = textwrap.fill(
            line.strip(),
            console.width,
            initial_indent=blanks,
            subsequent_indent=blanks,
            break_long_words=False,
            break_on_hyphens=False,
        )
        console.print(Text(wrapped, style), soft_wrap=True)


def _fits(console: Console, table: Table) -> bool:
    options = console.options.update(width=_UNLIMITED_WIDTH)
    return Measurement.get(console, options, table).maximum <= console.width
