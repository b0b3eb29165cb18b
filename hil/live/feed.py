"""The loop's end of the live page: writes every period, log entry and status to shared memory.

Writing makes no system call and never waits. Whoever shows the run reads the memory; see ``feed_file``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from time import monotonic_ns

import msgspec

from hil.core.gateway import Gateway
from hil.core.output import Cycle, LogEntry
from hil.core.requests import ControllerRequest
from hil.live.feed_file import MAX_TEXT_BYTES, FeedLog, FeedStatus, FeedWriter, RunInformation
from hil.live.period_record import packer

STATUS_PERIODS = 18
"""Number of periods from one status to the next, about 0.2 s."""
MAX_NAME_BYTES = 300
"""Longest path or name in a status, in bytes. A longer one is cut off."""


class LiveFeed:
    """Observer of a run that feeds the processes which show it."""

    def __init__(
        self,
        run: RunInformation,
        controllers: Mapping[str, str],
        recording: Callable[[], str],
        link: Path | None = None,
    ) -> None:
        """Create the feed. Raises EnvironmentLackError without shared memory.

        ``controllers``: name of the controller by axis; ``recording`` returns the path of the present
        recording, or an empty text; ``link``: where a daemon puts the link to the feed.
        """
        self._file = FeedWriter(run, link)
        self._controllers = {axis: _cut(name, MAX_NAME_BYTES) for axis, name in controllers.items()}
        self._recording = recording
        self._pack = packer(len(run.axes))
        self._encode = msgspec.msgpack.Encoder().encode

    @property
    def path(self) -> Path:
        """Path of the file in shared memory."""
        return self._file.path

    def period(self, cycle: Cycle, computed_ns: int, sent_ns: int) -> None:
        """Write a period whose answer was computed and sent at these times."""
        self._file.periods.write(self._pack(cycle, computed_ns, sent_ns))

    def log(self, entry: LogEntry) -> None:
        """Write a log entry."""
        source, text = _cut(entry.source, MAX_TEXT_BYTES), _cut(entry.text, MAX_TEXT_BYTES)
        self._file.log.write(self._encode(FeedLog(monotonic_ns(), int(entry.severity), source, text)))

    def controller_changed(self, request: ControllerRequest) -> None:
        """Note the name of a controller that an axis has from now on."""
        self._controllers[request.axis] = _cut(request.name, MAX_NAME_BYTES)

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        """Write the status from time to time."""
        if cycle.number % STATUS_PERIODS:
            return
        counts = {
            "missed periods": gateway.missed_periods,
            "rejected frames": gateway.rejected_frames,
            "lost samples": gateway.lost_samples,
            "error frames": gateway.error_frames,
        }
        fault = gateway.fault_reason
        status = FeedStatus(
            counts,
            None if fault is None else _cut(fault, MAX_TEXT_BYTES),
            _cut(gateway.readiness, MAX_TEXT_BYTES),
            _cut(self._recording(), MAX_NAME_BYTES),
            self._controllers,
        )
        self._file.status.write(self._encode(status))

    def close(self) -> None:
        """Say that the run has ended, and remove the file."""
        self._file.close()


def _cut(text: str, max_bytes: int) -> str:
    """Return the part of ``text`` that has at most ``max_bytes`` bytes."""
    encoded = text.encode("utf-8", "replace")
    return text if len(encoded) <= max_bytes else encoded[:max_bytes].decode("utf-8", "ignore")
