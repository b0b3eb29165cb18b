"""Sums up a run from its recording: step responses or tracking errors of the axes, timing of the loop.

``axis_figures`` and ``loop_figures`` collect the figures, ``summary_table`` prints a summary.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from hil.core.errors import HilError
from hil.core.rig import read_rig
from hil.recording.reader import Recording
from hil.views.axis_figures import (
    MAX_INITIAL_ERROR,
    MIN_STEP_PART,
    SETTLING_BAND,
    AxisFigures,
    StepResponse,
    Tracking,
    axis_summary,
)
from hil.views.duration_counts import DurationCounts
from hil.views.loop_figures import WINDOW_S, LoopFigures, loop_figures

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = [
    "MAX_INITIAL_ERROR",
    "REQUESTED_DURATION",
    "SETTLING_BAND",
    "Quantiles",
    "StepResponse",
    "Summary",
    "Tracking",
    "axis_summary",
    "losses",
    "min_steps",
    "quantiles",
    "sum_up",
    "summarise",
]

REQUESTED_DURATION = "duration asked for, s"
"""Key of the requested duration in the metadata ``ending``."""


@dataclass(frozen=True)
class Quantiles:
    """Quantiles of observed durations in microseconds."""

    p50_us: float
    p99_us: float
    p99_9_us: float
    max_us: float


@dataclass(frozen=True)
class Summary:
    """Figures of one run. Counts that the recording does not have are None."""

    axes: dict[str, StepResponse | Tracking]
    """Figures of the axes that were controlled, in the rig file's order."""
    lateness: Quantiles | None
    """Time from each deadline to the call of the core; None without a period."""
    response: Quantiles | None
    """Time from SYNC to the command, both as taken by the link; None without a good sample."""
    periods: int
    bring_up_periods: int
    """Number of periods before the boards were up. A missing sample in them is not a loss."""
    missed_periods: int
    """Number of periods whose deadline passed before the core was called."""
    periods_without_sample: int
    """Number of periods without a good sample after the boards were up."""
    frames_received: int
    frames_sent: int
    frames_dropped: int | None
    """Number of frames that the kernel dropped because the loop did not take them in time."""
    frames_unreadable: int | None
    """Number of frames that the link discarded: not classic CAN, or corrupt."""
    frames_not_sent: int | None
    """Number of frames that the bus refused because its queue was full."""
    frames_rejected: int | None
    """Number of received frames that were rejected as sample, heartbeat or emergency message."""
    samples_lost: int | None
    """Number of samples that are missing according to the ADC board's counter."""
    error_frames: int | None
    """Number of error frames that the bus reported."""
    messages_dropped: int
    """Number of messages that were not recorded, because the recorder process was too slow or ended."""
    complete: bool
    """True if the recording was ended properly."""
    ending: str
    """Reason for the end of the run; empty if the recording does not have it."""
    controlled_s: float
    """Time during which the controllers acted."""
    requested_s: float | None
    """Time during which the controllers were to act."""
    bus_load: float | None = None
    """Share of the time in which the modelled bus was in use; None if frames took no time, or a real bus."""
    frames_destroyed: int | None = None
    """Number of frames that an error frame destroyed on the modelled bus; None without a modelled bus.

    CAN repeats such a frame, so it is not lost.
    """

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for other programs; the keys carry the units."""
        return asdict(self)

    def table(self) -> RenderableType:
        """Return the tables and notes for the terminal."""
        from hil.views.summary_table import render

        return render(self)


def summarise(recording: Recording) -> Summary:
    """Sum up ``recording``. Raises RecordingError when it lacks the channels of the loop."""
    axes, smallest = {}, min_steps(recording.documents.get("rig.toml", ""))
    for name, unit in recording.axes.items():
        figures = AxisFigures(unit, smallest.get(name, 0.0))
        for window in recording.windows(WINDOW_S):
            figures.add(window.axis(name))
        axes[name] = figures.result()
    return sum_up(recording, loop_figures(recording), axes)


def min_steps(rig_text: str) -> dict[str, float]:
    """Return the smallest change of each axis' setpoint that is a step, in the axis' unit.

    Empty if the text is no rig file, as in an imported recording: then every change is one.
    """
    try:
        rig = read_rig(rig_text, "rig.toml")
    except HilError:
        return {}
    return {name: MIN_STEP_PART * (axis.max_y - axis.min_y) for name, axis in rig.axes.items()}


def sum_up(
    recording: Recording, loop: LoopFigures, axes: Mapping[str, StepResponse | Tracking | None]
) -> Summary:
    """Return the summary from the figures of loop and axes, for callers that have read them."""
    counts = recording.counts
    ending = recording.metadata.get("ending", {})
    dropped, unreadable, not_sent, rejected, lost, error_frames, destroyed = (
        int(ending[key]) if ending.get(key, "").isdecimal() else None
        for key in (
            "frames dropped by the kernel",
            "frames unreadable",
            "frames not sent",
            "rejected frames",
            "lost samples",
            "error frames",
            "frames destroyed on the bus",
        )
    )
    return Summary(
        axes={name: summary for name, summary in axes.items() if summary is not None},
        lateness=quantiles(loop.lateness),
        response=quantiles(loop.response),
        periods=loop.periods,
        bring_up_periods=loop.bring_up_periods,
        missed_periods=loop.missed_periods,
        periods_without_sample=loop.periods_without_sample,
        frames_received=counts["/can/rx"],
        frames_sent=counts["/can/tx"],
        frames_dropped=dropped,
        frames_unreadable=unreadable,
        frames_not_sent=not_sent,
        frames_rejected=rejected,
        samples_lost=lost,
        error_frames=error_frames,
        messages_dropped=recording.messages_dropped,
        complete=recording.complete,
        ending=ending.get("reason", ""),
        controlled_s=loop.controlled_s,
        requested_s=float(ending[REQUESTED_DURATION]) if REQUESTED_DURATION in ending else None,
        bus_load=float(ending["bus load"]) if "bus load" in ending else None,
        frames_destroyed=destroyed,
    )


def losses(summary: Summary) -> list[str]:
    """Return in words what was dropped, rejected or lost."""
    counted = (
        (summary.frames_dropped, "frame", "dropped on arrival"),
        (summary.frames_unreadable, "frame", "unreadable"),
        (summary.frames_not_sent, "frame", "not sent"),
        (summary.frames_rejected, "frame", "rejected"),
        (summary.samples_lost, "sample", "lost"),
        (summary.error_frames, "error frame", "on the bus"),
        (summary.frames_destroyed, "frame", "destroyed by error frames and repeated"),
        (summary.messages_dropped, "message", "not recorded"),
    )
    return [f"{count} {what}{'s' * (count > 1)} {how}" for count, what, how in counted if count]


def quantiles(durations: DurationCounts) -> Quantiles | None:
    """Return the quantiles of durations; None without one."""
    if len(durations) == 0:
        return None
    return Quantiles(*(value * 1e-3 for value in durations.quantiles_ns([0.5, 0.99, 0.999, 1.0])))
