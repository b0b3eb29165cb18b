"""Rows with time stamps, put on an even grid: a missing or misplaced row is a gap, not a sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from design.errors import DesignError
from design.identification.findings import Finding, Kind, Severity
from design.identification.records.experiment import Experiment, Names
from design.mathematics.polynomials import Array

TOLERANCE = 0.25
"""Largest distance of a row from its place on the grid, in sample times, at which it counts."""
MAX_IRREGULAR = 0.02
"""Share of rows off the grid above which the times are reported."""
REFUSED_IRREGULAR = 0.5
"""Share of rows off the grid above which the record is refused."""
MAX_GAP_FACTOR = 100
"""Largest ratio of the grid's length to the number of rows."""


class Gridded(NamedTuple):
    """A record on an even grid, and what was found about its times."""

    experiment: Experiment
    findings: tuple[Finding, ...]


def from_time_stamps(
    time_s: ArrayLike,
    u: ArrayLike,
    y: ArrayLike,
    *,
    sample_time_s: float | None = None,
    name: str = "record",
    names: Names | None = None,
    transport_delay_samples: int = 0,
    input_held_in_gaps: bool = False,
) -> Gridded:
    """Put rows (N,) with times in s on a grid of ``sample_time_s``, by default the median distance of rows.

    A place without a row is a gap, in which u and y are unknown. ``input_held_in_gaps`` states that the
    last input stays at the actuator meanwhile. Of two rows for one place the nearer one is taken. Raises
    DesignError where the times are no numbers or go backwards.
    """
    t = np.array(time_s, dtype=float)
    columns = [np.array(column, dtype=float) for column in (u, y)]
    names = names or Names()
    if t.ndim != 1 or any(column.shape != t.shape for column in columns) or len(t) < 2:
        raise DesignError(
            f"{name}: time, {names.u} and {names.y} must be columns of one length of at least 2"
        )
    if not np.isfinite(t).all():
        row = int(np.argmin(np.isfinite(t)))
        raise DesignError(f"{name}: row {row + 1}: the time is not a number; remove the row")
    steps = np.diff(t)
    if (steps < 0.0).any():
        row = int(np.argmax(steps < 0.0)) + 2
        raise DesignError(
            f"{name}: row {row}: the time goes back by {-steps[row - 2]:.6g} s; sort or cut the record"
        )
    period = float(np.median(steps)) if sample_time_s is None else float(sample_time_s)
    if not period > 0.0:
        raise DesignError(f"{name}: most rows have the same time; state the sample time")
    findings = _sample_time(steps, period, name)
    # Counted from row to row, so that a clock that is a little fast or slow does not add up.
    index = np.concatenate([[0], np.cumsum(np.rint(steps / period))]).astype(np.int64)
    length = int(index.max()) + 1
    if length > MAX_GAP_FACTOR * len(t):
        raise DesignError(
            f"{name}: {len(t)} rows span {length} sample times of {period:.6g} s; check the sample time "
            "and the unit of the times (seconds)"
        )
    clock = np.polyfit(index, t, 1) if index[-1] else np.array([period, t[0]])
    off = np.abs(t - np.polyval(clock, index)) / period
    on_grid = off <= TOLERANCE
    order = np.argsort(-off, kind="stable")
    grid = np.full((2, length), np.nan)
    taken = order[on_grid[order]]
    for row, column in enumerate(columns):
        grid[row, index[taken]] = column[taken]
    surplus = len(taken) - len(np.unique(index[taken]))
    findings += _irregular(int(np.count_nonzero(~on_grid)) + surplus, len(t), period, name)
    if input_held_in_gaps:
        grid[0] = _held(grid[0])
    experiment = Experiment(
        grid[0], grid[1], period, name=name, names=names, transport_delay_samples=transport_delay_samples
    )
    return Gridded(experiment, tuple(findings))


def _held(u: Array) -> Array:
    """Return the last known value at each place."""
    last = np.maximum.accumulate(np.where(np.isfinite(u), np.arange(len(u)), -1))
    return np.where(last >= 0, u[last], np.nan)


def _sample_time(steps: Array, period: float, name: str) -> list[Finding]:
    typical = float(np.median(steps))
    if abs(typical / period - 1.0) <= 0.05:
        return []
    return [
        Finding(
            Kind.SAMPLE_TIME,
            Severity.REFUSE,
            name,
            "time",
            typical,
            period,
            "s",
            f"the rows are {typical:.6g} s apart, but the sample time is given as {period:.6g} s",
            "give the true sample time, or times in seconds",
        )
    ]


def _irregular(misplaced: int, rows: int, period: float, name: str) -> list[Finding]:
    share = misplaced / rows
    if share <= MAX_IRREGULAR:
        return []
    severity = Severity.REFUSE if share > REFUSED_IRREGULAR else Severity.WARN
    return [
        Finding(
            Kind.IRREGULAR_TIMES,
            severity,
            name,
            "time",
            100.0 * share,
            100.0 * MAX_IRREGULAR,
            "%",
            f"{100.0 * share:.3g} % of the rows lie more than {TOLERANCE:g} sample times from an even grid "
            f"of {period:.6g} s (limit {100.0 * MAX_IRREGULAR:g} %), and are left out",
            "record the instants of sampling, and sample evenly",
        )
    ]
