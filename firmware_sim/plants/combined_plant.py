"""Several plants behind the same boards, each with board channels of its own."""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import Any

from firmware_sim.plants.plant import HasContacts, HasEvents, HasPlannedEvents, OnEvent, Plant


class CombinedPlant:
    """Plants that share the boards, as one ``firmware_sim.plants.plant.Plant``.

    Every part gets all valve voltages and uses those of its own channels. A part reads 0 V on a channel that
    it does not use, so the sum of all readings is the reading of the part that uses the channel. Two parts
    must not use the same channel.
    """

    def __init__(self, parts: Sequence[Plant]) -> None:
        self._parts = tuple(parts)

    @property
    def open_contacts(self) -> Set[str]:
        """Names of the contacts that any part has opened."""
        return {name for part in self._parts if isinstance(part, HasContacts) for name in part.open_contacts}

    @property
    def on_event(self) -> OnEvent | None:
        """Function that is given each planned event of any part; None: nobody is notified."""
        return next((part.on_event for part in self._parts if isinstance(part, HasPlannedEvents)), None)

    @on_event.setter
    def on_event(self, function: OnEvent | None) -> None:
        for part in self._parts:
            if isinstance(part, HasPlannedEvents):
                part.on_event = function

    def advance(self, duration_ns: int, valve_v: Sequence[float]) -> None:
        """Hold the valve voltages (V, by channel) for ``duration_ns``.

        Raises the HilError of a part that fails.
        """
        for part in self._parts:
            part.advance(duration_ns, valve_v)

    def apply(self, event: Any) -> None:
        """Let an event happen to the parts that have events. Nothing happens to the others."""
        for part in self._parts:
            if isinstance(part, HasEvents):
                part.apply(event)

    def potentiometer_v(self) -> Sequence[float]:
        """Return the potentiometers' voltages now (V, by channel), 0 to 10 V."""
        volts = [0.0, 0.0, 0.0]
        for part in self._parts:
            for channel, reading in enumerate(part.potentiometer_v()):
                volts[channel] += reading
        return volts
