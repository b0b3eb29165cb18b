"""Count and report rejected frames: samples, heartbeats and emergency messages that must not be used."""

from __future__ import annotations

from hil.core.output import NOTHING, LogThrottle, Output, Severity


class Rejections:
    """Number and last reason of rejected frames.

    Of several rejections without a good sample in between, only the first is reported.
    """

    def __init__(self, throttle: LogThrottle) -> None:
        self._throttle = throttle
        self.count = 0
        """Number of frames rejected so far."""
        self.last_reason = ""
        """Reason of the last rejection; empty after a good sample."""

    def add(self, reason: str) -> Output:
        """Count a rejection, and report it unless one was reported since the last good sample."""
        is_reported = self.last_reason != ""
        self.add_silently(reason)
        if is_reported:
            return NOTHING
        number = f" ({self.count} so far)" if self.count > LogThrottle.ALWAYS_REPORTED else ""
        return self._throttle.report(Severity.WARNING, "guard", f"rejected{number}: {reason}")

    def add_silently(self, reason: str) -> None:
        """Count a rejection that is reported elsewhere."""
        self.count += 1
        self.last_reason = reason

    def forget_reason(self) -> None:
        """Report the next rejection again: a good sample has arrived, or an operator has reset a fault."""
        self.last_reason = ""
