"""The report of a run: one HTML page with plots that zoom together, figures, verdicts and configuration.

The page refers to nothing outside itself. Its size is bounded, whatever the length of the run
(``report_series``), and so is the memory for it. ``report_plots``, ``report_tables`` and ``report_verdict``
make its parts.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Iterator
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import Any

from hil import __version__
from hil.core.controller_file import ControllerFile, read_controller
from hil.core.errors import HilError, RecordingError, RecordingExistsError
from hil.core.output import Severity
from hil.recording.reader import Recording
from hil.recording.recorder import ARM_EVENTS, FAULTS_BEGUN
from hil.views import report_tables
from hil.views.histograms import histogram
from hil.views.loop_figures import loop_figures
from hil.views.promises import promises
from hil.views.report_plots import Plots
from hil.views.report_verdict import verdict
from hil.views.summary import sum_up

MAX_LOG_ENTRIES = 300
"""Number of log entries in the table; the warnings and faults of longer logs come first."""
_FACTS = (
    "run",
    "imported",
    "rights",
    "plant",
    ARM_EVENTS,
    FAULTS_BEGUN,
    "ending",
    "recorder",
    "recovery",
)
"""Names of the metadata that the page lists."""
_NOTES = {
    ("ending", "missed periods"): (
        " since the gateway began: skipped ones, and those that began too late to send SYNC"
    )
}
"""What an entry of the metadata counts, by the names of metadata and entry."""
_TEMPLATE, _STYLE_SHEET = "recording_report.html", "page_style.html"


def write_report(recording: Recording, output: Path, overwrite: bool = False) -> int:
    """Write the page to ``output``, and return its size in bytes.

    Raises RecordingExistsError when ``output`` exists and ``overwrite`` is False, or when it is the recording
    itself, and RecordingError when it cannot be written; no half file stays.
    """
    if output.exists() and any(output.samefile(path) for path in recording.paths):
        raise RecordingExistsError(f"{output}: is the recording; -o names another file")
    if os.path.lexists(output) and not overwrite:
        raise RecordingExistsError(f"{output}: exists already; --force overwrites it, -o names another file")
    content = render_report(recording).encode()
    partial = output.with_name(f".{output.name}.{os.getpid()}.part")
    try:
        with partial.open("xb") as file:
            file.write(content)
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
        self._loop = loop_figures(recording)
        if self._loop.periods == 0:
            raise RecordingError(f"{recording.path}: has no period, so there is nothing to report")
        self._stays = self._loop.stays()
        self._log = recording.log()

    def values(self) -> dict[str, Any]:
        """Return the values of the template."""
        recording, loop = self._recording, self._loop
        plots = Plots(recording, loop)
        axes = [plots.axis(name) for name in recording.axes]
        figures: list[dict[str, Any]] = [{"name": axis.name, "panels": axis.panels} for axis in axes]
        figures.append({"name": "Loop timing and frames", "panels": plots.loop()})
        panels = [panel for figure in figures for panel in figure["panels"]]
        for number, panel in enumerate(panels):
            panel["number"] = number
        summary = sum_up(recording, loop, {axis.name: axis.figures for axis in axes})
        controllers = dict(self._controllers())
        promised = [
            promise
            for name, controller in controllers.items()
            for promise in promises(name, controller.origin, summary.axes.get(name))
        ]
        return {
            "title": recording.path.name,
            "subtitle": self._subtitle(),
            "statements": verdict(
                summary,
                recording,
                promised,
                [(self._seconds(now_ns), entry) for now_ns, entry in self._log],
                loop.origin,
            ),
            "origin": loop.origin,
            "cards": report_tables.cards(summary),
            "figures": figures,
            "histograms": [histogram("lateness", loop.lateness), histogram("response", loop.response)],
            "steps": report_tables.step_rows(summary),
            "tracking": report_tables.tracking_rows(summary),
            "promises": [report_tables.promise_row(promise) for promise in promised],
            "unpromised": list(self._unpromised(controllers, {promise.axis for promise in promised})),
            "quantiles": report_tables.quantile_rows(summary),
            "counts": report_tables.count_rows(summary),
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
        return self._recording.seconds(now_ns) - self._loop.start_s

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

    def _unpromised(
        self, controllers: dict[str, ControllerFile], promised: set[str]
    ) -> Iterator[tuple[str, str]]:
        """Yield each axis without a promise, and why it has none."""
        for name in self._recording.axes:
            if name in promised:
                continue
            if name in controllers:
                yield name, "its controller file names no specifications"
            elif f"controllers/{name}.json" in self._recording.documents:
                yield name, "its controller file cannot be read"
            else:
                yield name, "its controller file is not in the recording"

    def _facts(self, controllers: dict[str, ControllerFile]) -> Iterator[tuple[str, str]]:
        """Yield what the run was made of: label and text."""
        recording = self._recording
        for name, setpoint in recording.metadata.get("setpoints", {}).items():
            yield f"setpoint of {name}", setpoint
        for name, controller in controllers.items():
            yield f"controller of {name}", f"{controller.name}: {controller.description}"
        for group in _FACTS:
            for key, value in recording.metadata.get(group, {}).items():
                if value:
                    yield f"{group}: {key}", f"{value}{_NOTES.get((group, key), '')}"
        for name, content in recording.attachments.items():
            yield f"document {name}", f"{len(content)} bytes, SHA-256 {hashlib.sha256(content).hexdigest()}"
        yield "stamps of received frames", recording.metadata["recording"].get("stamp_origin", "unknown")
        yield "this report", f"hil {__version__}"
