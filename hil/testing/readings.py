"""The signals of an axis under control, from whatever a test has: a rig, a recording, a file or a table."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from hil.lockstep_rig import LockstepRig
from hil.recording import open_recording
from hil.recording.reader import Recording
from hil.recording.tables import AxisTable

if TYPE_CHECKING:
    from hil.core.rig import Rig

Run: TypeAlias = "LockstepRig | Recording | AxisTable | str | os.PathLike[str]"
"""A run in any form that an assertion accepts."""


def axis_table(run: Run, axis: str | None) -> AxisTable:
    """Return the signals of an axis; ``axis`` may be None if the run is a table, or has one axis.

    Raises AssertionError if the controllers never acted, because nothing can be asserted then.
    """
    __tracebackhide__ = True
    table = _table(run, axis)
    assert bool(np.any(table.running)), (
        f"{table.name}: the controllers never acted in this run, so there is no response to judge; bring the "
        "rig to state running first"
    )
    return table


def rig_of(run: Run) -> Rig | None:
    """Return the rig file of a run; None for a table, which has none."""
    if isinstance(run, LockstepRig):
        return run.rig
    if isinstance(run, AxisTable):
        return None
    from hil.core.rig import read_rig

    recording = run if isinstance(run, Recording) else open_recording(run)
    return read_rig(recording.documents["rig.toml"], f"{recording.path}: rig.toml")


def control_time_s(table: AxisTable) -> np.ndarray:
    """Return ``time_s`` counted from the first period under control, as the times of setpoints count."""
    return np.asarray(table.time_s - table.time_s[int(np.argmax(table.running))])


def _table(run: Run, axis: str | None) -> AxisTable:
    if isinstance(run, AxisTable):
        return run
    if not isinstance(run, LockstepRig | Recording):
        run = open_recording(run)
    names = list(run.rig.axes) if isinstance(run, LockstepRig) else list(run.axes)
    if axis is None:
        assert len(names) == 1, f"name the axis to judge: {', '.join(names)}"
        axis = names[0]
    return run.axis(axis)
