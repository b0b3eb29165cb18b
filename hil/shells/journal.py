"""Keeps the calls of a core and its answers in memory, and writes them as a recording when that is wanted.

A test in simulated time seldom needs its recording. A journal costs one list entry for each call, and no
process and no file before it is saved.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from hil import __version__
from hil.core.frames import Frame
from hil.core.output import LogEntry, Output
from hil.core.requests import Request
from hil.recording.handover import RunHeader
from hil.shells.run_setup import RunSetup

if TYPE_CHECKING:
    from hil.recording.recorder import Recorder

EPOCH_NS: Final = 1_000_000_000_000_000_000
"""Start of simulated time, 2001-09-09. It is fixed, so that a recording depends on the calls alone."""
_MEDIA_TYPES: Final = {".toml": "application/toml", ".json": "application/json", ".csv": "text/csv"}


class Journal:
    """The calls of one core in their order. Times are nanoseconds of simulated time."""

    def __init__(self) -> None:
        self._calls: list[tuple[str, tuple[object, ...]]] = []

    def frame_received(self, frame: Frame, now_ns: int, stamp_ns: int) -> None:
        """Note that the core is about to receive a frame."""
        self._calls.append(("frame_received", (frame, now_ns, stamp_ns + EPOCH_NS)))

    def deadline_called(self, deadline_ns: int, now_ns: int) -> None:
        """Note that the core's ``on_deadline`` is about to be called for ``deadline_ns``."""
        self._calls.append(("deadline_called", (deadline_ns, now_ns)))

    def operated(self, request: Request, now_ns: int) -> None:
        """Note that the core is about to be given an operator's request."""
        self._calls.append(("operated", (request, now_ns)))

    def answered(self, output: Output, now_ns: int, refused: tuple[int, ...] = ()) -> None:
        """Note the core's answer to the last call. ``refused`` are places of frames that were not sent."""
        self._calls.append(("answered", (output, now_ns, refused)))

    def noted(self, entry: LogEntry, now_ns: int) -> None:
        """Note a log entry of the shell, between two calls."""
        self._calls.append(("log_entry", (entry, now_ns)))

    def save(self, path: Path, setup: RunSetup, metadata: dict[str, dict[str, str]]) -> None:
        """Write all calls so far as the recording of a run of ``setup``.

        Raises RecordingExistsError if ``path`` exists, and RecordingError if it cannot be written.
        """
        from hil.recording.direct_writer import DirectWriter
        from hil.recording.recorder import Recorder

        recorder = Recorder(path, _header(setup), lossless=True, pipe=DirectWriter(path))
        for name, arguments in self._calls:
            if name == "answered":
                _record_answer(recorder, *arguments)  # type: ignore[arg-type]
            else:
                getattr(recorder, name)(*arguments)
        recorder.close(metadata)


def _record_answer(recorder: Recorder, output: Output, now_ns: int, refused: tuple[int, ...]) -> None:
    for place, frame in enumerate(output.frames):
        if place in refused:
            recorder.frame_refused(frame, now_ns)
        else:
            recorder.frame_sent(frame, now_ns)
    for entry in output.log:
        recorder.log_entry(entry, now_ns)
    if output.cycle is not None:
        recorder.cycle(output.cycle, now_ns, now_ns)
        recorder.hand_over()


def _header(setup: RunSetup) -> RunHeader:
    return RunHeader(
        epoch_offset_ns=EPOCH_NS,
        bus="lockstep",
        stamp_origin="simulated",
        axes=tuple((name, axis.unit) for name, axis in setup.rig.axes.items()),
        attachments={
            name: (_MEDIA_TYPES.get(Path(name).suffix, "text/plain"), text.encode())
            for name, text in setup.texts.items()
        },
        metadata={
            "documents": setup.digests(),
            "run": {"configuration sha256": setup.fingerprint(), "hil": __version__},
            "setpoints": {name: setpoint.text for name, setpoint in setup.setpoints.items()},
        },
    )
