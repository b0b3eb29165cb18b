"""What a run was worth, from its recording: step responses or tracking errors, and the timing of the loop.

Overshoot, 2 % settling time and steady-state error as in Franklin, Powell, Emami-Naeini, Feedback Control of
Dynamic Systems, sec. 3.4. No plotting here.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from hil.core.wire.codec import SYNC
from hil.recording.reader import Recording
from hil.recording.tables import AxisTable, TimingTable

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text

RowsT = TypeVar("RowsT", AxisTable, TimingTable)
ASKED = "duration asked for, s"
"""In the metadata of a recording's end."""
SETTLING_BAND = 0.02
"""Of the step's size."""
STEADY_PART = 0.2
"""The last part of what follows the step, over which the steady-state error is averaged."""
CONSTANT_PERIODS = 5
"""A change of the setpoint is a step when it was constant for so long before."""


@dataclass(frozen=True)
class StepResponse:
    """The response to the last step of the setpoint; positions in ``unit``."""

    unit: str
    step_from: float
    step_to: float
    overshoot_percent: float
    """Of the step's size."""
    settling_s: float | None
    """From the step to when the position stays within 2 % of it; None: it did not."""
    steady_state_error: float
    """Mean of setpoint minus position over the last fifth after the step."""
    lowest_valve_v: float
    highest_valve_v: float


@dataclass(frozen=True)
class Tracking:
    """How well a setpoint that does not step was followed; errors in ``unit``."""

    unit: str
    rms_error: float
    largest_error: float
    """The largest magnitude."""
    lowest_valve_v: float
    highest_valve_v: float


@dataclass(frozen=True)
class Quantiles:
    """Observed values, in microseconds; 0 where there were none."""

    p50_us: float
    p99_us: float
    p99_9_us: float
    worst_us: float


@dataclass(frozen=True)
class Summary:
    """One run."""

    axes: dict[str, StepResponse | Tracking]
    """Axes that were controlled, in the rig file's order."""
    lateness: Quantiles
    """When the core was called after its deadline."""
    response: Quantiles
    """From when SYNC had left to when the command had, in periods with a good sample."""
    periods: int
    missed_periods: int
    """Deadlines that passed before the core was called."""
    periods_without_sample: int
    frames_received: int
    frames_sent: int
    frames_dropped: int | None
    """Received by this machine and lost in it, since the loop did not take them in time. None: not known."""
    frames_unreadable: int | None
    """Discarded by the link, since they were no sound classic frames."""
    frames_not_sent: int | None
    """Refused by the bus, whose queue was full."""
    frames_rejected: int | None
    """Received, and no good sample, heartbeat or emergency."""
    samples_lost: int | None
    """Missing by the ADC board's counter."""
    error_frames: int | None
    """Reported by the bus."""
    messages_dropped: int
    """Not recorded, because the recorder process fell behind or ended."""
    complete: bool
    """Whether the recording was ended properly."""
    ending: str
    """Why the run ended; empty where that is not known."""
    controlled_s: float
    """For how long the controllers acted."""
    asked_s: float | None
    """For how long they were to act."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for machines; keys carry the units."""
        return asdict(self)

    def table(self) -> RenderableType:
        """For the terminal."""
        return _rendered(self)


def summarise(recording: Recording) -> Summary:
    """Sum up ``recording``. Raises RecordingError when it lacks the loop's channels."""
    timing = recording.timing()
    counts = recording.counts
    fresh = timing[timing["fresh"]]
    skipped = int(np.sum(np.diff(timing["number"]) - 1))
    axes = {
        name: _axis_summary(recording.axis(name), unit, recording) for name, unit in recording.axes.items()
    }
    ending = recording.metadata.get("ending", {})
    under_control = running_rows(timing, recording)[1:]
    dropped, unreadable, not_sent, rejected, lost, error_frames = (
        int(ending[key]) if ending.get(key, "").isdecimal() else None
        for key in (
            "frames dropped by the kernel",
            "frames unreadable",
            "frames not sent",
            "rejected frames",
            "lost samples",
            "error frames",
        )
    )
    return Summary(
        axes={name: summary for name, summary in axes.items() if summary is not None},
        lateness=_quantiles(timing["wake_ns"] - timing["deadline_ns"]),
        response=_quantiles(_response_ns(fresh, recording.frames("sent", SYNC).time_ns)),
        periods=len(timing),
        missed_periods=skipped,
        periods_without_sample=len(timing) - len(fresh),
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
        controlled_s=float(np.ptp(under_control["deadline_ns"])) * 1e-9 if len(under_control) else 0.0,
        asked_s=float(ending[ASKED]) if ASKED in ending else None,
    )


def _response_ns(fresh: TimingTable, sync_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """From the last SYNC before each sample to the period's command."""
    last = np.searchsorted(sync_ns, fresh["receive_ns"], side="right") - 1
    return np.asarray((fresh["sent_ns"] - sync_ns[last])[last >= 0], np.int64)


def running_rows(rows: RowsT, recording: Recording) -> RowsT:
    """The periods in which the controller acted, and the one before."""
    states = [value for value, name in recording.state_names.items() if name == "running"]
    running = np.flatnonzero(np.isin(rows["state"], states))
    return rows[max(running[0] - 1, 0) : running[-1] + 1] if len(running) else rows[:0]


def _axis_summary(rows: AxisTable, unit: str, recording: Recording) -> StepResponse | Tracking | None:
    rows = running_rows(rows, recording)
    if len(rows) < 2:
        return None
    step = _last_step(rows["setpoint"])
    rows_under_control = rows[1:]
    lowest_v = float(rows_under_control["command_v"].min())
    highest_v = float(rows_under_control["command_v"].max())
    if step is None:
        errors = rows_under_control["error"]
        rms = float(np.sqrt(np.mean(errors**2)))
        return Tracking(unit, rms, float(np.abs(errors).max()), lowest_v, highest_v)
    before, after = float(rows["setpoint"][step - 1]), float(rows["setpoint"][step])
    times_s = (rows["time_ns"][step:] - rows["time_ns"][step]) * 1e-9
    deviation = (rows["position"][step:] - after) / (after - before)
    steady = rows["error"][step:][-max(round(STEADY_PART * len(deviation)), 1) :]
    return StepResponse(
        unit=unit,
        step_from=before,
        step_to=after,
        overshoot_percent=100.0 * max(float(deviation.max()), 0.0),
        settling_s=_settling_s(times_s, deviation),
        steady_state_error=float(np.mean(steady)),
        lowest_valve_v=lowest_v,
        highest_valve_v=highest_v,
    )


def _last_step(setpoint: npt.NDArray[np.float64]) -> int | None:
    """Index of the first sample after the last step; None where the setpoint last moved otherwise.

    Sample 0 is from before the run, when the setpoint follows the position: going from there to where the
    setpoint begins is a step only if it is no mere deviation of the position.
    """
    changes = np.flatnonzero(np.diff(setpoint)) + 1
    in_run = changes[changes > 1]
    if len(in_run) == 0:
        begins_elsewhere = abs(setpoint[1] - setpoint[0]) > 0.1 * abs(setpoint[1]) > 0.0
        return 1 if begins_elsewhere else None
    is_isolated = len(in_run) == 1 or in_run[-1] - in_run[-2] >= CONSTANT_PERIODS
    return int(in_run[-1]) if is_isolated else None


def _settling_s(times_s: npt.NDArray[np.float64], deviation: npt.NDArray[np.float64]) -> float | None:
    outside = np.flatnonzero(np.abs(deviation) > SETTLING_BAND)
    if len(outside) == 0:
        return 0.0
    first_inside = int(outside[-1]) + 1
    return float(times_s[first_inside]) if first_inside < len(times_s) else None


def _quantiles(durations_ns: npt.NDArray[np.int64]) -> Quantiles:
    if len(durations_ns) == 0:
        return Quantiles(0.0, 0.0, 0.0, 0.0)
    values = np.percentile(durations_ns, [50.0, 99.0, 99.9, 100.0], method="inverted_cdf") * 1e-3
    return Quantiles(*(float(value) for value in values))


def _rendered(summary: Summary) -> RenderableType:
    from rich.box import SIMPLE_HEAD
    from rich.console import Group
    from rich.table import Table

    steps = Table(
        "axis",
        "step",
        "overshoot",
        "2 %\nsettling",
        "steady-state\nerror",
        "valve",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    tracking = Table("axis", "RMS error", "largest error", "valve", box=SIMPLE_HEAD, pad_edge=False)
    for name, axis in summary.axes.items():
        unit = axis.unit
        valve = f"{axis.lowest_valve_v:.2f}…{axis.highest_valve_v:.2f} V"
        if isinstance(axis, StepResponse):
            steps.add_row(
                name,
                f"{axis.step_from:.4g}→{axis.step_to:.4g} {unit}",
                f"{axis.overshoot_percent:.2f} %",
                "did not settle" if axis.settling_s is None else f"{axis.settling_s:.2f} s",
                f"{1e3 * axis.steady_state_error:.2f} m{unit}",
                valve,
            )
        else:
            rms, largest = 1e3 * axis.rms_error, 1e3 * axis.largest_error
            tracking.add_row(name, f"{rms:.2f} m{unit}", f"{largest:.2f} m{unit}", valve)
    loop = Table("loop", "p50", "p99", "p99.9", "worst", box=SIMPLE_HEAD, pad_edge=False)
    answered = summary.periods - summary.periods_without_sample
    for name, quantiles, count in (
        ("lateness", summary.lateness, summary.periods),
        ("response", summary.response, answered),
    ):
        loop.add_row(name, *(f"{value:.0f} µs" if count else "–" for value in asdict(quantiles).values()))
    counts = (
        f"{summary.periods} periods, {summary.missed_periods} missed, "
        f"{summary.periods_without_sample} without a sample; "
        f"{summary.frames_received} frames received, {summary.frames_sent} sent"
    )
    tables = [table for table in (steps, tracking) if table.row_count]
    notes = [] if summary.complete else ["The recording was cut off; this is what it holds."]
    if summary.ending == "interrupted":
        of = "" if summary.asked_s is None else f" of {summary.asked_s:g}"
        notes.append(f"interrupted after {summary.controlled_s:.0f} s{of}")
    return Group(*tables, loop, counts, _losses(summary), *notes)


def _losses(summary: Summary) -> Text:
    """What went missing, loudly; or that nothing did."""
    from rich.text import Text

    counted = (
        (summary.frames_dropped, "frame", "dropped on arrival"),
        (summary.frames_unreadable, "frame", "unreadable"),
        (summary.frames_not_sent, "frame", "not sent"),
        (summary.frames_rejected, "frame", "rejected"),
        (summary.samples_lost, "sample", "lost"),
        (summary.error_frames, "error frame", "on the bus"),
        (summary.messages_dropped, "message", "not recorded"),
    )
    bad = [f"{count} {what}{'s' * (count > 1)} {how}" for count, what, how in counted if count]
    if bad:
        return Text(f"ATTENTION: {', '.join(bad)}", style="bold red")
    return Text("nothing dropped, rejected or lost" if summary.complete else "")
