"""What a plant behind the boards is: valve voltages held for a while in, potentiometer voltages out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol


class Plant(Protocol):
    """A plant with three channels, counted from 0 here and from 1 in the rig file."""

    def advance(self, duration_ns: int, valve_v: Sequence[float]) -> None:
        """Hold the valve voltages (0 to 10 V, by channel) for ``duration_ns``.

        Raises HilError when the state leaves what the model can stand for.
        """

    def potentiometer_v(self) -> Sequence[float]:
        """The potentiometers' voltages now, by channel, 0 to 10 V; a free channel reads 0 V."""
