"""Board channels of each axis of the arm, as the rig file assigns them."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final, NamedTuple

from firmware_sim.arm.parameters import AXES
from hil.core.errors import DocumentError
from hil.core.rig import Rig


class Wires(NamedTuple):
    """Board channels of one axis, counted from 0."""

    valve: int
    potentiometer: int


STRAIGHT: Final[dict[str, Wires]] = {name: Wires(channel, channel) for channel, name in enumerate(AXES)}
"""Default wiring: vertical, horizontal, rotation on channels 1, 2, 3 of both boards."""


def wiring(rig: Rig, without: Collection[str] = ()) -> dict[str, Wires]:
    """Return the wires of each axis of the rig, except the axes named in ``without``.

    Raises DocumentError for an axis that the arm does not have.
    """
    for name in rig.axes:
        if name not in AXES and name not in without:
            raise DocumentError(
                f"rig file: axes.{name}: the simulated arm has no axis of this name, only {', '.join(AXES)}; "
                f"use --plant {name}=FILE or --linear to simulate it"
            )
    return {
        name: Wires(axis.valve.channel - 1, axis.potentiometer.channel - 1)
        for name, axis in rig.axes.items()
        if name not in without
    }
