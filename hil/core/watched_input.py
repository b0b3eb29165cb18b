"""A contact that a module reports in a frame: closed, open, or unknown because no good frame arrives.

A frame proves a closed contact only if it is undamaged and newer than the one before, by its counter. An
undamaged frame with the bit cleared always opens the contact, whatever its counter is.
"""

from __future__ import annotations

from hil.core.input_settings import PROTECTION_BYTES, InputSettings
from hil.core.rig import nanoseconds
from hil.core.sync_matching import MAX_COUNTER_STEP
from hil.core.wire.frame_crc import frame_crc


class WatchedInput:
    """One contact. Times are monotonic nanoseconds."""

    def __init__(self, key: str, settings: InputSettings, wire_version: int, open_means: str) -> None:
        """``key`` is its table in the rig file. ``open_means`` says for messages why it may be open."""
        self._key = key
        self._settings = settings
        self._open_means = open_means
        self._crc = frame_crc(settings.frame, wire_version, protected=settings.protected)
        self._timeout_ns = nanoseconds(settings.timeout_s)
        self._mask = 1 << settings.bit
        self._min_length = settings.byte + 1 + (PROTECTION_BYTES if settings.protected else 0)
        self._last_counter: int | None = None
        self._closed_ns: int | None = None
        """Time of the last frame that proved a closed contact; None after one that showed it open."""
        self._has_opened = False
        """True if the last undamaged frame showed an open contact."""
        self._rejection = ""
        """Why the last frame was rejected; empty after a good one."""

    @property
    def identifier(self) -> int:
        """Identifier of the frame."""
        return self._settings.frame

    def receive(self, data: bytes, now_ns: int) -> str | None:
        """Take the data of a frame. Returns why the frame is rejected, or None."""
        settings = self._settings
        damage = self._damage(data)
        if damage is not None:
            self._rejection = damage
            return damage
        if not data[settings.byte] & self._mask:
            self._closed_ns = None
            self._has_opened = True
            self._rejection = ""
            return None
        repetition = self._repetition(data) if settings.protected else None
        self._rejection = repetition or ""
        if repetition is None:
            self._closed_ns = now_ns
            self._has_opened = False
        return repetition

    def problem(self, now_ns: int) -> str | None:
        """Return why the contact does not count as closed, or None if it does."""
        closed_ns = self._closed_ns
        if closed_ns is not None and now_ns - closed_ns <= self._timeout_ns:
            return None
        settings = self._settings
        rejected = f"; last frame rejected: {self._rejection}" if self._rejection else ""
        if self._has_opened:
            return (
                f"the contact is open: bit {settings.bit} of byte {settings.byte} of frame "
                f"0x{settings.frame:03X} is 0 (rig: {self._key}): {self._open_means}{rejected}"
            )
        if closed_ns is None:
            return (
                f"no frame 0x{settings.frame:03X} has shown the contact closed (rig: {self._key}.frame): "
                f"check the module that sends it{rejected}"
            )
        return (
            f"no good frame 0x{settings.frame:03X} for {(now_ns - closed_ns) / 1e6:.1f} ms, limit "
            f"{self._timeout_ns / 1e6:g} ms (rig: {self._key}.timeout_s){rejected}"
        )

    def _damage(self, data: bytes) -> str | None:
        if len(data) < self._min_length:
            return (
                f"frame 0x{self.identifier:03X} has {len(data)} bytes, and needs {self._min_length} "
                f"(rig: {self._key})"
            )
        problem = None if self._crc is None else self._crc.problem(data)
        return None if problem is None else f"frame 0x{self.identifier:03X}: {problem}"

    def _repetition(self, data: bytes) -> str | None:
        """Return why a frame is not newer than the one before, or None. Its counter is remembered."""
        counter, before = data[-2], self._last_counter
        self._last_counter = counter
        if before is None or 1 <= (counter - before) & 0xFF <= MAX_COUNTER_STEP:
            return None
        return f"frame 0x{self.identifier:03X}: counter {counter} after {before} is no newer frame"
