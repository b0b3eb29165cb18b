"""The condition that a fault waits for."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from hil.core.errors import DocumentError
from hil.core.suggestions import did_you_mean

RUNNING: Final = "running"
STATES: Final = ("offline", "ready", "armed", "fault")
"""States of the gateway's life cycle that no frame on the bus shows. The rig must be told of them."""
NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
POSITION: Final = rf"[A-Za-z]\w*[<>]{NUMBER}"
_POSITION: Final = re.compile(rf"(?P<axis>[A-Za-z]\w*)(?P<sign>[<>])(?P<limit>{NUMBER})")


class Observation(NamedTuple):
    """What a rig has seen so far, from which conditions are judged."""

    has_sampled: bool
    """True from the boards' first sample on."""
    is_running: bool
    """True from the first valve command on that is not the centre."""
    positions: Mapping[str, float]
    """Position of each axis in the last sample, in the axis' unit; empty before the first one."""
    state: str = ""
    """State that the gateway has entered last; empty if the rig has not been told."""


class Condition(NamedTuple):
    """A parsed condition: the first sample, a state of the gateway, or a position."""

    kind: str
    axis: str = ""
    limit: float = 0.0

    def is_met(self, seen: Observation) -> bool:
        """Return whether the condition is met by what has been observed last."""
        if self.kind == "":
            return seen.has_sampled
        if self.kind == RUNNING:
            return seen.is_running
        if self.kind in STATES:
            return seen.state == self.kind
        position = seen.positions.get(self.axis)
        if position is None:
            return False
        return position > self.limit if self.kind == ">" else position < self.limit


def parse_condition(text: str, axes: Sequence[str], source: str) -> Condition:
    """Read a condition such as ``vertical>0.05``. Raises DocumentError with the text and the valid forms."""
    if text in ("", RUNNING, *STATES):
        return Condition(text)
    match = _POSITION.fullmatch(text)
    if match is None:
        raise DocumentError(
            f"{source}: when is {text!r}, but must be a state ({', '.join(STATES)} or {RUNNING}), "
            "AXIS>POSITION or AXIS<POSITION, such as 'vertical>0.05'"
        )
    if match["axis"] not in axes:
        raise DocumentError(
            f"{source}: when: no axis {match['axis']!r}; the rig has {', '.join(axes)}"
            f"{did_you_mean(match['axis'], axes)}"
        )
    return Condition(match["sign"], match["axis"], float(match["limit"]))
