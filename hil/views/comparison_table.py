"""Prints a comparison of two recordings: a table of the differences, and what else is not equal."""

from __future__ import annotations

import math

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from hil.views.comparison import Comparison, SignalDifference

_NAMES = {"command_v": "valve"}
MAX_WIDTH = 80
"""Width of the text in columns, unless the terminal is narrower."""


def render(comparison: Comparison) -> RenderableType:
    """Return the comparison as lines of text and a table, which fit into 80 columns."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for header in ("axis", "signal", "RMS", "largest", "at (s)", "first", "second"):
        table.add_column(header, justify="left" if header in ("axis", "signal") else "right", overflow="fold")
    for row in comparison.signals:
        table.add_row(row.axis, _label(row), *_figures(row))
    lines = [
        f"aligned on the {comparison.event.value}: {comparison.first_event_s:.3f} s in the first run, "
        f"{comparison.second_event_s:.3f} s in the second",
        f"under control for {comparison.first_controlled_s:.3f} s in the first run, "
        f"{comparison.second_controlled_s:.3f} s in the second",
        f"{comparison.samples} periods of each axis compared, from {comparison.from_s:.3f} to "
        f"{comparison.to_s:.3f} s from the event",
    ]
    if comparison.shift_periods:
        periods = f"{comparison.shift_periods:+d} period{'s' * (abs(comparison.shift_periods) != 1)}"
        lines.append(
            "the start of control is estimated in an imported log: that of the second run was moved by "
            f"{periods}, where the positions agree best"
        )
    for which, names in (("first", comparison.only_first), ("second", comparison.only_second)):
        if names:
            lines.append(f"only the {which} run has {', '.join(names)}")
    if comparison.documents:
        lines.append(f"documents that are not equal: {', '.join(comparison.documents)}")
    if comparison.settings:
        lines.append("settings that are not equal (first, second):")
    settings = [Padding(Text(text), (0, 0, 0, 2), expand=False) for text in comparison.settings]
    missing = [Text(text) for text in _missing(comparison)]
    return Group(*(Text(line) for line in lines), *settings, table, *missing)


def signal_name(row: SignalDifference) -> str:
    """Return the name of a signal as people read it and as ``--tolerance`` takes it."""
    return _NAMES.get(row.signal, row.signal)


def _label(row: SignalDifference) -> str:
    return f"{signal_name(row)} ({row.unit})"


def _figures(row: SignalDifference) -> tuple[str, ...]:
    if math.isnan(row.largest):
        return ("–",) * 5
    return (
        *(f"{value:.3g}" for value in (row.rms, row.largest)),
        f"{row.at_s:.3f}",
        *(f"{value:.4g}" for value in (row.first, row.second)),
    )


def _missing(comparison: Comparison) -> list[str]:
    """Return lines about signals that only one of the runs has, in some periods or in all."""
    lines = []
    for which in ("first", "second"):
        counts = {row: getattr(row, f"only_{which}") for row in comparison.signals}
        lines += [
            f"only the {which} run has {row.axis} {signal_name(row)} in {count} of "
            f"{comparison.samples} periods"
            for row, count in counts.items()
            if count
        ]
    return lines
