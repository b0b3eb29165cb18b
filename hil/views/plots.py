"""The picture of a run: setpoint, position and valve voltage of every axis over time. Needs no display.

matplotlib is imported here alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hil.core.errors import RecordingError
from hil.core.output import LogEntry, Severity
from hil.core.wire.codec import TPDO1_ADC
from hil.recording.reader import Recording
from hil.recording.recorder import ARM_EVENTS
from hil.recording.tables import AxisTable, TimingTable

BLUE, GREEN, VERMILION, GREY = "#0072B2", "#009E73", "#D55E00", "#666666"
"""From Okabe and Ito's palette, told apart by colour-blind readers."""
PANEL_WIDTH_IN, HEIGHT_IN, DPI = 5.0, 5.6, 130
LABEL_IN_PER_LETTER = 0.075


class _Stay(NamedTuple):
    """A stay in one state of the life cycle, in seconds of the plot's time."""

    state: str
    from_s: float
    to_s: float


def plot_run(recording: Recording, path: Path, axes: Sequence[str] = (), title: str = "") -> None:
    """Write the run as a PNG: a column an axis. Time 0 is where the controllers began to act.

    ``axes`` are those to draw, all of them when empty; ``title`` stands above a run without a fault. States
    other than running are shaded; faults, and what was planned for a simulated arm, are marked and named.
    Raises RecordingError when there is nothing to draw, or ``path`` cannot be written.
    """
    timing = recording.timing()
    if len(timing) == 0:
        raise RecordingError(f"{recording.path}: holds no period, so there is nothing to draw")
    start_ns = _start_ns(timing, recording.state_names)
    stays = _stays(timing, recording.state_names, start_ns)
    faults = [(now_ns, event) for now_ns, event in recording.log() if event.severity >= Severity.FATAL]
    units = {name: recording.axes[name] for name in axes or recording.axes}
    figure = Figure(figsize=(PANEL_WIDTH_IN * len(units), HEIGHT_IN), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    marks = _event_marks(recording, start_ns)
    panels = figure.subplots(2, len(units), sharex=True, squeeze=False, height_ratios=(3, 2))
    for (name, unit), (upper, lower) in zip(units.items(), panels.T, strict=True):
        upper.set_title(name)
        _draw_axis(upper, lower, recording.axis(name), start_ns, unit)
        _label_stays(upper, stays)
        _mark_events(upper, lower, marks)
        for panel in (upper, lower):
            _shade_stays(panel, stays)
            for now_ns, _ in faults:
                panel.axvline((now_ns - start_ns) * 1e-9, color=VERMILION, linewidth=1.2)
    panels[0, 0].legend(loc="best", fontsize=8)
    if faults:
        figure.suptitle(_fault_text(faults[0][1]), color=VERMILION, fontsize=10)
    elif title:
        figure.suptitle(title, fontsize=10, wrap=True)
    try:
        figure.savefig(path, format="png")
    except OSError as error:
        path.unlink(missing_ok=True)
        raise RecordingError(f"{path}: the plot cannot be written: {error.strerror}") from None


def _draw_axis(upper: Axes, lower: Axes, rows: AxisTable, start_ns: int, unit: str) -> None:
    times_s = (rows["time_ns"] - start_ns) * 1e-9
    upper.step(times_s, rows["setpoint"], where="post", color="black", linewidth=1.0, label="setpoint")
    upper.plot(times_s, rows["position"], color=BLUE, linewidth=1.4, label="position")
    upper.set_ylabel(f"position ({unit})")
    lower.step(times_s, rows["command_v"], where="post", color=GREEN, linewidth=1.0)
    lower.set_ylabel("valve voltage (V)")
    lower.set_xlabel("time (s)")
    for panel in (upper, lower):
        panel.grid(True, linewidth=0.4, alpha=0.5)
        panel.margins(x=0.0, y=0.1)


def _shade_stays(panel: Axes, stays: list[_Stay]) -> None:
    for state, from_s, to_s in stays:
        if state != "running":
            panel.axvspan(
                from_s, to_s, color=VERMILION if state == "fault" else GREY, alpha=0.15, linewidth=0
            )


def _label_stays(panel: Axes, stays: list[_Stay]) -> None:
    """Name each state that there is room for."""
    whole_s = stays[-1].to_s - stays[0].from_s
    for state, from_s, to_s in stays:
        if (to_s - from_s) * PANEL_WIDTH_IN > LABEL_IN_PER_LETTER * len(state) * whole_s:
            panel.text(
                (from_s + to_s) / 2, 0.99, state, transform=panel.get_xaxis_transform(),
                ha="center", va="top", fontsize=7, color=GREY,
            )  # fmt: skip


def _event_marks(recording: Recording, start_ns: int) -> list[tuple[float, str]]:
    """What happened to a simulated arm: seconds of the plot's time, and its name."""
    planned = recording.metadata.get(ARM_EVENTS, {})
    samples_ns = recording.frames("received", TPDO1_ADC).time_ns
    if not planned or len(samples_ns) == 0:
        return []
    first_s = (int(samples_ns[0]) - start_ns) * 1e-9
    at_once: dict[float, list[str]] = {}
    for text, at_s in planned.items():
        at_once.setdefault(first_s + float(at_s), []).append(text.partition("@")[0])
    return [(at_s, ", ".join(names)) for at_s, names in at_once.items()]


def _mark_events(upper: Axes, lower: Axes, marks: list[tuple[float, str]]) -> None:
    """A thin line through both panels, and the name on its inner side, where it lies within the run."""
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
            ha="left" if is_early else "right", zorder=1.0,
        )  # fmt: skip


def _fault_text(fault: LogEntry) -> str:
    return f"fault: {fault.source}: {fault.text}"


def _start_ns(timing: TimingTable, names: dict[int, str]) -> int:
    """When the first period began in which the controllers acted; without one, the first period."""
    running = [value for value, name in names.items() if name == "running"]
    return int(timing["wake_ns"][np.argmax(np.isin(timing["state"], running))])


def _stays(timing: TimingTable, names: dict[int, str], start_ns: int) -> list[_Stay]:
    states, times_s = timing["state"], (timing["wake_ns"] - start_ns) * 1e-9
    entered = [0, *(np.flatnonzero(np.diff(states)) + 1)]
    left = [*entered[1:], len(states) - 1]
    return [
        _Stay(names.get(int(states[i]), f"state {states[i]}"), float(times_s[i]), float(times_s[j]))
        for i, j in zip(entered, left, strict=True)
    ]
