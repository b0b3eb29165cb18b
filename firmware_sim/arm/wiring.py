"""Which pins of the boards each axis of the arm hangs on, as the rig file says."""

from __future__ import annotations

from typing import Final, NamedTuple

from firmware_sim.arm.parameters import AXES
from hil.core.errors import DocumentError
from hil.core.rig import Rig


class Wires(NamedTuple):
    """Channels of one axis, counted from 0."""

    valve: int
    potentiometer: int


STRAIGHT: Final[dict[str, Wires]] = {name: Wires(channel, channel) for channel, name in enumerate(AXES)}
"""Vertical, horizontal, rotation on channels 1, 2, 3 of either board."""


def wiring(rig: Rig) -> dict[str, Wires]:
    """The wires of each axis in ``rig``; an axis that it leaves out hangs on none, its valve at rest.

    Raises DocumentError for an axis that the arm has not.
    """
    for name in rig.axes:
        if name not in AXES:
            raise DocumentError(
                f"rig: axes.{name}: the simulated arm has no such axis, only {', '.join(AXES)}; "
                "--linear simulates an axis of any name"
            )
    return {
        name: Wires(axis.valve.channel - 1, axis.potentiometer.channel - 1) for name, axis in rig.axes.items()
    }
