"""The recordings of a gateway that runs for days: one file after the other, each complete in itself.

Design. A new file may begin after any period, also while an axis moves. It holds the documents of the run.
Its attachment ``core-state.json`` is the state of the core at that instant: plain numbers in JSON, in the
format of ``hil.core.core_state``. A replay of the file builds the core from the documents, gives it this
state, and compares every answer from there on. So each file can be verified alone, and older ones can be
removed.

Restarting the core at each new file would be exact too, but it would have to wait until nothing runs. A
laboratory may control for days without a stop, and its file would grow without limit.

The recorder process closes the old file, creates the new one with its documents, and removes old ones. The
loop only reads the state out of the core, which takes about 0.4 ms for three axes, after the command of the
period has left. If the new file cannot be created, the loop goes on without a recording, says so, and tries
again with the next file.

Controllers that an operator has changed are attached as ``changed/controllers/<axis>.json``. The state has
their numbers; the file says where they come from.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from hil.core.core_state import state_of
from hil.core.gateway import Gateway
from hil.core.output import Cycle, LogEntry, Severity
from hil.core.requests import ControllerRequest, Reply
from hil.recording.recorder import Recorder
from hil.recording.rotation_names import CHANGED_CONTROLLERS, STATE_NAME

MAX_FILES_IN_NAME = 100_000
"""Largest number that is tried for the name of a further file."""


class RotationLimits(NamedTuple):
    """Limits after which a new file begins, and how many are kept. None is no limit."""

    max_bytes: int | None = None
    """Size of a file after which the next one begins."""
    max_s: float | None = None
    """Time in s after which the next file begins."""
    max_files: int | None = None
    """Number of files of this run that are kept. The oldest are removed; None removes none."""


class Recordings:
    """The files of one run. ``recorder`` has begun the first one."""

    def __init__(self, recorder: Recorder, limits: RotationLimits) -> None:
        self._recorder = recorder
        self._limits = limits
        self._first = self._present = recorder.path
        self._number = 1
        self._files = [] if recorder.path is None else [recorder.path]
        """Files of this run that exist, the oldest first."""
        self._began_ns: int | None = None
        """Time of the first period of the present file."""
        self._controllers: dict[str, str] = {}
        """Texts of the controllers that operators have changed, by axis."""

    @property
    def path(self) -> Path | None:
        """The present file, also if it cannot be written any more; None after the recording was stopped."""
        return self._recorder.path

    @property
    def written_path(self) -> Path | None:
        """The file that is being written; None while nothing is recorded, for whatever reason."""
        return None if self._recorder.has_failed else self._recorder.path

    def controller_changed(self, request: ControllerRequest) -> None:
        """Keep the text of a controller that the core has taken, for the files that follow."""
        self._controllers[request.axis] = request.document

    def after_period(self, cycle: Cycle, gateway: Gateway) -> LogEntry | None:
        """Begin a new file if the present one has reached a limit. Returns a log entry if it did."""
        if self._began_ns is None:
            self._began_ns = cycle.wake_ns
        if self.path is None or not self._is_full(cycle.wake_ns):
            return None
        self._began_ns = cycle.wake_ns
        reply = self.begin(gateway)
        severity = Severity.INFO if reply.accepted else Severity.ERROR
        return LogEntry(severity, "recorder", reply.text)

    def begin(self, gateway: Gateway, path: Path | None = None) -> Reply:
        """Begin a new file with the present state of the core: ``path``, or the next number."""
        path = path or self._next_path()
        removed = self._to_remove()
        reason = self._recorder.begin_file(
            path,
            {
                f"{CHANGED_CONTROLLERS}{axis}.json": ("application/json", text.encode())
                for axis, text in self._controllers.items()
            },
            {"ending": {"reason": f"continued in {path.name}"}},
            removed,
            {STATE_NAME: state_of(gateway)},
        )
        if reason is not None:
            return Reply(False, f"no new recording: {reason}")
        self._began_ns = None
        self._files = [*self._files[len(removed) :], path]
        names = ", ".join(file.name for file in removed)
        return Reply(True, f"recording goes on in {path}" + (f"; removed: {names}" if removed else ""))

    def stop(self) -> Reply:
        """End the present file. The loop goes on without a recording."""
        path = self.path
        if path is None:
            return Reply(False, "nothing is recorded")
        self._recorder.stop({"ending": {"reason": "an operator stopped the recording"}})
        return Reply(True, f"recording ended: {path}")

    def _is_full(self, now_ns: int) -> bool:
        max_bytes, max_s, _ = self._limits
        if max_bytes is not None and self._recorder.file_bytes >= max_bytes:
            return True
        return max_s is not None and self._began_ns is not None and now_ns - self._began_ns >= max_s * 1e9

    def _next_path(self) -> Path:
        """Return the first file with the next number that does not exist, such as ``run-2.mcap``."""
        first = self._first or Path("run.mcap")
        while self._number < MAX_FILES_IN_NAME:
            self._number += 1
            path = first.with_name(f"{first.stem}-{self._number}{first.suffix}")
            if not path.exists():
                break
        return path

    def _to_remove(self) -> list[Path]:
        """Return the oldest files that are too many when another one begins."""
        limit = self._limits.max_files
        return [] if limit is None else self._files[: max(len(self._files) + 1 - limit, 0)]
