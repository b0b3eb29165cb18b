"""Write tables of signals as CSV, Parquet, MAT (version 5) and MF4 (ASAM MDF 4.10)."""

from __future__ import annotations

import datetime
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.conversion.optional import optional_module
from hil.conversion.signals import Block, Column

_CSV_ROWS = 4096
"""Number of rows that are converted to text at a time."""


def write_csv(path: Path, columns: Sequence[Column], blocks: Iterable[Block]) -> int:
    """Write a CSV with a header line, and return the number of rows.

    Numbers have the shortest form that gives the same float64 again, flags are 0 or 1, and missing values are
    ``nan``. Memory is bounded by one block.
    """
    rows = 0
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(column.name for column in columns) + "\n")
        for block in blocks:
            length = len(block["time_s"])
            for start in range(0, length, _CSV_ROWS):
                texts = [_texts(block[column.name][start : start + _CSV_ROWS]) for column in columns]
                file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))
            rows += length
    return rows


def write_parquet(path: Path, columns: Sequence[Column], blocks: Iterable[Block]) -> int:
    """Write a Parquet file with one row group for each block, and return the number of rows.

    The metadata of each field has its ``unit``, and for states and phases the ``names`` of the numbers as a
    JSON object, such as ``{"0": "offline"}``. Memory is bounded by one block. Raises EnvironmentLackError
    without pyarrow.
    """
    arrow = optional_module("pyarrow", "parquet", "writing Parquet")
    parquet = optional_module("pyarrow.parquet", "parquet", "writing Parquet")
    fields = [
        arrow.field(
            column.name,
            arrow.from_numpy_dtype(np.dtype(column.type)),
            metadata=_field_metadata(column) or None,
        )
        for column in columns
    ]
    schema = arrow.schema(fields)
    # Dictionaries and statistics cost more than they save for measured values, which hardly repeat.
    settings = {"compression": "zstd", "use_dictionary": False, "write_statistics": ["time_s", "epoch_ns"]}
    rows = 0
    with parquet.ParquetWriter(path, schema, **settings) as writer:
        for block in blocks:
            table = arrow.Table.from_arrays([arrow.array(block[c.name]) for c in columns], schema=schema)
            writer.write_table(table, row_group_size=max(len(table), 1))
            rows += len(table)
    return rows


def _field_metadata(column: Column) -> dict[str, str]:
    """Return the metadata of a Parquet field."""
    unit = {"unit": column.unit} if column.unit else {}
    return unit | ({"names": json.dumps(dict(column.names))} if column.names else {})


def write_mat(path: Path, columns: Sequence[Column], blocks: Iterable[Block]) -> int:
    """Write a MAT file, and return the number of rows.

    The columns that all axes share are column vectors; each axis is a struct of column vectors, and ``units``
    is a struct with the same fields. The struct ``names`` has the numbers of states and phases by name, such
    as ``names.state.running``. The whole table is in memory.
    """
    from scipy.io import savemat

    table = _whole(columns, blocks)
    content: dict[str, Any] = {"units": {}, "names": {}}
    for column in columns:
        axis, _, signal = column.name.rpartition(".")
        values = table[column.name].reshape(-1, 1)
        if column.names:
            content["names"][signal] = {name: value for value, name in column.names.items()}
        if axis:
            content.setdefault(axis, {})[signal] = values
            content["units"].setdefault(axis, {})[signal] = column.unit
        else:
            content[signal] = values
            content["units"][signal] = column.unit
    savemat(path, content, do_compression=True, long_field_names=True, oned_as="column")
    return len(table["time_s"])


def write_mf4(path: Path, columns: Sequence[Column], blocks: Iterable[Block]) -> int:
    """Write an MF4 file with one channel for each column, and return the number of rows.

    The comment of a channel has the names of states and phases. The time of the file's header is that of the
    first row. The whole table is in memory. Raises
    EnvironmentLackError without asammdf.
    """
    asammdf = optional_module("asammdf", "mf4", "writing MF4")
    table = _whole(columns, blocks)
    time_s = table["time_s"]
    start_s = float(time_s[0]) if len(time_s) else 0.0
    channels = [
        asammdf.Signal(table[c.name], time_s - start_s, unit=c.unit, name=c.name, comment=_legend(c))
        for c in columns
        if c.name != "time_s"
    ]
    with asammdf.MDF(version="4.10") as file:
        if len(time_s):
            file.header.start_time = utc(int(table["epoch_ns"][0]))
        file.append(channels, comment="pneumatic-hil")
        save_mf4(file, path)
    return len(time_s)


def _legend(column: Column) -> str:
    """Return the names of a column's numbers in words, such as ``0 offline, 1 ready``."""
    return ", ".join(f"{value} {name}" for value, name in column.names.items())


def save_mf4(file: Any, path: Path) -> None:
    """Save an asammdf file as ``path``, also if its name lacks .mf4, which asammdf would add."""
    named = path if path.suffix == ".mf4" else path.with_name(f"{path.name}.mf4")
    try:
        file.save(named, overwrite=True, compression=1)
        named.replace(path)
    except BaseException:
        named.unlink(missing_ok=True)
        raise


def utc(epoch_ns: int) -> datetime.datetime:
    """Return an instant as a date with the time zone UTC, to the microsecond."""
    seconds, nanoseconds = divmod(epoch_ns, 1_000_000_000)
    moment = datetime.datetime.fromtimestamp(seconds, datetime.UTC)
    return moment.replace(microsecond=nanoseconds // 1000)


def _texts(values: Any) -> list[str]:
    if values.dtype == np.bool_:
        values = values.astype(np.uint8)
    return list(map(repr, values.tolist()))


def _whole(columns: Sequence[Column], blocks: Iterable[Block]) -> Block:
    parts: dict[str, list[Any]] = {column.name: [np.empty(0, column.type)] for column in columns}
    for block in blocks:
        for name, values in block.items():
            parts[name].append(values)
    return {name: np.concatenate(values) for name, values in parts.items()}
