"""The cards and tables of a report as texts."""

from __future__ import annotations

from hil.views.promises import Outcome, Promise
from hil.views.summary import StepResponse, Summary, Tracking


def cards(summary: Summary) -> list[tuple[str, str, str]]:
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


def step_rows(summary: Summary) -> list[list[str]]:
    """Return the row of each axis whose last change of the setpoint was a step from rest."""
    return [
        [
            name,
            f"{axis.step_from:.4g} → {axis.step_to:.4g} {axis.unit}",
            value_text(axis.rise_s, "s"),
            "does not settle" if axis.settling_s is None else f"{axis.settling_s:.3f} s",
            f"{axis.overshoot_percent:.2f} %",
            f"{1e3 * axis.steady_state_error:.3f} m{axis.unit}",
            f"{axis.min_valve_v:.2f} to {axis.max_valve_v:.2f} V",
        ]
        for name, axis in summary.axes.items()
        if isinstance(axis, StepResponse)
    ]


def tracking_rows(summary: Summary) -> list[list[str]]:
    """Return the row of each axis whose setpoint was something else."""
    return [
        [
            name,
            f"{1e3 * axis.rms_error:.3f} m{axis.unit}",
            f"{1e3 * axis.max_error:.3f} m{axis.unit}",
            "unknown" if axis.delay_s is None else f"{1e3 * axis.delay_s:.0f} ms",
            f"{axis.min_valve_v:.2f} to {axis.max_valve_v:.2f} V",
        ]
        for name, axis in summary.axes.items()
        if isinstance(axis, Tracking)
    ]


def promise_row(promise: Promise) -> tuple[list[str], str]:
    """Return the cells of a promise, and the style of its verdict."""
    cells = [
        promise.axis,
        promise.quantity,
        limit_text(promise),
        value_text(promise.predicted, promise.unit),
        value_text(promise.measured, promise.unit),
        promise.outcome.value,
    ]
    return cells, {Outcome.MET: "good", Outcome.MISSED: "bad"}.get(promise.outcome, "soft")


def limit_text(promise: Promise) -> str:
    """Return a limit with its sign and unit, such as "≤ 0.6 s"."""
    return f"{promise.sign} {promise.limit:g} {promise.unit}".strip()


def value_text(value: float | None, unit: str) -> str:
    """Return a value with its unit; a dash if there is none."""
    return "–" if value is None else f"{value:.4g} {unit}".strip().replace("inf", "∞")


def quantile_rows(summary: Summary) -> list[list[str]]:
    """Return the rows of lateness and response, in µs."""
    return [
        [name, *(f"{value:.0f}" for value in (q.p50_us, q.p99_us, q.p99_9_us, q.max_us))]
        for name, q in (("lateness", summary.lateness), ("response", summary.response))
        if q is not None
    ]


def count_rows(summary: Summary) -> list[tuple[str, str]]:
    """Return label and number of what is counted."""
    rows: list[tuple[str, int | None]] = [
        ("periods", summary.periods),
        ("periods before the boards were up", summary.bring_up_periods),
        ("periods skipped because the loop was late", summary.missed_periods),
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
    if summary.frames_destroyed is not None:
        rows.insert(-1, ("frames destroyed on the bus", summary.frames_destroyed))
    return [(label, "not recorded" if count is None else str(count)) for label, count in rows]
