"""The interface of a plant behind the simulated boards."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from typing import Any, Final, Protocol, TypeAlias, runtime_checkable

EMERGENCY_STOP: Final = "emergency stop"
ENABLE_SWITCH: Final = "enable switch"
"""Names of the contacts that a plant may open."""

OnEvent: TypeAlias = Callable[[Any, int], None]
"""Function that is given each planned event after it has happened.

The integer is the time in nanoseconds from the event to the end of the present ``advance``.
"""


class Plant(Protocol):
    """A plant with three channels: valve voltages in, potentiometer voltages out.

    Channels are counted from 0 here, and from 1 in the rig file. Time passes only in ``advance``.
    """

    def advance(self, duration_ns: int, valve_v: Sequence[float]) -> None:
        """Hold the valve voltages (V, by channel, 0 to 10 V) for ``duration_ns``.

        Raises HilError if the state leaves the range for which the model is valid.
        """

    def potentiometer_v(self) -> Sequence[float]:
        """Return the potentiometers' voltages now (V, by channel), 0 to 10 V; 0 V on an unused channel."""


@runtime_checkable
class HasContacts(Protocol):
    """A plant beside which an emergency stop and an enable switch are, which its events operate."""

    @property
    def open_contacts(self) -> Set[str]:
        """Names of the contacts that are open now."""


@runtime_checkable
class HasEvents(Protocol):
    """A plant to which events can happen: the pneumatic arm, also as a part of a plant."""

    def apply(self, event: Any) -> None:
        """Let an event of ``firmware_sim.arm.events`` happen now, whatever its ``at_s`` is."""


@runtime_checkable
class HasPlannedEvents(Protocol):
    """A plant that knows in advance when events happen to it, and reports those that have happened."""

    on_event: OnEvent | None
