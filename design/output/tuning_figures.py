"""Draw the measured steps of a tuning beside what its models predict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from design.output.charts import Band, Curve, Limit, Panel, Style, draw
from design.output.figures import Figure
from design.output.scales import Axis
from design.output.tuning_results import Tuning, Verified
from hil.recording import open_recording

_BEFORE_S = 0.3
"""Time before the step that is drawn."""
_SETPOINT = Style("#3d4450", "5 3", 1.2)
_PREDICTED = Style("#d55e00", "7 3", 1.6)
_MEASURED = Style("#0072b2", "", 2.0)
_VALVE = Style("#1b1f23", "", 1.0)


def step_figure(tuning: Tuning, verified: Verified) -> Figure:
    """Draw setpoint, predicted and measured position, and the valve voltage. Raises RecordingError."""
    table = open_recording(verified.recording).axis(tuning.job.axis)
    measured, name = verified.measured, verified.condition.name
    low, high = measured.step_from, measured.step_to
    at = int(np.flatnonzero(np.diff(table.setpoint) * table.running[1:])[-1]) + 1
    time_s = table.time_s - table.time_s[at]
    shown = (time_s >= -_BEFORE_S) & table.running
    time_s = time_s[shown]
    position, setpoint, command_v = table.position[shown], table.setpoint[shown], table.command_v[shown]
    x = Axis("time after the step, s", low=-_BEFORE_S, high=float(time_s[-1]))
    limits = tuning.design_file.specifications
    marks = []
    if limits.overshoot is not None:
        marks.append(
            Limit(high + limits.overshoot * (high - low), f"overshoot limit {100.0 * limits.overshoot:g} %")
        )
    if limits.settling_s is not None:
        marks.append(Limit(limits.settling_s, f"settled by {limits.settling_s:g} s", of_x=True))
    band = sorted((high - 0.02 * (high - low), high + 0.02 * (high - low)))
    output = Panel(
        x,
        Axis(f"position, {measured.unit}"),
        (
            Curve("setpoint", time_s, setpoint, _SETPOINT, holds=True),
            Curve("measured", time_s, position, _MEASURED),
            *_predicted(tuning, verified, float(time_s[-1])),
        ),
        tuple(marks),
        (Band(band[0], band[1], "± 2 %"),),
        height=250,
    )
    valve = Panel(x, Axis("valve, V"), (Curve("", time_s, command_v, _VALVE, holds=True),), height=90)
    failed = "; ".join(verified.failures)
    verdict = f"Not met: {failed}." if failed else "The step meets the specifications."
    return Figure(
        f"step-{name}",
        f"Condition {name}",
        f"{verdict} The prediction is the linear model of this condition, from rest."
        f"{_start_text(float(table.error[at - 1]), high - low, measured.unit)}",
        draw([output, valve], f"step {name}"),
    )


def _start_text(error: float, size: float, unit: str) -> str:
    """Say that the axis was not at rest before the step, if it was outside the settling band."""
    if abs(error) <= 0.02 * abs(size):
        return ""
    return (
        f" When the step came, the axis was still {abs(error):.3g} {unit} away from the setpoint before; the "
        "readings contain this."
    )


def _predicted(tuning: Tuning, verified: Verified, horizon_s: float) -> list[Curve]:
    """Return the step that the model of the condition predicts; nothing if that loop is unstable."""
    measured = verified.measured
    size = measured.step_to - measured.step_from
    for model in tuning.models:
        if model.condition == verified.condition:
            problem = replace(tuning.design.problem, plant=model.plant)
            response = problem.step(tuning.design.designed, horizon_s)
            if not np.isfinite(response.y).all():
                return []
            y = measured.step_from + size * response.y[0]
            return [Curve("predicted", response.time_s, y, _PREDICTED)]
    return []
