"""The signals of a rig in simulated time as a table, as a recording has them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.core.errors import HilError
from hil.core.life_cycle import LifeCycleState
from hil.core.output import AxisSignals, Cycle
from hil.core.rig import Rig
from hil.core.suggestions import did_you_mean
from hil.recording.tables import AxisTable


def axis_table(rig: Rig, cycles: Sequence[Cycle], name: str) -> AxisTable:
    """Return the signals of an axis, one row for each of ``cycles``. Raises HilError without that axis."""
    if name not in rig.axes:
        raise HilError(
            f"no axis {name!r}; the rig has {', '.join(rig.axes)}{did_you_mean(str(name), rig.axes)}"
        )
    place = list(rig.axes).index(name)
    time_ns = np.array([cycle.wake_ns for cycle in cycles], np.int64)
    values = np.array([cycle.axes[place] for cycle in cycles], float).reshape(-1, len(AxisSignals._fields))
    columns = dict(zip(AxisSignals._fields, values.T, strict=True))
    state = np.array([cycle.state for cycle in cycles], np.uint8)
    return AxisTable(
        time_s=(time_ns - time_ns[:1].sum()) * 1e-9,
        time_ns=time_ns,
        setpoint=columns["setpoint"],
        position=columns["position"],
        error=columns["error"],
        output_v=columns["output_v"],
        command_v=columns["command_v"],
        potentiometer_v=columns["potentiometer_v"],
        phase=columns["phase"].astype(np.uint8),
        state=state,
        fresh=np.array([cycle.fresh for cycle in cycles], np.bool_),
        running=state == LifeCycleState.RUNNING,
        name=name,
        unit=rig.axes[name].unit,
    )
