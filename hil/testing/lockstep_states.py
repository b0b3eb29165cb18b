"""Builds a rig in simulated time and brings it to a state."""

from __future__ import annotations

from typing import Any, Final

from hil.core.errors import HilError
from hil.lockstep_rig import LockstepRig

STATES: Final = ("offline", "ready", "armed", "running")


def build_rig(state: str, options: dict[str, Any]) -> LockstepRig:
    """Return a rig with ``options`` of :class:`hil.LockstepRig` in ``state``.

    Raises HilError if there is no such state, or if the rig does not reach it.
    """
    if state not in STATES:
        raise HilError(f"state is {state!r}, but must be one of {', '.join(STATES)}")
    rig = LockstepRig(**options)
    for reach in (rig.bring_up, rig.arm, rig.start)[: STATES.index(state)]:
        reach()
    return rig
