"""Readings of the last step of each axis while it settles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from hil.live.history import COLUMNS, Rows
from hil.recording.tables import AxisTable, BoolArray
from hil.views.summary import axis_summary

BEFORE_LAST_CHANGE_S = 30.0
"""Time in s before the last change of a setpoint from which on rows are read.

It is also the time over which tracking is read while a setpoint moves, or never changes.
"""


def readings(rows: Rows, axes: Sequence[tuple[str, str]], states: Sequence[str]) -> dict[str, Any]:
    """Return the readings of the last step, or of tracking, by the axis' name; nothing unless running now.

    ``rows`` as in ``History``; ``axes``: name and unit of each; ``states``: the life cycle's, by number.
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
        begin = _first_row(rows, place)
        summary = axis_summary(_table(rows[begin:], place, running[begin:], name, unit))
        if summary is not None:
            found[name] = {"kind": type(summary).__name__, **asdict(summary)}
    return found


def _first_row(rows: Rows, place: int) -> int:
    """Return the row from which on an axis is read."""
    changes = np.flatnonzero(np.diff(rows[:, len(COLUMNS) + 3 * place]))
    last_s = rows[changes[-1] if len(changes) else -1, 0]
    return int(np.searchsorted(rows[:, 0], last_s - BEFORE_LAST_CHANGE_S))


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
