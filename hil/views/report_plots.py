"""The plots of a report: for each axis, and for the timing of the loop and the frames.

Each signal is reduced to its extreme values in time slots while the recording is read window by window.
Neither the page nor the memory grows with the length of the run.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np

from hil.core.wire.codec import RPDO1_DAC, SYNC, TPDO1_ADC
from hil.recording.reader import Recording
from hil.recording.schemas import AXIS_TOPIC
from hil.recording.tables import FloatArray
from hil.views.axis_figures import AxisFigures, StepResponse, Tracking
from hil.views.loop_figures import WINDOW_S, LoopFigures, timing_windows
from hil.views.report_series import Slots, SlotSeries
from hil.views.summary import min_steps

MIN_SPAN = {"m": 0.01, "rad": 0.1, "V": 1.0, "µs": 20.0, "1/s": 1.0}
"""Smallest range of a plot's vertical axis, by unit. A smaller one would magnify the converter's noise."""
MAX_RATE_SLOTS, MIN_RATE_SLOT_S = 600, 1.0
MAX_RATE_CURVES = 6
FRAME_NAMES = {SYNC: "SYNC", TPDO1_ADC: "sample", RPDO1_DAC: "valve command"}
_DIRECTIONS: tuple[Literal["received", "sent", "refused"], ...] = ("received", "sent", "refused")
_COLOURS = ("c1", "c2", "c3", "c4", "c5", "c6")
_MIN_PERIOD_S = 1e-6


class _Signal(NamedTuple):
    """A curve of an axis. With ``holds``, a value is drawn as holding until the next one."""

    column: str
    label: str
    colour: str
    holds: bool = False


_AXIS_PANELS = (
    (
        "position",
        "",
        190,
        (_Signal("setpoint", "setpoint", "ink", True), _Signal("position", "position", "c1")),
    ),
    ("error", "", 100, (_Signal("error", "error", "c3"),)),
    ("valve", "V", 110, (_Signal("command_v", "valve voltage", "c2", True),)),
)
"""Name, unit (empty: that of the axis), height in pixels and signals of each panel of an axis."""


class AxisPlots(NamedTuple):
    """The plots of an axis, and its figures."""

    name: str
    panels: list[dict[str, Any]]
    figures: StepResponse | Tracking | None


class Plots:
    """Makes the plots of one recording that has periods."""

    def __init__(self, recording: Recording, loop: LoopFigures) -> None:
        self._recording = recording
        self._loop = loop
        self._min_steps = min_steps(recording.documents.get("rig.toml", ""))
        self._slots = Slots.over(loop.first_s, loop.last_s, max(loop.period_s, _MIN_PERIOD_S))

    def axis(self, name: str) -> AxisPlots:
        """Read an axis."""
        unit = self._recording.axes[name]
        figures = AxisFigures(unit, self._min_steps.get(name, 0.0))
        slots = self._slots_of(name)
        series = {signal.column: SlotSeries(slots) for *_, signals in _AXIS_PANELS for signal in signals}
        for window in self._recording.windows(WINDOW_S):
            table = window.axis(name)
            figures.add(table)
            for column, values in series.items():
                values.add(table.time_s, table[column])
        panels = []
        for label, own_unit, height, signals in _AXIS_PANELS:
            shown = own_unit or unit
            curves = [self._curve(s.label, s.colour, series[s.column], s.holds) for s in signals]
            panels.append(_panel(f"{label} ({shown})", shown, height, curves))
        return AxisPlots(name, panels, figures.result())

    def _slots_of(self, axis: str) -> Slots:
        """Return wider slots for an axis that lacks most of its messages, so that its curve has no gaps."""
        count = self._recording.counts[AXIS_TOPIC + axis]
        if count >= self._slots.count // 2:
            return self._slots
        time_s = self._recording.axis(axis).time_s
        return _slots_over(time_s)

    def loop(self) -> list[dict[str, Any]]:
        """Return the panels of the loop's timing and of the frames."""
        lateness, response = SlotSeries(self._slots), SlotSeries(self._slots)
        for timing, response_ns in timing_windows(self._recording):
            lateness.add(timing.time_s, (timing.wake_ns - timing.deadline_ns) * 1e-3)
            response.add(timing.time_s, np.where(response_ns >= 0, response_ns * 1e-3, np.nan))
        rates = [
            self._curve(label, colour, series)
            for (label, series), colour in zip(self._rates(), _COLOURS, strict=False)
        ]
        return [
            _panel("lateness (µs)", "µs", 110, [self._curve("lateness", "c1", lateness)]),
            _panel("response (µs)", "µs", 110, [self._curve("response", "c2", response)]),
            _panel("frames (1/s)", "1/s", 160, rates),
        ]

    def _rates(self) -> Iterator[tuple[str, SlotSeries]]:
        """Yield label and rate of the most frequent kinds of frames."""
        first_s, span_s = self._loop.first_s, self._loop.last_s - self._loop.first_s
        length_s = max(span_s / MAX_RATE_SLOTS, MIN_RATE_SLOT_S)
        count = int(span_s / length_s)
        if count == 0:
            return
        counts: dict[tuple[str, int], Any] = {}
        for window in self._recording.windows(WINDOW_S):
            for direction in _DIRECTIONS:
                frames = window.frames(direction)
                slot = ((frames.time_s - first_s) / length_s).astype(np.int64)
                for identifier in np.unique(frames.id):
                    chosen = slot[(frames.id == identifier) & (slot >= 0) & (slot < count)]
                    key = direction, int(identifier)
                    counts[key] = counts.get(key, 0) + np.bincount(chosen, minlength=count)
        time_s: FloatArray = np.asarray(first_s + (np.arange(count) + 0.5) * length_s, np.float64)
        for kind, identifier in sorted(counts, key=lambda key: -int(counts[key].sum()))[:MAX_RATE_CURVES]:
            series = SlotSeries(_slots_over(time_s))
            series.add(time_s, np.asarray(counts[kind, identifier] / length_s))
            yield f"{kind} {identifier:03X} {FRAME_NAMES.get(identifier, '')}".strip(), series

    def _curve(self, label: str, colour: str, series: SlotSeries, holds: bool = False) -> dict[str, Any]:
        return {
            "label": label,
            "colour": colour,
            "holds": holds,
            "start": series.slots.start_s - self._loop.start_s,
            "length": series.slots.length_s,
            **series.encoded(),
        }


def _slots_over(time_s: FloatArray) -> Slots:
    """Return slots of the mean interval of ``time_s``."""
    begin_s, end_s = (float(time_s[0]), float(time_s[-1])) if len(time_s) else (0.0, 1.0)
    return Slots.over(begin_s, end_s, (end_s - begin_s) / max(len(time_s) - 1, 1) or 1.0)


def _panel(label: str, unit: str, height: int, curves: list[dict[str, Any]]) -> dict[str, Any]:
    legend = [(curve["label"], curve["colour"]) for curve in curves]
    plotted = {"label": label, "minSpan": MIN_SPAN.get(unit, 0.0), "curves": curves}
    return {"height": height, "label": label, "legend": legend, "plotted": plotted}
