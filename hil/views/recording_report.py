"""The report of a run: one HTML page with plots that zoom together, figures, verdicts and configuration.

The page refers to nothing outside itself. Its size is bounded, whatever the length of the run
(``report_series``), and so is the memory for it (``run_columns``).
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from hil import __version__
from hil.core.controller_file import ControllerFile, read_controller
from hil.core.errors import HilError, RecordingError, RecordingExistsError
from hil.core.output import Severity
from hil.core.wire.codec import RPDO1_DAC, SYNC, TPDO1_ADC
from hil.recording.reader import Recording
from hil.views.histograms import histogram
from hil.views.life_cycle_stays import stays_in
from hil.views.promises import Outcome, Promise, promises
from hil.views.report_series import Slots, encode
from hil.views.run_columns import WINDOW_S, TimingColumns, axis_columns, timing_columns
from hil.views.summary import StepResponse, Summary, Tracking, axis_summary, losses, sum_up

MIN_SPAN = {"m": 0.01, "rad": 0.1, "V": 1.0, "µs": 20.0, "1/s": 1.0}
"""Smallest range of a plot's vertical axis, by unit. A smaller one would magnify the converter's noise."""
MAX_RATE_SLOTS, MIN_RATE_SLOT_S = 600, 1.0
MAX_RATE_CURVES = 6
MAX_LOG_ENTRIES = 300
"""Number of log entries in the table; the warnings and faults of longer logs come first."""
FRAME_NAMES = {SYNC: "SYNC", TPDO1_ADC: "sample", RPDO1_DAC: "valve command"}
_TEMPLATE, _STYLE_SHEET = "recording_report.html", "page_style.html"
_DIRECTIONS: tuple[Literal["received", "sent", "refused"], ...] = ("received", "sent", "refused")
_COLOURS = ("c1", "c2", "c3", "c4", "c5", "c6")


class Statement(NamedTuple):
    """A sentence of the verdict; ``style`` is a class of the style sheet: well, caution, or empty for bad."""

    style: str
    text: str


def write_report(recording: Recording, output: Path, overwrite: bool = False) -> int:
    """Write the page to ``output``, and return its size in bytes.

    Raises RecordingExistsError when ``output`` exists and ``overwrite`` is False, and RecordingError when it
    cannot be written; no half file stays.
    """
    if os.path.lexists(output) and not overwrite:
        raise RecordingExistsError(f"{output}: exists already; --force overwrites it, -o names another file")
    content = render_report(recording).encode()
    partial = output.with_name(f"{output.name}.part")
    try:
        partial.write_bytes(content)
        partial.replace(output)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise RecordingError(f"{output}: the report cannot be written: {error.strerror}") from None
    return len(content)


def render_report(recording: Recording) -> str:
    """Return the page as HTML. Raises RecordingError when the recording has no period."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    page = _Page(recording)
    environment = Environment(
        loader=FunctionLoader(_template),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    return environment.get_template(_TEMPLATE).render(page.values())


def _template(name: str) -> str:
    folder = "hil.host" if name == _STYLE_SHEET else "hil.views"
    return resources.files(folder).joinpath(name).read_text("utf-8")


class _Page:
    """Collects what the template needs, one axis at a time."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        timing = timing_columns(recording)
        if len(timing) == 0:
            raise RecordingError(f"{recording.path}: has no period, so there is nothing to report")
        self._start_s = float(timing.time_s[np.argmax(timing.running)])
        period_s = float(np.median(np.diff(timing.time_s))) if len(timing) > 1 else 1.0
        first_s, last_s = float(timing.time_s[0]), float(timing.time_s[-1])
        self._slots = Slots.over(first_s, last_s, max(period_s, 1e-6))
        self._stays = stays_in(timing, recording.state_names, self._start_s)
        self._log = recording.log()
        self._summary = sum_up(recording, timing, {})
        self._loop_figure = self._figure_of_loop(timing)
        self._histograms = [
            histogram("lateness", timing.lateness_ns * 1e-3),
            histogram("response", timing.response_ns[timing.response_ns >= 0] * 1e-3),
        ]
        self._axes: dict[str, StepResponse | Tracking] = {}

    def values(self) -> dict[str, Any]:
        """Return the values of the template."""
        recording = self._recording
        figures = [*(self._axis_figure(name) for name in recording.axes), self._loop_figure]
        panels = [panel for figure in figures for panel in figure["panels"]]
        for number, panel in enumerate(panels):
            panel["number"] = number
        summary = replace(self._summary, axes=self._axes)
        controllers = dict(self._controllers())
        kept = [
            promise
            for name, controller in controllers.items()
            for promise in promises(name, controller.origin, summary.axes.get(name))
        ]
        return {
            "title": recording.path.name,
            "subtitle": self._subtitle(),
            "statements": [*_endings(summary, recording), *_kept(kept)],
            "cards": _cards(summary),
            "figures": figures,
            "histograms": self._histograms,
            "steps": _step_rows(summary),
            "tracking": _tracking_rows(summary),
            "promises": [_promise_row(promise) for promise in kept],
            "quantiles": _quantile_rows(summary),
            "counts": _count_rows(summary),
            "log": self._log_rows(),
            "log_count": len(self._log),
            "facts": list(self._facts(controllers)),
            "data": self._data(panels),
        }

    def _subtitle(self) -> str:
        recording = self._recording
        began_s = (recording.start_ns + recording.epoch_offset_ns) * 1e-9
        when = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(began_s))
        is_simulated = recording.metadata.get("recording", {}).get("stamp_origin") == "simulated"
        at = "simulated time" if is_simulated else when
        version = recording.metadata.get("run", {}).get("hil", "")
        parts = [at, f"bus {recording.bus}", f"{recording.duration_s:.1f} s", version and f"hil {version}"]
        return ", ".join(part for part in parts if part)

    def _axis_figure(self, name: str) -> dict[str, Any]:
        axis = axis_columns(self._recording, name)
        figures = axis_summary(axis)
        if figures is not None:
            self._axes[name] = figures
        unit = axis.unit
        panels = [
            self._panel(
                f"position ({unit})",
                unit,
                190,
                [
                    self._curve("setpoint", "ink", axis.time_s, axis.setpoint, holds=True),
                    self._curve("position", "c1", axis.time_s, axis.position),
                ],
            ),
            self._panel(f"error ({unit})", unit, 100, [self._curve("error", "c3", axis.time_s, axis.error)]),
            self._panel(
                "valve (V)",
                "V",
                110,
                [self._curve("valve voltage", "c2", axis.time_s, axis.command_v, holds=True)],
            ),
        ]
        return {"name": name, "panels": panels}

    def _figure_of_loop(self, timing: TimingColumns) -> dict[str, Any]:
        late_us = timing.lateness_ns * 1e-3
        response_us = np.where(timing.response_ns >= 0, timing.response_ns * 1e-3, np.nan)
        panels = [
            self._panel("lateness (µs)", "µs", 110, [self._curve("lateness", "c1", timing.time_s, late_us)]),
            self._panel(
                "response (µs)", "µs", 110, [self._curve("response", "c2", timing.time_s, response_us)]
            ),
        ]
        curves = [
            self._curve(label, colour, time_s, rate)
            for (label, time_s, rate), colour in zip(self._rates(timing), _COLOURS, strict=False)
        ]
        panels.append(self._panel("frames (1/s)", "1/s", 160, curves))
        return {"name": "Loop timing and frames", "panels": panels}

    def _rates(self, timing: TimingColumns) -> Iterator[tuple[str, Any, Any]]:
        """Yield label, times and rates of the most frequent kinds of frames."""
        first_s, last_s = float(timing.time_s[0]), float(timing.time_s[-1])
        length_s = max((last_s - first_s) / MAX_RATE_SLOTS, MIN_RATE_SLOT_S)
        count = int((last_s - first_s) / length_s)
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
        time_s = first_s + (np.arange(count) + 0.5) * length_s
        ordered = sorted(counts, key=lambda key: -int(counts[key].sum()))[:MAX_RATE_CURVES]
        for kind, identifier in ordered:
            name = FRAME_NAMES.get(identifier, "")
            yield (
                f"{kind} {identifier:03X} {name}".strip(),
                time_s,
                counts[kind, identifier] / length_s,
            )

    def _curve(
        self, label: str, colour: str, time_s: Any, values: Any, holds: bool = False
    ) -> dict[str, Any]:
        slots = self._slots
        if len(time_s) < slots.count // 2:
            ends = (time_s[0], time_s[-1]) if len(time_s) else (0.0, 1.0)
            period_s = (ends[1] - ends[0]) / max(len(time_s) - 1, 1) or 1.0
            slots = Slots.over(float(ends[0]), float(ends[1]), float(period_s))
        return {
            "label": label,
            "colour": colour,
            "holds": holds,
            "start": slots.start_s - self._start_s,
            "length": slots.length_s,
            **encode(slots, time_s, values),
        }

    def _panel(self, label: str, unit: str, height: int, curves: list[dict[str, Any]]) -> dict[str, Any]:
        legend = [(curve["label"], curve["colour"]) for curve in curves]
        plotted = {"label": label, "minSpan": MIN_SPAN.get(unit, 0.0), "curves": curves}
        return {"height": height, "label": label, "legend": legend, "plotted": plotted}

    def _data(self, panels: list[dict[str, Any]]) -> dict[str, Any]:
        return {
            "from": self._stays[0].from_s,
            "to": max(self._stays[-1].to_s, self._stays[0].from_s + 1e-3),
            "panels": [panel["plotted"] for panel in panels],
            "states": [list(stay) for stay in self._stays],
            "marks": [
                [
                    round(self._seconds(now_ns), 6),
                    entry.severity.name.lower(),
                    f"{entry.source}: {entry.text}",
                ]
                for now_ns, entry in self._log
                if entry.severity >= Severity.WARNING
            ][:MAX_LOG_ENTRIES],
        }

    def _seconds(self, now_ns: int) -> float:
        return self._recording.seconds(now_ns) - self._start_s

    def _log_rows(self) -> list[tuple[str, str, str, str]]:
        entries = self._log
        if len(entries) > MAX_LOG_ENTRIES:
            entries = sorted(entries, key=lambda logged: -logged.entry.severity)[:MAX_LOG_ENTRIES]
            entries.sort(key=lambda logged: logged.now_ns)
        return [
            (f"{self._seconds(now_ns):.3f}", entry.severity.name.lower(), entry.source, entry.text)
            for now_ns, entry in entries
        ]

    def _controllers(self) -> Iterator[tuple[str, ControllerFile]]:
        for name in self._recording.axes:
            document = f"controllers/{name}.json"
            text = self._recording.documents.get(document)
            if text is not None:
                with suppress(HilError):
                    yield name, read_controller(text, document)

    def _facts(self, controllers: dict[str, ControllerFile]) -> Iterator[tuple[str, str]]:
        """Yield what the run was made of: label and text."""
        recording = self._recording
        for name, setpoint in recording.metadata.get("setpoints", {}).items():
            yield f"setpoint of {name}", setpoint
        for name, controller in controllers.items():
            yield f"controller of {name}", f"{controller.name}: {controller.description}"
        for group in ("run", "rights", "plant", "arm events", "ending", "recorder", "recovery"):
            for key, value in recording.metadata.get(group, {}).items():
                if value:
                    yield f"{group}: {key}", str(value)
        for name, content in recording.attachments.items():
            yield f"document {name}", f"{len(content)} bytes, SHA-256 {hashlib.sha256(content).hexdigest()}"
        yield "stamps of received frames", recording.metadata["recording"].get("stamp_origin", "unknown")
        yield "this report", f"hil {__version__}"


def _endings(summary: Summary, recording: Recording) -> Iterator[Statement]:
    fault = recording.metadata.get("ending", {}).get("fault", "")
    if not summary.complete:
        yield Statement("caution", "The recording was cut off. Everything here is about its contents.")
    elif summary.ending == "completed":
        yield Statement("well", f"The run was completed: {summary.controlled_s:.1f} s under control.")
    elif summary.ending == "interrupted":
        yield Statement(
            "caution", f"The run was interrupted after {summary.controlled_s:.1f} s under control."
        )
    else:
        yield Statement("", f"The run ended by {summary.ending or 'an unknown cause'}{fault and ': '}{fault}")
    lost = losses(summary)
    if lost:
        yield Statement("", f"Lost or rejected: {', '.join(lost)}.")
    if summary.missed_periods or summary.periods_without_sample:
        yield Statement(
            "caution",
            f"{summary.missed_periods} of {summary.periods} periods were missed, and "
            f"{summary.periods_without_sample} had no good sample.",
        )


def _kept(kept: list[Promise]) -> Iterator[Statement]:
    judged = [p for p in kept if p.outcome in (Outcome.MET, Outcome.MISSED)]
    missed = [p for p in judged if p.outcome is Outcome.MISSED]
    if missed:
        texts = [f"{p.axis}: {p.quantity} {_value(p.measured, p.unit)}, limit {p.limit:g}" for p in missed]
        yield Statement("", f"Specifications not met: {'; '.join(texts)}.")
    elif judged:
        yield Statement("well", f"All {len(judged)} specifications that this run shows are met.")
    elif kept:
        yield Statement("caution", "The run shows none of the specifications: it has no step from rest.")
    else:
        yield Statement(
            "caution", "The controller files name no specifications, so there is no verdict on them."
        )


def _cards(summary: Summary) -> list[tuple[str, str, str]]:
    """Return caption, value and note of each card."""
    late, response = summary.lateness, summary.response
    return [
        ("under control", f"{summary.controlled_s:.1f} s", f"{summary.periods} periods recorded"),
        (
            "lateness, worst",
            f"{late.max_us:.0f} µs" if late else "–",
            f"p99 {late.p99_us:.0f} µs, from deadline to wake-up" if late else "",
        ),
        (
            "response, worst",
            f"{response.max_us:.0f} µs" if response else "–",
            f"p99 {response.p99_us:.0f} µs, from SYNC to command" if response else "",
        ),
        (
            "frames",
            f"{summary.frames_received + summary.frames_sent}",
            f"{summary.frames_received} received, {summary.frames_sent} sent",
        ),
    ]


def _step_rows(summary: Summary) -> list[list[str]]:
    return [
        [
            name,
            f"{axis.step_from:.4g} → {axis.step_to:.4g} {axis.unit}",
            _value(axis.rise_s, "s"),
            "does not settle" if axis.settling_s is None else f"{axis.settling_s:.3f} s",
            f"{axis.overshoot_percent:.2f} %",
            f"{1e3 * axis.steady_state_error:.3f} m{axis.unit}",
            f"{axis.min_valve_v:.2f} to {axis.max_valve_v:.2f} V",
        ]
        for name, axis in summary.axes.items()
        if isinstance(axis, StepResponse)
    ]


def _tracking_rows(summary: Summary) -> list[list[str]]:
    return [
        [
            name,
            f"{1e3 * axis.rms_error:.3f} m{axis.unit}",
            f"{1e3 * axis.max_error:.3f} m{axis.unit}",
            "constant setpoint" if axis.delay_s is None else f"{1e3 * axis.delay_s:.0f} ms",
            f"{axis.min_valve_v:.2f} to {axis.max_valve_v:.2f} V",
        ]
        for name, axis in summary.axes.items()
        if isinstance(axis, Tracking)
    ]


def _promise_row(promise: Promise) -> tuple[list[str], str]:
    """Return the cells of a promise, and the style of its verdict."""
    cells = [
        promise.axis,
        promise.quantity,
        f"{promise.limit:g} {promise.unit}".strip(),
        _value(promise.predicted, promise.unit),
        _value(promise.measured, promise.unit),
        promise.outcome.value,
    ]
    return cells, {Outcome.MET: "good", Outcome.MISSED: "bad"}.get(promise.outcome, "soft")


def _value(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.4g} {unit}".strip().replace("inf", "∞")


def _quantile_rows(summary: Summary) -> list[list[str]]:
    return [
        [name, *(f"{value:.0f}" for value in (q.p50_us, q.p99_us, q.p99_9_us, q.max_us))]
        for name, q in (("lateness", summary.lateness), ("response", summary.response))
        if q is not None
    ]


def _count_rows(summary: Summary) -> list[tuple[str, str]]:
    rows = [
        ("periods", summary.periods),
        ("periods before the boards were up", summary.bring_up_periods),
        ("periods missed", summary.missed_periods),
        ("periods without a good sample", summary.periods_without_sample),
        ("frames received", summary.frames_received),
        ("frames sent", summary.frames_sent),
        ("frames dropped by the kernel", summary.frames_dropped),
        ("frames unreadable", summary.frames_unreadable),
        ("frames not sent", summary.frames_not_sent),
        ("frames rejected", summary.frames_rejected),
        ("samples lost", summary.samples_lost),
        ("error frames", summary.error_frames),
        ("messages not recorded", summary.messages_dropped),
    ]
    return [(label, "not recorded" if count is None else str(count)) for label, count in rows]
