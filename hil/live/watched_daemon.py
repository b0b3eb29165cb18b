"""Shows a daemon that was started without a page: its status, twenty times a second.

A status has the signals of one period, and the largest lateness since the status before. The page of
``hil daemon --live`` has every period.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from hil.core.errors import OperationError
from hil.core.life_cycle import LifeCycleState
from hil.live.run import Run
from hil.operation.client import connect
from hil.operation.protocol import Status

INTERVAL_S = 0.05
STATES = [state.name.lower() for state in LifeCycleState]


def watch(path: Path, run: Run, in_loop: Callable[[Callable[[], None]], None]) -> None:
    """Give ``run`` every status of a daemon until the daemon ends. Call this in a thread of its own.

    ``in_loop`` lets the serving thread call a function.
    """
    try:
        with connect(path) as daemon:
            for status in daemon.watch(INTERVAL_S):
                in_loop(lambda status=status: take_status(run, status))  # type: ignore[misc]
    except OperationError as error:
        text = str(error)
        in_loop(lambda: run.log_entry(0.0, 40, "page", text))
    in_loop(run.end)


def take_status(run: Run, status: Status) -> None:
    """Add a status of the daemon to what the page knows."""
    if run.history is None:
        run.begin(
            {
                "axes": [[axis.name, axis.unit] for axis in status.axes],
                "period_s": INTERVAL_S,
                "states": STATES,
                "rig": "",
                "bus": status.bus,
                "controllers": {},
                "recording": status.recording or "",
                "start_ns": status.time_ns,
                "epoch_offset_ns": 0,
            }
        )
    assert run.history is not None and run.information is not None
    start_ns = run.information["start_ns"]
    row = [
        (status.time_ns - start_ns) * 1e-9,
        status.max_lateness_ms,
        math.nan,
        STATES.index(status.state),
        1.0,
    ]
    for axis in status.axes:
        signals = (axis.setpoint, axis.position, axis.command_v)
        row += [math.nan if value is None else value for value in signals]
    run.history.add_row(row)
    for entry in status.log:
        run.log_entry((entry.time_ns - start_ns) * 1e-9, entry.severity, entry.source, entry.text)
    run.status = {
        "counts": {
            "missed periods": status.missed_periods,
            "rejected frames": status.rejected_frames,
            "lost samples": status.lost_samples,
        },
        "fault": status.fault,
        "readiness": status.readiness,
    }
