"""Read records of experiments for identification: recordings of the gateway, and tables from anywhere.

==========  ================================================================================================
``.mcap``   A recording of ``hil collect`` or ``hil run``. u is the commanded valve voltage about the valve's
            centre, y the position. Samples outside the excitation, and periods without a good sample, do not
            count. The rig's transport delay (one period for a board that applies at SYNC) is known from the
            rig file in the recording.
``.csv``    Columns time_s,u,y, or those named by ``columns``. A missing row or an empty cell is a gap.
``.mat``    MATLAB variables of the same names (version 7.2 or older), with a time vector or a sample time.
``.parquet`` Columns as in a CSV; needs pyarrow.
==========  ================================================================================================
"""

from __future__ import annotations

import csv
import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from design.identification.checks.expectations import Expectations
from design.identification.checks.unit_checks import check_units
from design.identification.findings import Finding
from design.identification.records.experiment import Experiment, Names
from design.identification.records.time_stamps import from_time_stamps
from design.mathematics.polynomials import Array
from hil.core.errors import DocumentError
from hil.core.phase import Phase
from hil.core.suggestions import did_you_mean
from hil.core.wire.codec import RPDO1_DAC, SYNC
from hil.host.text_file import read_text

if TYPE_CHECKING:
    from hil.core.experiment import Experiment as Collected
    from hil.core.rig import Rig
    from hil.recording.reader import Recording

IntArray = NDArray[np.int64]
COLUMNS = ("time_s", "u", "y")
MAX_LATENESS = 0.1
"""Share of a period by which SYNC may be late. A later sample is off the grid and does not count."""
MAX_CSV_BYTES = 500_000_000
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "vertical bars"}
"""Characters that separate the columns of tables which are no CSV files, and their names."""


@dataclass(frozen=True)
class Record:
    """One record, and what is known about the experiment that gave it."""

    experiment: Experiment
    unit: str
    """Unit of y: m or rad, or empty if the file does not say."""
    axis: str
    """Axis of a recording; empty for a table."""
    findings: tuple[Finding, ...] = ()
    """What was found about the times of the samples."""
    expected: Expectations = field(default_factory=Expectations)
    conditions: Mapping[str, bool | int | float | str] = field(default_factory=dict)
    sha256: str = ""
    """SHA-256 of the file."""


def read_record(
    path: str | os.PathLike[str],
    *,
    axis: str | None = None,
    columns: tuple[str, str, str] = COLUMNS,
    sample_time_s: float | None = None,
    unit: str = "",
    input_held_in_gaps: bool = False,
) -> Record:
    """Read one record. Raises DocumentError naming the file and what is wrong with it.

    ``Record.experiment`` is what :func:`design.identify_experiments` takes, and ``Record.expected`` what it
    takes as ``expected``. ``axis`` chooses an axis of a recording, by default the excited one; the other
    arguments are for tables.

    ``input_held_in_gaps`` states that the actuator kept its last input where a table has no row or no
    input. In a recording, the gateway's own commands show what the valve held.
    """
    path = Path(path)
    match path.suffix.lower():
        case ".mcap":
            return _from_recording(path, axis)
        case ".csv" | ".txt":
            table = _csv(path, columns, sample_time_s)
        case ".mat":
            table = _mat(path, columns, sample_time_s)
        case ".parquet":
            table = _parquet(path, columns, sample_time_s)
        case _:
            raise DocumentError(f"{path}: unknown kind of file; give a .mcap, .csv, .mat or .parquet file")
    time_s, u, y = table
    names = Names(columns[1], columns[2], "V", unit or "m")
    gridded = from_time_stamps(
        time_s,
        u,
        y,
        sample_time_s=sample_time_s,
        name=path.name,
        names=names,
        input_held_in_gaps=input_held_in_gaps,
    )
    expected = Expectations(sample_time_s=sample_time_s)
    findings = (*gridded.findings, *check_units(gridded.experiment))
    return Record(gridded.experiment, unit, "", findings, expected, {}, _digest(path))


# Recordings


def _from_recording(path: Path, axis: str | None) -> Record:
    from hil.core.errors import RecordingError
    from hil.core.experiment import NAME as EXPERIMENT_NAME
    from hil.core.experiment import read_experiment
    from hil.core.rig import read_rig
    from hil.recording import open_recording

    try:
        recording = open_recording(path)
    except RecordingError as error:
        raise DocumentError(str(error)) from None
    texts = {name: data.decode("utf-8", "replace") for name, data in recording.attachments.items()}
    if "rig.toml" not in texts:
        raise DocumentError(f"{path}: the recording has no rig.toml; it cannot be identified from")
    rig = read_rig(texts["rig.toml"], f"{path}: rig.toml")
    collected = read_experiment(texts[EXPERIMENT_NAME], rig) if EXPERIMENT_NAME in texts else None
    name = axis or (collected.axis if collected is not None else "")
    if not name:
        raise DocumentError(f"{path}: which axis? Give --axis, one of {', '.join(rig.axes)}")
    if name not in rig.axes:
        raise DocumentError(
            f"{path}: --axis {name}: the recording has {', '.join(rig.axes)}{did_you_mean(name, rig.axes)}"
        )
    is_excited = collected is not None and collected.axis == name
    experiment = _experiment(recording, rig, name, path.name, is_excited)
    settings = rig.axes[name]
    valve = settings.valve
    expected = Expectations(
        input_range=(valve.min_v - valve.centre_v, valve.max_v - valve.centre_v),
        travel=(settings.min_y, settings.max_y),
        sample_time_s=rig.loop.period_s,
        closed_loop=not (is_excited and collected is not None and collected.mode == "open loop"),
    )
    conditions = _conditions(recording, collected if is_excited else None)
    return Record(experiment, settings.unit, name, (), expected, conditions, _digest(path))


def _experiment(recording: Recording, rig: Rig, axis: str, name: str, is_excited: bool) -> Experiment:
    """Put the samples of an axis on the grid of periods, from the first that counts to the last."""
    table, timing = recording.axis(axis), recording.timing()
    counts = table.phase == Phase.EXCITED if is_excited else table.running
    if not counts.any():
        what = "sample under excitation" if is_excited else "sample under control"
        raise DocumentError(f"{recording.path}: axis {axis} has no {what}")
    first, last = (int(place) for place in np.flatnonzero(counts)[[0, -1]])
    rows = slice(first, last + 1)
    number = timing.number[rows] - timing.number[first]
    period_ns = rig.loop.period_ns
    on_time = timing.wake_ns[rows] - timing.deadline_ns[rows] <= MAX_LATENESS * period_ns
    good = table.fresh[rows] & on_time
    length = int(number[-1]) + 1
    u, y, weights = np.full(length, np.nan), np.full(length, np.nan), np.zeros(length)
    u[number] = (
        _acting_v(recording, timing.wake_ns, table.command_v, rig)[rows] - rig.axes[axis].valve.centre_v
    )
    y[number] = np.where(good, table.position[rows], np.nan)
    weights[number] = counts[rows] & good
    is_whole = recording.messages_dropped == 0
    return Experiment(
        _held(u) if is_whole else u,  # a hole may then be messages that are missing in the file
        y,
        rig.loop.period_s,
        weights=weights,
        name=name,
        names=Names("valve", axis, "V", rig.axes[axis].unit),
        transport_delay_samples=1 if rig.dac.apply == "at sync" else 0,
    )


def _acting_v(recording: Recording, wake_ns: IntArray, command_v: Array, rig: Rig) -> Array:
    """Return the valve voltage of each period as the board has it.

    A command that the bus refused never reached the board. A board that applies at SYNC keeps its voltage in
    a period without SYNC.
    """
    acting = command_v.copy()
    refused = recording.frames("refused", RPDO1_DAC).time_ns
    keeps = np.zeros(len(acting), dtype=bool)
    keeps[np.clip(np.searchsorted(wake_ns, refused, side="right") - 1, 0, len(acting) - 1)] = True
    if rig.dac.apply == "at sync":
        sync = recording.frames("sent", SYNC).time_ns
        has_sync = np.zeros(len(acting), dtype=bool)
        has_sync[np.clip(np.searchsorted(wake_ns, sync, side="right") - 1, 0, len(acting) - 1)] = True
        keeps[:-1] |= ~has_sync[1:]  # the command of a period acts from the next SYNC on
    for place in np.flatnonzero(keeps):
        if place > 0:
            acting[place] = acting[place - 1]
    return acting


def _held(u: Array) -> Array:
    """Return the input with each unknown value replaced by the one before: the valve holds its command."""
    last = np.maximum.accumulate(np.where(np.isfinite(u), np.arange(len(u)), 0))
    return u[last]


def _conditions(recording: Recording, collected: Collected | None) -> dict[str, bool | int | float | str]:
    """Return what the recording says about the conditions of the experiment."""
    found: dict[str, bool | int | float | str] = {"bus": recording.bus}
    if collected is not None:
        found |= {
            "mode": collected.mode,
            "excitation": str(collected.signal.__struct_config__.tag),
            "amplitude": getattr(collected.signal, "amplitude", float("nan")),
            "centre": collected.centre,
        }
        ending = recording.metadata.get("ending", {})
        for key, name in (("valve offset, V", "valve_offset_v"), ("fence crossings", "fence_crossings")):
            if key in ending:
                found[name] = float(ending[key])
    events = recording.metadata.get("plant", {}).get("events", "")
    if events:
        found["events"] = events
    return {key: value for key, value in found.items() if value == value}  # a NaN is left out


# Tables

Columns = tuple[Array, Array, Array]


class Rows(Protocol):
    """The rows of a CSV file, with the line that was read last."""

    line_num: int

    def __iter__(self) -> Iterator[list[str]]: ...
    def __next__(self) -> list[str]: ...


def _csv(path: Path, columns: tuple[str, str, str], sample_time_s: float | None) -> Columns:
    rows = csv.reader(read_text(path, MAX_CSV_BYTES).splitlines())
    try:
        return _csv_columns(path, rows, columns, sample_time_s)
    except csv.Error as error:
        raise DocumentError(f"{path}: line {rows.line_num}: not a CSV file: {error}") from None


def _csv_columns(
    path: Path, rows: Rows, columns: tuple[str, str, str], sample_time_s: float | None
) -> Columns:
    header = next((row for row in rows if row and not row[0].lstrip().startswith("#")), None)
    if header is None:
        raise DocumentError(f"{path}: the file is empty")
    names = [cell.strip() for cell in header]
    _check_separator(path, names)
    places = _places(path, names, columns, sample_time_s)
    values: list[list[float]] = [[] for _ in places]
    for row in rows:
        if not row or row[0].lstrip().startswith("#"):
            continue
        for column, place in zip(values, places, strict=True):
            cell = row[place].strip() if place < len(row) else ""
            try:
                column.append(float(cell) if cell else np.nan)
            except ValueError:
                raise DocumentError(
                    f"{path}: line {rows.line_num}: {names[place]} is {cell!r}, not a number"
                ) from None
    return _with_time(path, [np.array(column) for column in values], sample_time_s)


def _check_separator(path: Path, names: list[str]) -> None:
    """Refuse a header that other characters than commas separate. Raises DocumentError."""
    for separator, name in SEPARATORS.items():
        if len(names) == 1 and separator in names[0]:
            raise DocumentError(
                f"{path}: the columns are separated by {name}, not by commas: {names[0]!r}. Write the file "
                "with commas between the columns and points in the numbers"
            )


def _mat(path: Path, columns: tuple[str, str, str], sample_time_s: float | None) -> Columns:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        variables = loadmat(path, squeeze_me=True)
    except NotImplementedError:  # what scipy raises for the HDF5 files of MATLAB 7.3
        raise DocumentError(f"{path}: a file of MATLAB version 7.3; save it with -v7") from None
    except (OSError, ValueError, TypeError, LookupError, MatReadError) as error:
        raise DocumentError(f"{path}: not a MATLAB file: {error}") from None
    names = [name for name in variables if not name.startswith("__")]
    places = _places(path, names, columns, sample_time_s)
    return _with_time(
        path, [_numbers(path, names[place], variables[names[place]]) for place in places], sample_time_s
    )


def _parquet(path: Path, columns: tuple[str, str, str], sample_time_s: float | None) -> Columns:
    try:
        from pyarrow import ArrowException, parquet
    except ImportError:
        raise DocumentError(
            f"{path}: reading Parquet needs pyarrow; pip install 'pneumatic-hil[parquet]'"
        ) from None
    try:
        table = parquet.read_table(path)
    except (OSError, ArrowException) as error:
        raise DocumentError(f"{path}: not a Parquet file: {error}") from None
    names = list(table.column_names)
    places = _places(path, names, columns, sample_time_s)
    return _with_time(
        path,
        [
            _numbers(path, names[place], table.column(place).to_numpy(zero_copy_only=False))
            for place in places
        ],
        sample_time_s,
    )


def _numbers(path: Path, name: str, values: object) -> Array:
    try:
        column = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise DocumentError(f"{path}: {name} is not a column of numbers") from None
    if column.ndim != 1:
        raise DocumentError(f"{path}: {name} has the shape {column.shape}; one column of numbers is needed")
    return column


def _places(
    path: Path, names: list[str], columns: tuple[str, str, str], sample_time_s: float | None
) -> list[int]:
    """Return the places of the columns. Without a time column, a sample time must be given."""
    needed = columns if columns[0] in names or sample_time_s is None else columns[1:]
    missing = [name for name in needed if name not in names]
    if missing:
        nearest = did_you_mean(missing[0], names)
        raise DocumentError(
            f"{path}: no column {', '.join(missing)}; it has {', '.join(names)}{nearest}. Name the columns "
            "with --columns TIME,U,Y"
            + ("" if columns[0] not in missing else ", or give --sample-time for a file without times")
        )
    return [names.index(name) for name in needed]


def _with_time(path: Path, values: list[Array], sample_time_s: float | None) -> Columns:
    if len({len(column) for column in values}) > 1:
        raise DocumentError(
            f"{path}: the columns have different lengths: {', '.join(str(len(c)) for c in values)}"
        )
    if len(values) == 2:
        assert sample_time_s is not None
        values = [np.arange(len(values[0]), dtype=np.float64) * np.float64(sample_time_s), *values]
    time_s, u, y = values
    return time_s, u, y


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
