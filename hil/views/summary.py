"""Sums up a run from its recording: step responses or tracking errors of the axes, timing of the loop.

Overshoot, 2 % settling time and steady-state error as in Franklin, Powell, Emami-Naeini, Feedback Control of
Dynamic Systems, section 3.4. ``summary_table`` prints a summary.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hil.recording.reader import Recording
from hil.recording.tables import AxisTable, IntArray
from hil.views.run_columns import AxisColumns, TimingColumns, axis_columns, timing_columns

if TYPE_CHECKING:
    from rich.console import RenderableType

REQUESTED_DURATION = "duration asked for, s"
"""Key of the requested duration in the metadata ``ending``."""
SETTLING_BAND = 0.02
"""Settling tolerance as a part of the step's size."""
STEADY_PART = 0.2
"""Last part of the response over which the steady-state error is averaged."""
MIN_CONSTANT_PERIODS = 5
"""A change of the setpoint is a step only with a constant setpoint for this many periods on either side."""
MAX_INITIAL_ERROR = 0.1
"""A change of the setpoint is a step only if the error before it was at most this part of its size.

Otherwise the axis was still on its way to an earlier setpoint, as in a fast ladder or a random excitation,
and the readings would mix two responses. It must hold for every change of the run: a single one that does is
chance.
"""
RISE_FROM, RISE_TO = 0.1, 0.9
"""Parts of the step's size between which the rise time is measured."""
MAX_DELAY_S = 2.0
"""Largest delay of the position behind the setpoint that is looked for."""
MAX_DELAY_PERIODS = 60_000
"""Number of periods, from the first one on, from which the delay is computed: eleven minutes."""


@dataclass(frozen=True)
class StepResponse:
    """The response to the last step of the setpoint. Positions and errors are in ``unit``."""

    unit: str
    step_from: float
    step_to: float
    overshoot_percent: float
    """Largest deviation beyond ``step_to``, in per cent of the step's size."""
    settling_s: float | None
    """Time from the step until the position stays within 2 % of the step's size; None if it does not."""
    steady_state_error: float
    """Mean of setpoint minus position over the last fifth of the response."""
    rise_s: float | None
    """Time from 10 to 90 % of the step's size; None if the position does not reach 90 %."""
    min_valve_v: float
    max_valve_v: float


@dataclass(frozen=True)
class Tracking:
    """The errors with a setpoint other than a step from rest. Errors are in ``unit``."""

    unit: str
    rms_error: float
    max_error: float
    """Largest magnitude of the error."""
    delay_s: float | None
    """Shift of the setpoint in time for which it is closest to the position; None if it is constant."""
    min_valve_v: float
    max_valve_v: float


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

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for other programs; the keys carry the units."""
        return asdict(self)

    def table(self) -> RenderableType:
        """Return the tables and notes for the terminal."""
        from hil.views.summary_table import render

        return render(self)


def summarise(recording: Recording) -> Summary:
    """Sum up ``recording``. Raises RecordingError when it lacks the channels of the loop."""
    axes = {name: axis_summary(axis_columns(recording, name)) for name in recording.axes}
    return sum_up(recording, timing_columns(recording), axes)


def sum_up(
    recording: Recording, timing: TimingColumns, axes: Mapping[str, StepResponse | Tracking | None]
) -> Summary:
    """Return the summary from the timing and the figures of the axes, for callers that have read them."""
    counts = recording.counts
    bring_up_periods = _bring_up_periods(timing, recording.state_names)
    ending = recording.metadata.get("ending", {})
    controlled = timing[_controlled(timing)][1:]
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
        lateness=quantiles(timing.lateness_ns),
        response=quantiles(timing.response_ns[timing.response_ns >= 0]),
        periods=len(timing),
        bring_up_periods=bring_up_periods,
        missed_periods=int(np.sum(np.diff(timing.number) - 1)),
        periods_without_sample=int(np.sum(~timing.fresh[bring_up_periods:])),
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
        controlled_s=_span_s(controlled),
        requested_s=float(ending[REQUESTED_DURATION]) if REQUESTED_DURATION in ending else None,
        bus_load=float(ending["bus load"]) if "bus load" in ending else None,
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
        (summary.messages_dropped, "message", "not recorded"),
    )
    return [f"{count} {what}{'s' * (count > 1)} {how}" for count, what, how in counted if count]


def _span_s(timing: TimingColumns) -> float:
    """Return the time in seconds from the first deadline to the last one."""
    if len(timing) == 0:
        return 0.0
    late_s = timing.lateness_ns[[0, -1]] * 1e-9
    return float((timing.time_s[-1] - late_s[1]) - (timing.time_s[0] - late_s[0]))


def _bring_up_periods(timing: TimingColumns, state_names: dict[int, str]) -> int:
    """Return the number of periods before the gateway first left the state offline."""
    offline = [value for value, name in state_names.items() if name == "offline"]
    is_up = ~np.isin(timing.state, offline)
    return int(np.argmax(is_up)) if is_up.any() else len(timing)


def _controlled(table: AxisColumns | AxisTable | TimingColumns) -> slice:
    """Return the periods from the last one before the controllers acted to the last one in which they did."""
    running = np.flatnonzero(table.running)
    return slice(max(running[0] - 1, 0), running[-1] + 1) if len(running) else slice(0)


def axis_summary(axis: AxisColumns | AxisTable) -> StepResponse | Tracking | None:
    """Return the figures of one axis; None if it was not controlled."""
    axis = axis[_controlled(axis)]
    if len(axis) < 2:
        return None
    controlled = axis[1:]
    min_valve_v, max_valve_v = float(controlled.command_v.min()), float(controlled.command_v.max())
    step = _last_step(axis)
    if step is None:
        rms = float(np.sqrt(np.mean(controlled.error**2)))
        largest = float(np.abs(controlled.error).max())
        return Tracking(axis.unit, rms, largest, _delay_s(controlled), min_valve_v, max_valve_v)
    before, after = float(axis.setpoint[step - 1]), float(axis.setpoint[step])
    times_s = axis.time_s[step:] - axis.time_s[step]
    deviation = axis.position[step:] - after
    deviation /= after - before
    steady = axis.error[step:][-max(round(STEADY_PART * len(deviation)), 1) :]
    return StepResponse(
        unit=axis.unit,
        step_from=before,
        step_to=after,
        overshoot_percent=100.0 * max(float(deviation.max()), 0.0),
        settling_s=_settling_s(times_s, deviation),
        steady_state_error=float(np.mean(steady)),
        rise_s=_rise_s(times_s, deviation),
        min_valve_v=min_valve_v,
        max_valve_v=max_valve_v,
    )


def _last_step(axis: AxisColumns | AxisTable) -> int | None:
    """Return the row in which the setpoint last changed, or None if a change is not a step from rest.

    Row 0 is from before the controllers acted, when the setpoint follows the position. The change from there
    to the first setpoint is a step only if it is more than a deviation of the position.
    """
    setpoint = axis.setpoint
    changes = np.flatnonzero(np.diff(setpoint)) + 1
    controlled = changes[changes > 1]
    if len(controlled) == 0:
        starts_elsewhere = abs(setpoint[1] - setpoint[0]) > 0.1 * abs(setpoint[1]) > 0.0
        return 1 if starts_elsewhere else None
    was_constant = np.all(np.diff([*controlled, len(axis)]) >= MIN_CONSTANT_PERIODS)
    size = np.abs(setpoint[controlled] - setpoint[controlled - 1])
    was_at_rest = np.all(np.abs(axis.error[controlled - 1]) <= MAX_INITIAL_ERROR * size)
    return int(controlled[-1]) if was_constant and was_at_rest else None


def _settling_s(times_s: npt.NDArray[np.float64], deviation: npt.NDArray[np.float64]) -> float | None:
    outside = np.flatnonzero((deviation > SETTLING_BAND) | (deviation < -SETTLING_BAND))
    if len(outside) == 0:
        return 0.0
    first_inside = int(outside[-1]) + 1
    return float(times_s[first_inside]) if first_inside < len(times_s) else None


def _rise_s(times_s: npt.NDArray[np.float64], deviation: npt.NDArray[np.float64]) -> float | None:
    reached = [np.flatnonzero(deviation >= part - 1.0) for part in (RISE_FROM, RISE_TO)]
    if len(reached[1]) == 0:
        return None
    return float(times_s[reached[1][0]] - times_s[reached[0][0]])


def _delay_s(axis: AxisColumns | AxisTable) -> float | None:
    """Return the delay for which the mean square of position minus delayed setpoint is smallest."""
    setpoint, position = axis.setpoint[:MAX_DELAY_PERIODS], axis.position[:MAX_DELAY_PERIODS]
    count = len(setpoint)
    if count < 2 or np.ptp(setpoint) == 0.0:
        return None
    period_s = float(np.median(np.diff(axis.time_s[:MAX_DELAY_PERIODS])))
    largest = min(round(MAX_DELAY_S / period_s), count // 2)
    errors = [
        float(np.mean((position[delay:] - setpoint[: count - delay]) ** 2)) for delay in range(largest + 1)
    ]
    return int(np.argmin(errors)) * period_s


def quantiles(durations_ns: IntArray) -> Quantiles | None:
    """Return the quantiles of durations; None without one."""
    if len(durations_ns) == 0:
        return None
    values = np.percentile(durations_ns, [50.0, 99.0, 99.9, 100.0], method="inverted_cdf") * 1e-3
    return Quantiles(*(float(value) for value in values))
