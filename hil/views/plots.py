"""Plots a run: setpoint, position and valve voltage of every axis over time. It needs no display.

Only this module imports matplotlib.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hil.core.errors import RecordingError
from hil.core.output import LogEntry, Severity
from hil.core.wire.codec import TPDO1_ADC
from hil.recording.reader import Recording
from hil.recording.recorder import ARM_EVENTS
from hil.views.life_cycle_stays import Stay
from hil.views.loop_figures import loop_figures
from hil.views.report_series import extremes
from hil.views.run_columns import AxisColumns, axis_columns

BLUE, GREEN, VERMILION, GREY = "#0072B2", "#009E73", "#D55E00", "#666666"
"""Colours of Okabe and Ito's palette, which colour-blind readers can distinguish."""
PANEL_WIDTH_IN, HEIGHT_IN, DPI = 5.0, 5.6, 130
LABEL_IN_PER_LETTER = 0.075
MIN_POSITION_SPAN = {"m": 0.01, "rad": 0.1}
"""Smallest range of a position panel, by unit. A smaller one would magnify the converter's noise."""
MIN_VALVE_SPAN_V = 1.0
"""Smallest range of a valve voltage panel."""


def plot_run(recording: Recording, path: Path, axes: Sequence[str] = (), title: str = "") -> None:
    """Write the run as a PNG with one column for each axis. Time 0 is the first period under control.

    ``axes``: names of the axes to draw, all if empty. ``title``: text above the plot; a fault replaces it.
    States other than running are shaded. Faults and the planned events of a simulated arm are marked and
    named. Raises RecordingError when there is nothing to draw, or ``path`` cannot be written.
    """
    loop = loop_figures(recording)
    if loop.periods == 0:
        raise RecordingError(f"{recording.path}: has no period, so there is nothing to draw")
    start_s, stays = loop.start_s, loop.stays()
    faults = [
        (recording.seconds(now_ns) - start_s, entry)
        for now_ns, entry in recording.log()
        if entry.severity >= Severity.FATAL
    ]
    names = list(axes) or list(recording.axes)
    figure = Figure(figsize=(PANEL_WIDTH_IN * len(names), HEIGHT_IN), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    marks = _event_marks(recording, start_s)
    panels = figure.subplots(2, len(names), sharex=True, squeeze=False, height_ratios=(3, 2))
    for name, (upper, lower) in zip(names, panels.T, strict=True):
        upper.set_title(name, parse_math=False)
        _draw_axis(upper, lower, axis_columns(recording, name), start_s)
        _label_stays(upper, stays)
        _mark_events(upper, lower, marks)
        for panel in (upper, lower):
            _shade_stays(panel, stays)
            for fault_s, _ in faults:
                panel.axvline(fault_s, color=VERMILION, linewidth=1.2)
    panels[0, 0].legend(loc="best", fontsize=8)
    if faults:
        figure.suptitle(_fault_text(faults[0][1]), color=VERMILION, fontsize=10, wrap=True, parse_math=False)
    elif title:
        figure.suptitle(title, fontsize=10, wrap=True, parse_math=False)
    try:
        figure.savefig(path, format="png")
    except OSError as error:
        path.unlink(missing_ok=True)
        raise RecordingError(f"{path}: the plot cannot be written: {error.strerror}") from None


def _draw_axis(upper: Axes, lower: Axes, axis: AxisColumns, start_s: float) -> None:
    times_s = axis.time_s - start_s
    setpoint, position, command_v = (
        extremes(times_s, values) for values in (axis.setpoint, axis.position, axis.command_v)
    )
    upper.step(*setpoint, where="post", color="black", linewidth=1.0, label="setpoint")
    upper.plot(*position, color=BLUE, linewidth=1.4, label="position")
    upper.set_ylabel(f"position ({axis.unit})", parse_math=False)
    lower.step(*command_v, where="post", color=GREEN, linewidth=1.0)
    lower.set_ylabel("valve voltage (V)")
    lower.set_xlabel("time (s)")
    for panel in (upper, lower):
        panel.grid(True, linewidth=0.4, alpha=0.5)
        panel.margins(x=0.0, y=0.1)
    _widen(upper, MIN_POSITION_SPAN.get(axis.unit, 0.0))
    _widen(lower, MIN_VALVE_SPAN_V)


def _widen(panel: Axes, min_span: float) -> None:
    """Extend the range of the panel to ``min_span`` around its middle."""
    low, high = panel.get_ylim()
    missing = min_span - (high - low)
    if missing > 0.0:
        panel.set_ylim(low - missing / 2, high + missing / 2)


def _shade_stays(panel: Axes, stays: list[Stay]) -> None:
    for state, from_s, to_s in stays:
        if state != "running":
            panel.axvspan(
                from_s, to_s, color=VERMILION if state == "fault" else GREY, alpha=0.15, linewidth=0
            )


def _label_stays(panel: Axes, stays: list[Stay]) -> None:
    """Label the states whose area is wider than the label."""
    whole_s = stays[-1].to_s - stays[0].from_s
    for state, from_s, to_s in stays:
        if (to_s - from_s) * PANEL_WIDTH_IN > LABEL_IN_PER_LETTER * len(state) * whole_s:
            panel.text(
                (from_s + to_s) / 2, 0.99, state, transform=panel.get_xaxis_transform(),
                ha="center", va="top", fontsize=7, color=GREY,
            )  # fmt: skip


def _event_marks(recording: Recording, start_s: float) -> list[tuple[float, str]]:
    """Return the times and names of the planned events of a simulated arm."""
    planned = recording.metadata.get(ARM_EVENTS, {})
    samples = recording.frames("received", TPDO1_ADC)
    if not planned or len(samples) == 0:
        return []
    first_s = float(samples.time_s[0]) - start_s
    at_once: dict[float, list[str]] = {}
    for text, at_s in planned.items():
        at_once.setdefault(first_s + float(at_s), []).append(text.partition("@")[0])
    return [(at_s, ", ".join(names)) for at_s, names in at_once.items()]


def _mark_events(upper: Axes, lower: Axes, marks: list[tuple[float, str]]) -> None:
    """Draw a thin line through both panels for each event within the run, with its name at the inner side."""
    first_s, last_s = upper.get_xlim()
    for at_s, text in marks:
        if not first_s <= at_s <= last_s:
            continue
        for panel in (upper, lower):
            panel.axvline(at_s, color=GREY, linewidth=0.8, linestyle=":")
        is_early = at_s < (first_s + last_s) / 2
        upper.annotate(
            text, (at_s, 0.02), xycoords=upper.get_xaxis_transform(), rotation=90, fontsize=6, color=GREY,
            xytext=(3 if is_early else -3, 0), textcoords="offset points", va="bottom",
            ha="left" if is_early else "right", zorder=1.0, parse_math=False,
        )  # fmt: skip


def _fault_text(fault: LogEntry) -> str:
    return f"fault: {fault.source}: {fault.text}"
