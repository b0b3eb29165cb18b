"""Prints a comparison of two recordings: a table of the differences, and what else is not equal."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hil.views.comparison import Comparison

_NAMES = {"command_v": "valve voltage"}


def render(comparison: Comparison) -> RenderableType:
    """Return the comparison as a table and lines of text."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for header in ("axis", "signal", "RMS", "largest", "at (s)", "first", "second"):
        table.add_column(header, justify="left" if header in ("axis", "signal") else "right", overflow="fold")
    for row in comparison.signals:
        table.add_row(
            row.axis,
            f"{_NAMES.get(row.signal, row.signal)} ({row.unit})",
            *(f"{value:.3g}" for value in (row.rms, row.largest)),
            f"{row.at_s:.3f}",
            *(f"{value:.5g}" for value in (row.first, row.second)),
        )
    lines = [
        f"aligned on the {comparison.event.value}: {comparison.first_event_s:.3f} s in the first run, "
        f"{comparison.second_event_s:.3f} s in the second",
        f"under control for {comparison.first_controlled_s:.3f} s in the first run, "
        f"{comparison.second_controlled_s:.3f} s in the second",
        f"{comparison.samples} samples of each axis compared, from {comparison.from_s:.3f} to "
        f"{comparison.to_s:.3f} s",
    ]
    for which, names in (("first", comparison.only_first), ("second", comparison.only_second)):
        if names:
            lines.append(f"only the {which} run has {', '.join(names)}")
    if comparison.documents:
        lines.append(f"not equal: {', '.join(comparison.documents)}")
    return Group(*(Text(line) for line in lines), table)
