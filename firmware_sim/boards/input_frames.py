"""Frames of the digital inputs that the rig file names: the emergency stop and the enable switch.

The simulated potentiometer board sends them, whatever their identifier is. On a real rig they may come from
another module. A set bit is a closed contact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from firmware_sim.boards.codec import crc8, data_identity
from hil.core.frames import Frame
from hil.core.rig import Rig


class Contacts(NamedTuple):
    """State of the contacts that are wired to the inputs."""

    emergency_stop: bool = True
    """True if the emergency stop is closed, that is, released."""
    enable: bool = True
    """True if the enable switch is closed, that is, held."""


class InputFrames:
    """The frames of all inputs. ``contacts`` returns the state of the contacts now."""

    def __init__(self, rig: Rig, contacts: Callable[[], Contacts]) -> None:
        self._contacts = contacts
        named = (("emergency_stop", rig.emergency_stop), ("enable", rig.enable))
        self._inputs = [(name, settings) for name, settings in named if settings is not None]
        self._lengths: dict[int, int] = {}
        """Number of data bytes before counter and CRC, by identifier."""
        for _, settings in self._inputs:
            self._lengths[settings.frame] = max(self._lengths.get(settings.frame, 0), settings.byte + 1)
        self._protected = {settings.frame: settings.protected for _, settings in self._inputs}
        self._identities = {
            identifier: data_identity(identifier, rig.bus.wire_version) for identifier in self._lengths
        }
        self._counter = 0

    @property
    def is_used(self) -> bool:
        """True if the rig file names an input."""
        return bool(self._inputs)

    @property
    def identifiers(self) -> tuple[int, ...]:
        """Identifiers of the frames."""
        return tuple(self._lengths)

    @property
    def last_counter(self) -> int:
        """Counter of the last frames."""
        return (self._counter - 1) & 0xFF

    def first_byte(self) -> int:
        """Return the first byte of the first frame, as object 6000h shows it; 0 without inputs."""
        return self._data(self.identifiers[0])[0] if self._inputs else 0

    def reset(self) -> None:
        """Begin to count from 0."""
        self._counter = 0

    def frames(self) -> tuple[Frame, ...]:
        """Return one frame for each identifier, with the present state of its contacts."""
        counter, self._counter = self._counter, (self._counter + 1) & 0xFF
        frames = []
        for identifier, is_protected in self._protected.items():
            data = self._data(identifier)
            if is_protected:
                data.append(counter)
                data.append(crc8(self._identities[identifier] + data))
            frames.append(Frame(identifier, bytes(data)))
        return tuple(frames)

    def _data(self, identifier: int) -> bytearray:
        """Return the data of a frame without counter and CRC."""
        contacts = self._contacts()
        data = bytearray(self._lengths[identifier])
        for name, settings in self._inputs:
            if settings.frame == identifier and getattr(contacts, name):
                data[settings.byte] |= 1 << settings.bit
        return data
