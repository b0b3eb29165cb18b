"""The stays of a run in the states of the life cycle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.views.run_columns import TimingColumns


class Stay(NamedTuple):
    """A stay in one state of the life cycle, in seconds on the time axis of a plot."""

    state: str
    from_s: float
    to_s: float


def stays_in(timing: TimingColumns, names: dict[int, str], start_s: float) -> list[Stay]:
    """Return the stays of a run that has periods; ``start_s`` is time 0 of the plot."""
    states, times_s = timing.state, timing.time_s
    entered = [0, *(np.flatnonzero(np.diff(states)) + 1)]
    left = [*entered[1:], len(states) - 1]
    return [
        Stay(
            names.get(int(states[i]), f"state {states[i]}"),
            float(times_s[i]) - start_s,
            float(times_s[j]) - start_s,
        )
        for i, j in zip(entered, left, strict=True)
    ]
