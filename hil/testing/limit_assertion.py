"""An assertion on the limits of an axis."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from hil.core.rig import VOLTS_PER_COUNT, Rig
from hil.recording.tables import AxisTable
from hil.testing.readings import Run, axis_table, control_time_s, rig_of

Range: TypeAlias = tuple[float, float]


def assert_within_limits(
    run: Run,
    axis: str | None = None,
    *,
    position: Range | None = None,
    max_error: float | None = None,
    valve_v: Range | None = None,
    max_valve_rate_v_s: float | None = None,
    from_s: float = 0.0,
    to_s: float = float("inf"),
) -> None:
    """Assert that an axis stays within its limits while its controller acts.

    ``run`` is a rig in simulated time, a recording, its path, or an axis table. Without ``axis``, every axis
    of the run is checked. A limit that is None is taken from the rig file of the run: the envelope's soft end
    stops for ``position`` (m or rad), the valve's range for ``valve_v`` (V) and its largest rate for
    ``max_valve_rate_v_s`` (V/s). ``max_error`` is the largest magnitude of setpoint minus position; it has no
    default. Times are in seconds of control, as those of setpoints.

    Raises AssertionError that gives, for each limit, the worst value, its limit, its time and the axis.

    >>> assert_within_limits("run.mcap", "vertical", max_error=0.11)
    """
    __tracebackhide__ = True
    rig = rig_of(run)
    names = [axis] if axis is not None or rig is None else list(rig.axes)
    problems: list[str] = []
    for name in names:
        table = axis_table(run, name)
        limits = _limits(rig, table.name)
        problems += _violations(
            table,
            position or limits[0],
            max_error,
            valve_v or limits[1],
            max_valve_rate_v_s if max_valve_rate_v_s is not None else limits[2],
            (from_s, to_s),
        )
    if problems:
        raise AssertionError("\n".join(problems))


def _limits(rig: Rig | None, name: str) -> tuple[Range | None, Range | None, float | None]:
    """Return the limits of the rig file: position, valve voltage, valve rate."""
    if rig is None:
        return None, None, None
    settings = rig.axes[name]
    valve = settings.valve
    limits = settings.limits
    return (limits.min_y, limits.max_y), (valve.min_v, valve.max_v), valve.max_rate_v_s


def _violations(
    table: AxisTable,
    position: Range | None,
    max_error: float | None,
    valve_v: Range | None,
    max_rate_v_s: float | None,
    window: Range,
) -> list[str]:
    times_s = control_time_s(table)
    inside = table.running & table.fresh & (times_s >= window[0]) & (times_s <= window[1])
    assert bool(inside.any()), (
        f"{table.name}: no period under control between {window[0]:g} and {window[1]:g} s of control"
    )
    rows, at_s = table[inside], times_s[inside]
    problems: list[str] = []
    for what, values, unit, limits in (
        ("position", rows.position, table.unit, position),
        ("valve voltage", rows.command_v, "V", valve_v),
    ):
        if limits is not None:
            problems += _outside(table.name, what, values, unit, limits, at_s)
    if max_error is not None:
        limits = (-max_error, max_error)
        problems += _outside(table.name, "error", rows.error, table.unit, limits, at_s)
    if max_rate_v_s is not None and len(rows) > 1:
        elapsed_s = np.diff(rows.time_ns) * 1e-9
        rate = np.diff(rows.command_v) / elapsed_s
        tolerance = VOLTS_PER_COUNT / float(elapsed_s.min())  # commands are rounded to counts
        limits = (-max_rate_v_s - tolerance, max_rate_v_s + tolerance)
        problems += _outside(table.name, "valve rate", rate, "V/s", limits, at_s[1:])
    return problems


def _outside(
    name: str, what: str, values: np.ndarray, unit: str, limits: Range, at_s: np.ndarray
) -> list[str]:
    """Return the worst violation of each side."""
    low, high = limits
    problems = []
    for worst, limit, is_over in (
        (int(np.argmin(values)), low, bool(values.min() < low)),
        (int(np.argmax(values)), high, bool(values.max() > high)),
    ):
        if is_over:
            count = int(np.sum(values < low if limit == low else values > high))
            problems.append(
                f"{name}: {what} {values[worst]:.4g} {unit} at {at_s[worst]:.3f} s of control, limit "
                f"{limit:.4g} {unit}; {count} periods beyond it"
            )
    return problems
