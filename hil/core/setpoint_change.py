"""Read and check a setpoint for an axis of a gateway that runs.

Reading a table takes up to some milliseconds. Therefore :func:`prepare_setpoint` may run in another process.
It returns plain values, which the gateway uses only if their digest says that they belong to the texts of the
request. The texts alone are recorded: a replay reads the table again.
"""

from __future__ import annotations

import hashlib
from typing import NamedTuple

from hil.core.errors import SetpointError
from hil.core.requests import SetpointRequest
from hil.core.rig import AxisSettings, Rig
from hil.core.setpoints import (
    Setpoint,
    Table,
    check_speed,
    check_within,
    csv_file,
    is_position,
    parse_setpoint,
    table_setpoint,
)

MAX_TEXT = 1000
"""Longest text of a setpoint in a request, in characters."""
MAX_TABLE_CHARACTERS = 64 * 1024
"""Largest table of a request, in characters: about 4,000 rows."""


class PreparedSetpoint(NamedTuple):
    """A table of setpoints that was read and checked, or the reason why it is refused."""

    digest: str
    """SHA-256 of what the request asks for."""
    refusal: str
    """Reason why the table is refused; empty if it is not."""
    times: tuple[float, ...]
    """Times of the rows in s."""
    values: tuple[float, ...]
    """Setpoints of the rows in the axis' unit."""


def prepare_setpoint(request: SetpointRequest, rig: Rig) -> PreparedSetpoint | None:
    """Read and check the table of a request for an axis that ``rig`` has; None if it names no table."""
    if csv_file(request.setpoint) is None:
        return None
    try:
        setpoint = _read(request, rig.axes[request.axis])
    except SetpointError as error:
        return PreparedSetpoint(_digest(request), str(error), (), ())
    assert isinstance(setpoint.at, Table)
    return PreparedSetpoint(_digest(request), "", setpoint.at.times, setpoint.at.values)


def read_request(request: SetpointRequest, rig: Rig, prepared: PreparedSetpoint | None) -> Setpoint:
    """Return the setpoint of a request for an axis that ``rig`` has. Raises SetpointError.

    ``prepared`` is used if it belongs to this request.
    """
    if prepared is None or csv_file(request.setpoint) is None or prepared.digest != _digest(request):
        return _read(request, rig.axes[request.axis])
    if prepared.refusal:
        raise SetpointError(prepared.refusal)
    setpoint = table_setpoint(request.setpoint, prepared.times, prepared.values)
    _check(setpoint, request.axis, rig.axes[request.axis])
    return setpoint


def _digest(request: SetpointRequest) -> str:
    return hashlib.sha256("\0".join(request).encode("utf-8", "replace")).hexdigest()


def _read(request: SetpointRequest, axis: AxisSettings) -> Setpoint:
    """Read a setpoint and check it against the limits of its axis. Raises SetpointError."""
    name, text, table = request
    if len(text) > MAX_TEXT:
        raise SetpointError(f"{name}: the text has {len(text)} characters, limit {MAX_TEXT}")
    if len(table) > MAX_TABLE_CHARACTERS:
        raise SetpointError(
            f"{name}: {text!r}: the table has {len(table)} characters, limit {MAX_TABLE_CHARACTERS}; leave "
            "out rows, because straight lines connect them"
        )
    if csv_file(text) is not None and not table:
        raise SetpointError(
            f"{name}: {text!r}: the request has no table, and the daemon reads no files; send the text of "
            "the file with the request, as `hil setpoint` does"
        )
    # The log of a recording names the form, also of a position alone.
    full = f"step:{text}@0" if is_position(text) else text
    try:
        setpoint = parse_setpoint(full, table)
    except SetpointError as error:
        if table:
            raise
        raise SetpointError(f"{name}: {error}") from None
    _check(setpoint, name, axis)
    return setpoint


def _check(setpoint: Setpoint, name: str, axis: AxisSettings) -> None:
    check_within(setpoint, name, axis.min_y, axis.max_y, axis.unit)
    key = f"axes.{name}.operator.setpoint_max_speed"
    check_speed(setpoint, name, axis.operator_limits.max_speed, axis.unit, key)
