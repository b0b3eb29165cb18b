"""Tables of a recording: named columns of equal length, as numpy arrays.

A column is an attribute and a key: ``table.position`` and ``table["position"]`` are the same array. A slice,
a boolean array or an array of row numbers selects rows and gives a table of the same kind. A row number gives
one row: its values by column name. ``numpy.asarray(table)`` is a structured array.

``time_s`` is in seconds from the first recorded period in every table. All ``_ns`` are on the gateway's
monotonic clock, unless stated otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Self, TypeAlias, overload

import numpy as np
import numpy.typing as npt

from hil.recording import data_frames

IntArray: TypeAlias = npt.NDArray[np.int64]
FloatArray: TypeAlias = npt.NDArray[np.float64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
ByteArray: TypeAlias = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False, repr=False)
class Table:
    """Base of the tables: columns of equal length, one row for each message."""

    time_s: FloatArray
    """Time in seconds from the first recorded period."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        names = (field.name for field in fields(self))
        return tuple(name for name in names if isinstance(getattr(self, name), np.ndarray))

    @overload
    def __getitem__(self, key: str) -> npt.NDArray[Any]: ...
    @overload
    def __getitem__(self, key: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, key: slice | npt.NDArray[Any]) -> Self: ...

    def __getitem__(
        self, key: str | int | slice | npt.NDArray[Any]
    ) -> npt.NDArray[Any] | dict[str, Any] | Self:
        """Return a column by its name, a row by its number, or a table of selected rows. Raises KeyError."""
        if isinstance(key, int):
            return {name: getattr(self, name)[key] for name in self.columns}
        if not isinstance(key, str):
            return replace(self, **{name: getattr(self, name)[key] for name in self.columns})
        if key not in self.columns:
            raise KeyError(f"no column {key!r}; the columns are {', '.join(self.columns)}")
        column: npt.NDArray[Any] = getattr(self, key)
        return column

    def __len__(self) -> int:
        return len(self.time_s)

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        columns = [(name, self[name]) for name in self.columns]
        kinds = [(name, column.dtype, column.shape[1:]) for name, column in columns]
        rows = np.empty(len(self), kinds)
        for name, column in columns:
            rows[name] = column
        return rows if dtype is None else rows.astype(dtype)

    def to_pandas(self) -> Any:
        """Return the table as a ``pandas.DataFrame``. Raises EnvironmentLackError without pandas.

        The data bytes of frames become the columns ``data_0`` to ``data_7``.
        """
        return data_frames.to_pandas(self)

    def to_polars(self) -> Any:
        """Return the table as a ``polars.DataFrame``, as :meth:`to_pandas` does."""
        return data_frames.to_polars(self)

    def to_xarray(self) -> Any:
        """Return the table as an ``xarray.Dataset`` along ``time_s``, as :meth:`to_pandas` does."""
        return data_frames.to_xarray(self)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {len(self)} rows of {', '.join(self.columns)}>"


@dataclass(frozen=True, eq=False, repr=False)
class AxisTable(Table):
    """The signals of one axis, one row for each period of the loop.

    In a period without a good sample (``fresh`` is False), the signals are those of the last good sample.
    They are NaN before the first one.
    """

    time_ns: IntArray
    """Sampling instant, when the gateway sent SYNC."""
    setpoint: FloatArray
    """Setpoint r in the axis' unit. While the controller does not act, it equals the position."""
    position: FloatArray
    """Measured position y in the axis' unit."""
    error: FloatArray
    """Control error r - y in the axis' unit."""
    output_v: FloatArray
    """Output u of the control law before the limits, in V relative to the valve's centre voltage."""
    command_v: FloatArray
    """Valve voltage after the limits, in V, before quantisation."""
    potentiometer_v: FloatArray
    """Measured potentiometer voltage in V."""
    phase: ByteArray
    """Phase of the experiment on this axis, ``hil.core.phase.Phase``; 0 if the axis is not excited."""
    state: ByteArray
    """State of the life cycle after the period; ``Recording.state_names`` has its name."""
    fresh: BoolArray
    """True where the period had a good sample."""
    running: BoolArray
    """True where the controller acted. Setpoint times count from the first such period."""
    name: str
    """Name of the axis."""
    unit: str
    """Unit of setpoint, position and error: m or rad."""


@dataclass(frozen=True, eq=False, repr=False)
class TimingTable(Table):
    """The timing of the loop, one row for each period. ``time_s`` is that of ``wake_ns``."""

    number: IntArray
    """Number of the period. It skips the periods whose deadlines were missed."""
    deadline_ns: IntArray
    """Instant at which SYNC was due."""
    wake_ns: IntArray
    """Instant at which the core was called; SYNC left right after."""
    receive_ns: IntArray
    """Instant at which the core was given the good sample; 0 where the period had none."""
    computed_ns: IntArray
    """Instant at which the core had answered to the sample, or to the next deadline where none came."""
    sent_ns: IntArray
    """Instant at which the link had taken the last frame of that answer."""
    state: ByteArray
    """State of the life cycle after the period; ``Recording.state_names`` has its name."""
    fresh: BoolArray
    """True where the period had a good sample."""
    running: BoolArray
    """True where the controllers acted."""


@dataclass(frozen=True, eq=False, repr=False)
class FrameTable(Table):
    """CAN frames in one direction, one row for each frame."""

    time_ns: IntArray
    """Instant at which the core was given the frame, or at which the link took or refused it."""
    stamp_ns: IntArray
    """The link's receive stamp in epoch ns (``Recording.metadata["recording"]["stamp_origin"]``).

    For frames of the gateway it is ``time_ns`` as epoch time.
    """
    id: npt.NDArray[np.uint32]
    """Identifier of 11 or 29 bits; the error class for error frames."""
    is_extended: BoolArray
    """True for an identifier of 29 bits."""
    is_remote: BoolArray
    """True for a remote frame."""
    is_error: BoolArray
    """True for an error frame of the bus."""
    length: ByteArray
    """Number of data bytes, 0 to 8."""
    data: ByteArray
    """Data bytes, shape (frames, 8); zero after ``length``."""
