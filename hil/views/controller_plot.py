"""Draws what another controller would have commanded beside what was commanded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hil.recording.tables import AxisTable, FloatArray
from hil.views.plots import BLUE, DPI, GREEN, MIN_VALVE_SPAN_V, PANEL_WIDTH_IN, VERMILION

HEIGHT_IN = 7.0
TITLE = "Open loop: the recorded measurements do not react to the other controller"


def plot_commands(
    path: Path, axes: Sequence[tuple[AxisTable, FloatArray, FloatArray, str, str]], file_format: str = "png"
) -> None:
    """Write a PNG with one column for each axis: measurements, commands, and their difference.

    Each entry of ``axes``: the recorded signals, the other command in V, the difference in V, and the names
    of the recorded and the other controller. Raises OSError when ``path`` cannot be written.
    """
    figure = Figure(figsize=(1.6 * PANEL_WIDTH_IN * len(axes), HEIGHT_IN), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(TITLE, fontsize=10)
    panels = figure.subplots(3, len(axes), sharex=True, squeeze=False, height_ratios=(3, 3, 2))
    for (table, other_v, difference_v, recorded_name, other_name), column in zip(axes, panels.T, strict=True):
        upper, middle, lower = column
        upper.set_title(table.name, parse_math=False)
        upper.step(table.time_s, table.setpoint, where="post", color="black", linewidth=1.0, label="setpoint")
        upper.plot(table.time_s, table.position, color=BLUE, linewidth=1.4, label="measured position")
        upper.set_ylabel(f"position ({table.unit})", parse_math=False)
        middle.step(
            table.time_s, table.command_v, where="post", color=GREEN, linewidth=1.2,
            label=_label(recorded_name, "commanded"),
        )  # fmt: skip
        middle.step(
            table.time_s, other_v, where="post", color=VERMILION, linewidth=1.0,
            label=_label(other_name, "would have commanded"),
        )  # fmt: skip
        middle.set_ylabel("valve voltage (V)")
        lower.step(table.time_s, difference_v, where="post", color=VERMILION, linewidth=1.0)
        lower.set_ylabel("difference (V)")
        lower.set_xlabel("time (s)")
        _widen(lower, MIN_VALVE_SPAN_V)
        for panel in column:
            panel.grid(True, linewidth=0.4, alpha=0.5)
            panel.margins(x=0.0, y=0.1)
        for panel in (upper, middle):
            panel.legend(loc="best", fontsize=8)
    figure.savefig(path, format=file_format)


def _label(name: str, what: str) -> str:
    return f"{name.replace('$', '')}: {what}"


def _widen(panel: Axes, min_span: float) -> None:
    """Extend the range of the panel to ``min_span`` around its middle, so that noise is not magnified."""
    low, high = panel.get_ylim()
    missing = min_span - (high - low)
    if missing > 0.0:
        panel.set_ylim(low - missing / 2, high + missing / 2)
