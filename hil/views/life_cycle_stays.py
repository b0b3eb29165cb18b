"""The stays of a run in the states of the life cycle."""

from __future__ import annotations

from typing import NamedTuple


class Stay(NamedTuple):
    """A stay in one state of the life cycle, in seconds on the time axis of a plot."""

    state: str
    from_s: float
    to_s: float
