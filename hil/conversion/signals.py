"""Signals of a recording as one table of all axes, block by block, so that memory stays bounded."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from hil.core.errors import RecordingError
from hil.core.suggestions import did_you_mean
from hil.recording.reader import Recording
from hil.recording.tables import AxisTable

Block: TypeAlias = dict[str, npt.NDArray[Any]]
"""Consecutive rows: an array for each column, by the column's name."""

PART_S = 600.0
"""Time of the recording that is read at once: 54,000 periods of 0.0112 s."""
BLOCK_ROWS = 65_536
"""Largest number of resampled rows in a block."""

_COMMON = (
    ("time_s", "s", "float64"),
    ("epoch_ns", "ns", "int64"),
    ("state", "", "uint8"),
    ("fresh", "", "bool"),
    ("running", "", "bool"),
)
"""Name, unit and type of the columns that all axes share."""
_OF_AXIS = (
    ("setpoint", None, "float64"),
    ("position", None, "float64"),
    ("error", None, "float64"),
    ("output", "V", "float64"),
    ("command", "V", "float64"),
    ("potentiometer", "V", "float64"),
    ("phase", "", "uint8"),
)
"""Name, unit (None: that of the axis) and type of the columns of each axis."""


class Column(NamedTuple):
    """A column of the exported table."""

    name: str
    """Name with the unit as a suffix, such as ``vertical.position_m``."""
    unit: str
    """Unit as written in metadata: s, ns, V, m or rad; empty for numbers and flags."""
    type: str
    """Name of the numpy type."""
    names: Mapping[int, str] = MappingProxyType({})
    """Meanings of the numbers of a state or a phase, by number; empty for other columns."""


class Selection(NamedTuple):
    """The part of a recording to export."""

    axes: tuple[str, ...] = ()
    """Names of the axes; all if empty."""
    from_s: float | None = None
    """Begin in seconds from the first recorded period; None for the begin of the recording."""
    to_s: float | None = None
    """End in the same scale, which is not part of the selection; None for the end of the recording."""
    resample_s: float | None = None
    """Interval of the resampled time in seconds; None for the recorded instants."""


def chosen_axes(recording: Recording, selection: Selection) -> tuple[str, ...]:
    """Return the names of the selected axes. Raises RecordingError for a name that is no axis."""
    for name in selection.axes:
        if name not in recording.axes:
            raise RecordingError(
                f"{recording.path}: no axis {name!r}; the recording has {', '.join(recording.axes)}"
                f"{did_you_mean(name, recording.axes)}"
            )
    if not recording.axes:
        raise RecordingError(f"{recording.path}: has no axis, so it has no signals; frames can be exported")
    return selection.axes or tuple(recording.axes)


def columns_of(recording: Recording, selection: Selection) -> tuple[Column, ...]:
    """Return the columns of the exported table: those of all axes, then those of each axis."""
    names = {"state": recording.state_names, "phase": recording.phase_names}
    columns = [Column(*common, names.get(common[0], {})) for common in _COMMON]
    for axis in chosen_axes(recording, selection):
        for signal, unit, kind in _OF_AXIS:
            named = recording.axes[axis] if unit is None else unit
            suffix = f"_{named.lower()}" if named else ""
            columns.append(Column(f"{axis}.{signal}{suffix}", named, kind, names.get(signal, {})))
    return tuple(columns)


def signal_blocks(recording: Recording, selection: Selection) -> Iterator[Block]:
    """Yield the selected rows, one for each period, in ascending time.

    With ``resample_s``, the rows lie on a grid of that interval which begins at the first selected period.
    Each has the values of the last period at or before it, without a filter. Raises RecordingError.
    """
    blocks = _recorded_blocks(recording, selection)
    return blocks if selection.resample_s is None else _resampled(blocks, selection.resample_s)


def _recorded_blocks(recording: Recording, selection: Selection) -> Iterator[Block]:
    names = chosen_axes(recording, selection)
    columns = columns_of(recording, selection)
    for part in parts(recording, selection):
        tables = _same_periods([part.axis(name) for name in names])
        if len(tables[0]):
            yield _block(tables, columns, recording.epoch_offset_ns)


def parts(recording: Recording, selection: Selection) -> Iterator[Recording]:
    """Yield the selected time of the recording in ranges of :data:`PART_S`, to be read one at a time."""
    begin_s = 0.0 if selection.from_s is None else selection.from_s
    end_s = recording.duration_s if selection.to_s is None else min(selection.to_s, recording.duration_s)
    count = max(math.ceil((end_s - begin_s) / PART_S), 1)
    for number in range(count):
        yield recording.between(
            begin_s + number * PART_S if number else selection.from_s,
            begin_s + (number + 1) * PART_S if number < count - 1 else selection.to_s,
        )


def _same_periods(tables: Sequence[AxisTable]) -> list[AxisTable]:
    """Return the rows of those periods that every axis has: dropped messages may belong to one axis alone."""
    first = tables[0]
    if all(np.array_equal(table.time_ns, first.time_ns) for table in tables[1:]):
        return list(tables)
    common = first.time_ns
    for table in tables[1:]:
        common = np.intersect1d(common, table.time_ns)
    return [table[np.isin(table.time_ns, common)] for table in tables]


def _block(tables: Sequence[AxisTable], columns: Sequence[Column], epoch_offset_ns: int) -> Block:
    first = tables[0]
    values: list[npt.NDArray[Any]] = [
        first.time_s,
        first.time_ns + epoch_offset_ns,
        first.state,
        first.fresh,
        first.running,
    ]
    for table in tables:
        values += [table.setpoint, table.position, table.error]
        values += [table.output_v, table.command_v, table.potentiometer_v, table.phase]
    return {column.name: value for column, value in zip(columns, values, strict=True)}


def _resampled(blocks: Iterator[Block], interval_s: float) -> Iterator[Block]:
    """Yield the rows on a grid of ``interval_s``; each holds the values of the last row at or before it."""
    held: Block = {}
    start_s: float | None = None
    next_point = 0
    for block in blocks:
        if held:
            block = {name: np.concatenate((held[name], values)) for name, values in block.items()}
        time_s = block["time_s"]
        if start_s is None:
            start_s = float(time_s[0])
        end_point = int(np.floor((time_s[-1] - start_s) / interval_s + 1e-9)) + 1
        for begin in range(next_point, end_point, BLOCK_ROWS):
            points = np.arange(begin, min(begin + BLOCK_ROWS, end_point))
            grid_s = start_s + points * interval_s
            rows = np.maximum(np.searchsorted(time_s, grid_s + 1e-9 * interval_s, "right") - 1, 0)
            taken = {name: values[rows] for name, values in block.items()}
            taken["epoch_ns"] = taken["epoch_ns"] + np.rint((grid_s - time_s[rows]) * 1e9).astype(np.int64)
            taken["time_s"] = grid_s
            yield taken
        next_point = max(next_point, end_point)
        held = {name: values[-1:] for name, values in block.items()}
