"""Tables of a recording as data frames of other libraries, which are imported when they are used."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hil.core.errors import EnvironmentLackError

if TYPE_CHECKING:
    from hil.recording.tables import Table


def to_pandas(table: Table) -> Any:
    """Return a ``pandas.DataFrame`` with one row for each row of the table."""
    frame = _library("pandas", "to_pandas").DataFrame(flat_columns(table))
    frame.attrs.update(_attributes(table))
    return frame


def to_polars(table: Table) -> Any:
    """Return a ``polars.DataFrame`` with one row for each row of the table."""
    return _library("polars", "to_polars").DataFrame(flat_columns(table))


def to_xarray(table: Table) -> Any:
    """Return an ``xarray.Dataset`` along the coordinate ``time_s``."""
    columns = flat_columns(table)
    time_s = columns.pop("time_s")
    variables = {name: ("time_s", values) for name, values in columns.items()}
    return _library("xarray", "to_xarray").Dataset(
        variables, coords={"time_s": time_s}, attrs=_attributes(table)
    )


def flat_columns(table: Table) -> dict[str, npt.NDArray[Any]]:
    """Return the columns by name. A column of shape (n, k) becomes k columns: data_0, data_1…"""
    columns: dict[str, npt.NDArray[Any]] = {}
    for name in table.columns:
        values = table[name]
        if values.ndim == 1:
            columns[name] = values
        else:
            for place in range(values.shape[1]):
                columns[f"{name}_{place}"] = np.ascontiguousarray(values[:, place])
    return columns


def _attributes(table: Table) -> dict[str, str]:
    """Return name and unit of the axis, if the table is one of signals."""
    return {key: getattr(table, key) for key in ("name", "unit") if hasattr(table, key)}


def _library(name: str, method: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        raise EnvironmentLackError(
            f"{method} needs the package {name}, which is not installed: pip install {name}"
        ) from None
