"""Measures the speed of an axis that a running daemon jogs, for ``hil calibrate --valve``."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from hil.core.calibration import CalibrationError
from hil.operation.client import Client

JOG_S = 0.3
"""Time of one jog, in seconds. If this command ends, the axis stops within it."""
SETTLING_S = 0.1
"""Time after the begin of a jog from which on its speed is measured, in seconds."""
REST_S = 0.3
"""Time between two jogs, in seconds."""
WATCH_S = 0.05
"""Time between two positions, in seconds."""


class JoggedAxis:
    """Moves an axis by jogs of a running daemon, and measures its speed."""

    def __init__(self, client: Client, axis: str) -> None:
        self._client = client
        self._axis = axis
        self.recording: str | None = None
        """Recording of the daemon during the last jog."""

    def speed(self, offset_v: float) -> float:
        """Jog once and return the speed in the axis' unit per s, then let the axis come to rest."""
        points: list[tuple[float, float]] = []
        began_ns: int | None = None
        self._client.jog(self._axis, offset_v, JOG_S)
        for time_ns, position in self._positions():
            began_ns = time_ns if began_ns is None else began_ns
            elapsed_s = (time_ns - began_ns) * 1e-9
            if SETTLING_S <= elapsed_s <= JOG_S:
                points.append((elapsed_s, position))
            if elapsed_s > JOG_S + REST_S:
                break
        if len(points) < 2:
            raise CalibrationError(
                f"{self._axis}: the daemon gave no positions during the jog; is it in a fault?"
            )
        (first_s, first), (last_s, last) = points[0], points[-1]
        return (last - first) / (last_s - first_s)

    def _positions(self) -> Iterator[tuple[int, float]]:
        with contextlib.closing(self._client.watch(WATCH_S)) as updates:  # type: ignore[type-var]
            for status in updates:
                self.recording = status.recording
                if status.state == "fault":
                    raise CalibrationError(f"{self._axis}: the daemon is in a fault: {status.fault}")
                for axis in status.axes:
                    if axis.name == self._axis and axis.position is not None:
                        yield status.time_ns, axis.position
