"""The signals of an axis that a plot draws, read window by window: one axis of ten hours takes 110 MB."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.recording.reader import Recording
from hil.recording.schemas import AXIS_TOPIC
from hil.recording.tables import FloatArray
from hil.views.loop_figures import WINDOW_S

_NAMES = ("time_s", "setpoint", "position", "command_v")


@dataclass(frozen=True, eq=False)
class AxisColumns:
    """The signals of one axis that are drawn, one row for each period."""

    time_s: FloatArray
    """Time in seconds from the first recorded period."""
    setpoint: FloatArray
    position: FloatArray
    command_v: FloatArray
    unit: str


def axis_columns(recording: Recording, name: str) -> AxisColumns:
    """Read the signals of an axis. Raises RecordingError without that axis."""
    count, filled = recording.counts.get(AXIS_TOPIC + name, 0), 0
    columns: dict[str, np.ndarray[Any, Any]] = {column: np.empty(count) for column in _NAMES}
    for window in recording.windows(WINDOW_S):
        table = window.axis(name)
        for column, values in columns.items():
            values[filled : filled + len(table)] = table[column]
        filled += len(table)
    return AxisColumns(
        **{column: values[:filled] for column, values in columns.items()}, unit=recording.axes[name]
    )
