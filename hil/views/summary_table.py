"""Prints the summary of a run: tables of the axes and of the loop, counts, and what was lost."""

from __future__ import annotations

from dataclasses import astuple

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from hil.views.summary import StepResponse, Summary, losses

_WITHOUT_SAMPLE = """\
(without a sample: the gateway sent no SYNC, because the loop was late or to
check for late samples, or no good sample came)
"""
"""Explanation of the periods that have no sample although no frame was lost."""


def render(summary: Summary) -> RenderableType:
    """Return the summary as tables and lines of text. Tables of usual values fit into 80 columns."""
    steps = _table("axis", "step", "over-\nshoot", "rise", "2 %\nsettling", "steady-state\nerror", "valve")
    tracking = _table("axis", "RMS error", "largest error", "delay", "valve")
    for name, axis in summary.axes.items():
        unit = axis.unit
        valve = f"{axis.min_valve_v:.2f}…{axis.max_valve_v:.2f} V"
        if isinstance(axis, StepResponse):
            steps.add_row(
                name,
                f"{axis.step_from:.4g}→{axis.step_to:.4g} {unit}",
                f"{axis.overshoot_percent:.2f} %",
                "none" if axis.rise_s is None else f"{axis.rise_s:.2f} s",
                "not settled" if axis.settling_s is None else f"{axis.settling_s:.2f} s",
                f"{1e3 * axis.steady_state_error:.2f} m{unit}",
                valve,
            )
        else:
            rms, largest = 1e3 * axis.rms_error, 1e3 * axis.max_error
            delay = "unknown" if axis.delay_s is None else f"{1e3 * axis.delay_s:.0f} ms"
            tracking.add_row(name, f"{rms:.2f} m{unit}", f"{largest:.2f} m{unit}", delay, valve)
    tables = [table for table in (steps, tracking) if table.row_count]
    notes = [] if summary.complete else ["The recording was cut off. The figures are those of its contents."]
    if summary.ending == "interrupted":
        requested = "" if summary.requested_s is None else f" of {summary.requested_s:g}"
        notes.append(f"interrupted after {summary.controlled_s:.0f} s{requested}")
    if _has_timing(summary):
        tables.append(_loop_table(summary))
    parts = [part for table in tables for part in (_Whole(table), "")]
    return Group(*parts, _counts(summary), _losses(summary), *notes)


class _Whole:
    """A table that loses no text. If the output is not a terminal, its lines may exceed the width."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        may_exceed_width = options.overflow == "ignore" and not console.is_terminal
        if may_exceed_width:
            unlimited = options.update(max_width=10_000)
            width = Measurement.get(console, unlimited, self._table).maximum
            options = options.update(width=max(width, options.max_width))
        yield from console.render(self._table, options)


def _table(*headers: str) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
    for header in headers:
        table.add_column(header, overflow="fold")
    return table


def _has_timing(summary: Summary) -> bool:
    """Return whether the timing is of interest: in simulated time, every period is punctual."""
    measured = [quantiles for quantiles in (summary.lateness, summary.response) if quantiles is not None]
    return not measured or any(quantiles.max_us > 0.0 for quantiles in measured)


def _loop_table(summary: Summary) -> Table:
    table = _table("loop", "p50", "p99", "p99.9", "max")
    for name, quantiles in (("lateness", summary.lateness), ("response", summary.response)):
        table.add_row(
            name, *(f"{value:.0f} µs" for value in astuple(quantiles)) if quantiles else ["unknown"] * 4
        )
    return table


def _counts(summary: Summary) -> str:
    bring_up = f" ({summary.bring_up_periods} before the boards were up)" if summary.bring_up_periods else ""
    load = "" if summary.bus_load is None else f", bus load {100 * summary.bus_load:.1f} %"
    return (
        f"{summary.periods} periods{bring_up}, {summary.missed_periods} skipped, "
        f"{summary.periods_without_sample} without a sample\n"
        f"{_WITHOUT_SAMPLE if summary.periods_without_sample else ''}"
        f"{summary.frames_received} frames received, {summary.frames_sent} sent{load}"
    )


def _losses(summary: Summary) -> Text:
    """Return a line that highlights all losses, or states that there were none."""
    lost = losses(summary)
    if lost:
        return Text(f"ATTENTION: {', '.join(lost)}", style="bold red")
    return Text("of these frames, nothing dropped, rejected or lost" if summary.complete else "")
