"""The rig file with which one axis is calibrated by jogs: its limits are wide, and nothing starts.

Before its calibration, the positions of an axis are wrong, and the fence and the soft end stops would end
each jog somewhere. In the calibration rig, they stand where the potentiometer's voltages end. A jog has a low
voltage and a short time, so that the axis moves slowly into its mechanical end and stops soon after the last
request. A voltage that a broken wire has is still a fault.

The text is derived from the user's rig file, is never written to it, and is recorded with the run.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping

from hil.core.calibration import SMALLEST_MIN_V
from hil.core.errors import DocumentError
from hil.core.output import LogEntry, Severity
from hil.core.rig import AxisSettings, Rig, read_rig
from hil.core.rig_edit import with_values
from hil.core.suggestions import did_you_mean

MAX_JOG_V = 0.5
"""Largest offset of the valve from its centre in V. Eq. (15) of the paper then moves at 0.13 m/s."""
MAX_JOG_S = 0.3
"""Longest time of one jog request in s. The axis stops within it when the requests stop."""
MAX_V = 9.9996
"""Largest voltage of the potentiometer that counts as a position."""
MARGIN_V = 0.001
"""Distance of the ends of the range from the smallest and the largest voltage, for rounding."""
HEADING = "# for this calibration only: "


def calibration_text(text: str, axis: str, source: str) -> str:
    """Return the calibration rig of ``axis`` as a text. ``source`` names the rig file in errors.

    Raises DocumentError, such as for a rig file whose tables cannot be edited.
    """
    rig = read_rig(text, source)
    if axis not in rig.axes:
        raise DocumentError(
            f"--calibrate {axis}: the axes of the rig are {', '.join(rig.axes)}{did_you_mean(axis, rig.axes)}"
        )
    table = ("axes", axis)
    edited = text
    for inner, values in _changes(rig.axes[axis]).items():
        path = (*table, *filter(None, [inner]))
        if inner and inner not in tomllib.loads(edited)["axes"][axis]:
            edited = f"{edited.rstrip()}\n\n[{'.'.join(path)}]\n"
        edited = with_values(edited, path, values, "wide limits and slow jogs", source, HEADING)
    edited = f'calibration = "{axis}"\n{edited}'
    read_rig(edited, f"{source} with wide limits for {axis}")
    return edited


def calibration_warnings(rig: Rig) -> list[LogEntry]:
    """Return the warning of a calibration rig; nothing for any other rig."""
    if rig.calibration is None:
        return []
    limits = rig.axes[rig.calibration].operator_limits
    text = (
        "calibration: the fence and the soft end stops of this axis are as wide as its potentiometer; jogs "
        f"have at most {limits.jog_max_v:g} V, and controllers do not start"
    )
    return [LogEntry(Severity.WARNING, rig.calibration, text)]


def _changes(axis: AxisSettings) -> Mapping[str, Mapping[str, float]]:
    """Return the values that change, by table inside that of the axis; its own table has an empty name."""
    pot, limits, envelope = axis.potentiometer, axis.operator_limits, axis.envelope
    low, high = sorted((pot.position(SMALLEST_MIN_V + MARGIN_V), pot.position(MAX_V - MARGIN_V)))
    ends = {"min_y": low, "max_y": high}
    # An end stop that is not given follows the potentiometer, and one that is disabled must not be given.
    given = {key: ends[key] for key in ends if getattr(envelope, key) is not None}
    changes = {
        "potentiometer": {"min_v": SMALLEST_MIN_V, "max_v": MAX_V},
        "": ends | {"fence_min_y": low, "fence_max_y": high},
        "envelope": given,
        "operator": {
            "jog_max_v": min(limits.jog_max_v, MAX_JOG_V),
            "jog_max_s": min(limits.jog_max_s, MAX_JOG_S),
        },
    }
    return {table: values for table, values in changes.items() if values}
