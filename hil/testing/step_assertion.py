"""An assertion on the step response of an axis."""

from __future__ import annotations

import numpy as np

from hil.recording.tables import AxisTable
from hil.testing.readings import Run, axis_table, control_time_s
from hil.views.summary import MAX_INITIAL_ERROR, SETTLING_BAND, StepResponse, axis_summary


def assert_step_response(
    run: Run,
    axis: str | None = None,
    *,
    overshoot: float | None = None,
    settling_s: float | None = None,
    steady_state_error: float | None = None,
) -> StepResponse:
    """Assert limits of the response to the last step of the setpoint. Returns its readings.

    ``run`` is a rig in simulated time, a recording, its path, or an axis table. ``overshoot`` is a fraction
    of the step's size (0.05 is 5 %), ``settling_s`` the time in seconds until the position stays within 2 %
    of the step's size, ``steady_state_error`` a magnitude in the axis' unit. A limit that is None is not
    checked.

    Raises AssertionError with every value, its limit, the time and the axis. It also fails if the setpoint
    made no step from rest, because then there is no step response.

    >>> assert_step_response("run.mcap", "vertical", overshoot=0.05, settling_s=1.0).unit
    'm'
    """
    __tracebackhide__ = True
    table = axis_table(run, axis)
    readings = axis_summary(table)
    if not isinstance(readings, StepResponse):
        raise AssertionError(f"{table.name}: there is no step response: {_why_no_step(table)}")
    problems = list(_problems(table, readings, overshoot, settling_s, steady_state_error))
    if problems:
        unit = readings.unit
        head = f"{table.name}: step from {readings.step_from:.4g} to {readings.step_to:.4g} {unit}"
        raise AssertionError("\n".join([f"{head} at {_step_time_s(table, readings):.3f} s:", *problems]))
    return readings


def _problems(
    table: AxisTable,
    readings: StepResponse,
    overshoot: float | None,
    settling_s: float | None,
    steady_state_error: float | None,
) -> list[str]:
    problems = []
    times_s, unit = control_time_s(table), readings.unit
    size, step_s = readings.step_to - readings.step_from, _step_time_s(table, readings)
    after = table.running & (times_s >= step_s)
    if overshoot is not None and readings.overshoot_percent > 100.0 * overshoot:
        beyond = np.where(after, (table.position - readings.step_to) * np.sign(size), -np.inf)
        peak = int(np.argmax(beyond))
        problems.append(
            f"  overshoot {readings.overshoot_percent:.2f} %, limit {100.0 * overshoot:.4g} %: "
            f"{table.position[peak]:.4f} {unit} at {times_s[peak]:.3f} s"
        )
    if settling_s is not None and (readings.settling_s is None or readings.settling_s > settling_s):
        band = SETTLING_BAND * abs(size)
        outside = np.flatnonzero(after & (np.abs(table.position - readings.step_to) > band))
        last = int(outside[-1]) if len(outside) else int(np.argmax(after))
        took = "never within" if readings.settling_s is None else f"{readings.settling_s:.3f} s into"
        problems.append(
            f"  settling time: {took} {100.0 * SETTLING_BAND:g} % (±{band:.2g} {unit}), limit "
            f"{settling_s:g} s: last outside at {times_s[last]:.3f} s with {table.position[last]:.4f} {unit}"
        )
    error = readings.steady_state_error
    if steady_state_error is not None and abs(error) > steady_state_error:
        problems.append(f"  steady-state error {error:.4g} {unit}, limit ±{steady_state_error:g} {unit}")
    return problems


def _step_time_s(table: AxisTable, readings: StepResponse) -> float:
    """Return the time of control at which the last step came."""
    at_end = np.flatnonzero(table.running & (table.setpoint == readings.step_to))
    before = np.flatnonzero(table.running & (table.setpoint != readings.step_to))
    first = int(before[-1]) + 1 if len(before) else int(at_end[0])
    return float(control_time_s(table)[first])


def _why_no_step(table: AxisTable) -> str:
    """Say why the last change of the setpoint is no step from rest."""
    setpoint, times_s = table.setpoint, control_time_s(table)
    changes = np.flatnonzero(table.running[1:] & table.running[:-1] & (np.diff(setpoint) != 0.0)) + 1
    if len(changes) == 0:
        return "the setpoint did not change under control; give one such as step:0.1@1"
    last = int(changes[-1])
    size, error = abs(setpoint[last] - setpoint[last - 1]), abs(table.error[last - 1])
    if error > MAX_INITIAL_ERROR * size:
        return (
            f"before the last step, of {size:.4g} {table.unit} at {times_s[last]:.3f} s, the axis was "
            f"{error:.4g} {table.unit} from its setpoint, limit {100 * MAX_INITIAL_ERROR:g} % of the step: "
            "it was not at rest. Let the step come later"
        )
    return (
        f"the setpoint was not constant before and after its last change at {times_s[last]:.3f} s; give one "
        "such as step:0.1@1, and run for longer than that"
    )
