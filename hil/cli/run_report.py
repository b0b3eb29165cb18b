"""What `hil run` prints after a run: summary, files, and why the run ended."""

from __future__ import annotations

import os
import shlex
import sys
from typing import TYPE_CHECKING, NamedTuple

from rich.console import Console

from hil.cli.record_path import figure_of, picture_of
from hil.core.errors import HilError
from hil.core.output import Severity
from hil.recording.reader import Recording
from hil.recording.recorder import FAULT_SOURCE
from hil.shells.run_plan import Ending
from hil.views.summary import summarise

if TYPE_CHECKING:
    from firmware_sim.scenario import Scenario
    from hil.recording.recorder import RecorderReport

SILENCE_HINT = "Check the bus (--bus), the power of the boards, the bit rate, and the node ids 0x10 and 0x20."
TRACEBACK_VARIABLE = "HIL_TRACEBACK"
AS_PLANNED = (Ending.COMPLETED, Ending.INTERRUPTED)
"""Endings of a run that are no failure."""


class _Recorded(NamedTuple):
    """What the recording says about the run; empty where it cannot be read."""

    messages: int = 0
    last_warning: str = ""
    """Last warning or error in the log, without simulated faults."""
    ending: dict[str, str] = {}  # noqa: RUF012  # never changed
    traceback: str = ""


class _Printer(Console):
    def on_broken_pipe(self) -> None:
        """Go on silently after `| head`: the plot is still drawn."""
        self.quiet = True


def print_run_report(
    ending: Ending | None, report: RecorderReport, scenario: Scenario | None, *, has_plots: bool = True
) -> None:
    """Print the summary of a run and, with ``has_plots``, draw its plots beside the recording."""
    console = _Printer(highlight=False, soft_wrap=True, markup=False)
    recorded = _print_recording(console, report, scenario, has_plots)
    if report.failure:
        missing = report.missing(recorded.messages)
        text = f"The recording is incomplete: {report.failure}; {missing} messages are missing in the file."
        console.print(text, style="red")
    if ending in AS_PLANNED:
        return
    console.print(_failure_text(ending, recorded.ending, recorded.last_warning), style="red")
    if recorded.traceback:
        console.print(
            "This is a defect of hil or of a library that it uses. Please report it to the maintainers with "
            f"the recording, whose metadata has the traceback ({TRACEBACK_VARIABLE}=1 prints it here).",
            style="red",
        )
        if os.environ.get(TRACEBACK_VARIABLE):
            sys.stderr.write(recorded.traceback)


def _print_recording(
    console: Console, report: RecorderReport, scenario: Scenario | None, has_plots: bool
) -> _Recorded:
    recorded = _Recorded()
    try:
        recording = Recording(report.path)
        recorded = _Recorded(
            sum(recording.counts.values()),
            _last_warning(recording),
            recording.metadata.get("ending", {}),
            recording.metadata.get("error", {}).get("traceback", ""),
        )
        console.print(summarise(recording).table())
        console.print(f"recording  {report.path}  (opens in Foxglove and PlotJuggler)")
        if has_plots:
            _draw_plots(console, recording, scenario)
        console.print(f"next       hil replay {shlex.quote(str(report.path))}")
    except HilError as error:
        console.print(f"There is no complete summary: {error}", style="yellow")
    return recorded


def _draw_plots(console: Console, recording: Recording, scenario: Scenario | None) -> None:
    from hil.views.plots import plot_run

    picture = picture_of(recording.path)
    plot_run(recording, picture)
    console.print(f"plot       {picture}")
    if scenario is not None:
        figure = figure_of(recording.path)
        plot_run(recording, figure, axes=scenario.figure_axes, title=scenario.title)
        console.print(f"figure     {figure}")


def _last_warning(recording: Recording) -> str:
    entries = [
        entry
        for _, entry in recording.log()
        if entry.severity >= Severity.WARNING and entry.source != FAULT_SOURCE
    ]
    return f"{entries[-1].source}: {entries[-1].text}" if entries else ""


def _failure_text(ending: Ending | None, recorded_ending: dict[str, str], refusal: str) -> str:
    if ending is Ending.START_REFUSED:
        return f"The run did not begin. {_sentence(refusal)}"
    if ending is Ending.RELEASED:
        return f"The run was stopped. {_sentence(refusal)}"
    if ending is not Ending.NO_BOARDS:
        return f"The run ended by {ending}: {recorded_ending.get('fault', '')}"
    readiness = recorded_ending.get("readiness", "")
    if not readiness:
        return "The boards did not come up."
    if "silent" in readiness:
        return f"The boards did not come up: {readiness}. {SILENCE_HINT}"
    if readiness.endswith("dac operational"):
        return f"The boards did not come up: {readiness}; no sample came."
    return _sentence(f"The boards did not come up: {readiness}")


def _sentence(text: str) -> str:
    """Return the text with a full stop, unless it has an end already."""
    return text if text.endswith((".", "?")) else f"{text}."
