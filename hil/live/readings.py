"""Readings of the last step of each axis while it settles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from types import MappingProxyType
from typing import Any

import numpy as np

from hil.live.history import COLUMNS, Rows
from hil.recording.tables import AxisTable, BoolArray, FloatArray
from hil.views.summary import axis_summary

TRACKING_S = 30.0
"""Time in s over which an axis is read that has made no step."""
REST_ROWS = 9
"""Number of periods, 0.1 s, for which a setpoint must be constant to be at rest."""
MAX_MOVE_ROWS = 450
"""Longest move of a setpoint that counts as a step: 5 s."""
MAX_REST_ROWS = 90
"""Largest number of periods before a step that are read: 1 s."""
MAX_STEP_ROWS = 5400
"""Largest number of periods after a step that are read: 60 s. Later disturbances are not the step's, and a
page that is open for long must not read ten minutes of periods each second."""


def readings(
    rows: Rows,
    axes: Sequence[tuple[str, str]],
    states: Sequence[str],
    min_steps: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return the readings of the last step, or of tracking, by the axis' name; nothing unless running now.

    ``rows`` as in ``History``; ``axes``: name and unit of each; ``states``: the life cycle's, by number;
    ``min_steps``: smallest change of the setpoint that is a step, by the axis' name and in its unit.
    """
    is_running = rows[:, COLUMNS.index("state")] == list(states).index("running")
    if not is_running.any() or not is_running[-1]:
        return {}
    stops = np.flatnonzero(~is_running)
    rows = rows[stops[-1] if len(stops) else 0 :]
    running = np.ones(len(rows), np.bool_)
    running[0] = len(stops) == 0
    found: dict[str, Any] = {}
    for place, (name, unit) in enumerate(axes):
        part, read = _rows_to_read(rows, place)
        summary = axis_summary(_table(read, place, running[part], name, unit), min_steps.get(name, 0.0))
        if summary is not None:
            found[name] = {"kind": type(summary).__name__, **asdict(summary)}
    return found


def _last_move(setpoint: FloatArray) -> tuple[int, int, int] | None:
    """Return the first row at rest before the last move, the last one before it, and the first one after it.

    A daemon approaches a setpoint with limited speed and acceleration; a run has steps. Both are moves from
    rest to rest. None means that the setpoint never changed, still moves, or moved for longer than
    ``MAX_MOVE_ROWS``.
    """
    changes = np.flatnonzero(np.diff(setpoint))
    if len(changes) == 0:
        return None
    pauses = np.flatnonzero(np.diff(changes) > REST_ROWS)
    rest = int(changes[pauses[-1]]) + 1 if len(pauses) else 0
    begin, end = int(changes[pauses[-1] + 1 if len(pauses) else 0]), int(changes[-1]) + 1
    is_at_rest_again = end + REST_ROWS < len(setpoint)
    if begin - rest < REST_ROWS or not is_at_rest_again or end - begin > MAX_MOVE_ROWS:
        return None
    return rest, begin, end


def _rows_to_read(rows: Rows, place: int) -> tuple[slice, Rows]:
    """Return which rows an axis is read from, and these rows with the last move of its setpoint as a step."""
    column = len(COLUMNS) + 3 * place
    move = _last_move(rows[:, column])
    if move is None:
        part = slice(int(np.searchsorted(rows[:, 0], rows[-1, 0] - TRACKING_S)), len(rows))
        return part, rows[part]
    rest, begin, end = move
    first = max(rest, begin - MAX_REST_ROWS)
    part = slice(first, end + MAX_STEP_ROWS)
    read = rows[part].copy()
    read[begin + 1 - first : end - first, column] = rows[end, column]
    return part, read


def _table(rows: Rows, place: int, running: BoolArray, name: str, unit: str) -> AxisTable:
    """Return the rows of one axis as the table of a recording. Signals that the rows lack are 0."""
    r, y, v = (rows[:, len(COLUMNS) + 3 * place + column] for column in range(3))
    lacking = np.zeros(len(rows))
    bytes_ = np.zeros(len(rows), np.uint8)
    return AxisTable(
        time_s=rows[:, 0],
        time_ns=np.round(rows[:, 0] * 1e9).astype(np.int64),
        setpoint=r,
        position=y,
        error=r - y,
        output_v=lacking,
        command_v=v,
        potentiometer_v=lacking,
        phase=bytes_,
        state=bytes_,
        fresh=running,
        running=running,
        name=name,
        unit=unit,
    )
