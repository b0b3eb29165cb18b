"""A recorder that records nothing, for a loop without a recording."""

from __future__ import annotations

from typing import Protocol

from hil.core.frames import Frame
from hil.core.output import Cycle, LogEntry
from hil.core.requests import Request


class RunRecorder(Protocol):
    """What a session reports to a recorder; see :class:`hil.recording.recorder.Recorder`."""

    def frame_received(self, frame: Frame, now_ns: int, stamp_ns: int) -> None:
        """Take a call of the core with a frame."""

    def frame_sent(self, frame: Frame, now_ns: int) -> None:
        """Take a frame that the link took."""

    def frame_refused(self, frame: Frame, now_ns: int) -> None:
        """Take a frame that the link did not send."""

    def deadline_called(self, deadline_ns: int, now_ns: int) -> None:
        """Take a call of the core at its deadline."""

    def operated(self, request: Request, now_ns: int, asked_by: str = "") -> None:
        """Take a call of the core with an operator's request."""

    def link_failed(self, reason: str, now_ns: int) -> None:
        """Take a call of the core with a failure of the link."""

    def cycle(self, cycle: Cycle, computed_ns: int, sent_ns: int) -> None:
        """Take a period that ended."""

    def log_entry(self, entry: LogEntry, now_ns: int) -> None:
        """Take a log entry."""

    def hand_over(self) -> LogEntry | None:
        """Pass on what was taken; called once a period. Returns a log entry about the recording itself."""


class NoRecorder:
    """Takes everything and keeps nothing."""

    def frame_received(self, frame: Frame, now_ns: int, stamp_ns: int) -> None:
        """Do nothing."""

    def frame_sent(self, frame: Frame, now_ns: int) -> None:
        """Do nothing."""

    def frame_refused(self, frame: Frame, now_ns: int) -> None:
        """Do nothing."""

    def deadline_called(self, deadline_ns: int, now_ns: int) -> None:
        """Do nothing."""

    def operated(self, request: Request, now_ns: int, asked_by: str = "") -> None:
        """Do nothing."""

    def link_failed(self, reason: str, now_ns: int) -> None:
        """Do nothing."""

    def cycle(self, cycle: Cycle, computed_ns: int, sent_ns: int) -> None:
        """Do nothing."""

    def log_entry(self, entry: LogEntry, now_ns: int) -> None:
        """Do nothing."""

    def hand_over(self) -> LogEntry | None:
        """Return None."""
        return None
