"""The replay shell: gives a recording's calls to a fresh core, and compares all that the core answers.

Every frame, log entry, signal and period is compared. The core is built from the documents in the recording,
so a file can be replayed alone, on any machine.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import json
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from hil import __version__
from hil.core.core_state import restore
from hil.core.errors import HilError, RecordingError, ReplayMismatchError
from hil.core.gateway import Gateway
from hil.core.output import NOTHING, Output
from hil.core.wire.codec import RPDO1_DAC
from hil.recording import entries
from hil.recording.entries import (
    AxisRecorded,
    CycleRecorded,
    DeadlineCalled,
    Entry,
    FrameReceived,
    FrameRefused,
    FrameSent,
    LinkFailed,
    Logged,
    Operated,
)
from hil.recording.reader import Recording
from hil.recording.rotation_names import STATE_NAME, is_set_up
from hil.shells.answers import (
    Deadline,
    Difference,
    Quick,
    Raised,
    answers_in,
    difference,
    recorded_answer,
    typed,
)
from hil.shells.run_setup import RIG_NAME, RunSetup, setup_from_texts


class ReplayReport(NamedTuple):
    """Extent of a replay without a difference."""

    calls: int
    frames_compared: int
    """Number of frames that were sent; those that the link refused are compared too, but not counted."""
    log_entries_compared: int
    periods_compared: int
    duration_s: float
    """Time from the first message to the last."""
    complete: bool
    """False if the recording was cut off. Its contents were verified up to its end."""


def setup_of(recording: Recording) -> RunSetup:
    """Build rig, controllers and setpoints of the recorded run.

    Raises RecordingError when they do not match the recorded hashes, DocumentError and SetpointError.
    """
    for name, digest in recording.metadata.get("documents", {}).items():
        content = recording.attachments.get(name)
        if content is None:
            raise RecordingError(f"{recording.path}: the attachment {name} is missing")
        if hashlib.sha256(content).hexdigest() != digest:
            raise RecordingError(
                f"{recording.path}: the attachment {name} was changed: its SHA-256 is not that in metadata "
                f"documents.{name}"
            )
    if RIG_NAME not in recording.attachments:
        raise RecordingError(
            f"{recording.path}: the attachment {RIG_NAME} is missing; no gateway can be built without it"
        )
    texts = {name: text for name, text in recording.documents.items() if is_set_up(name)}
    setup = setup_from_texts(texts, recording.metadata.get("setpoints", {}))
    fingerprint = recording.metadata.get("run", {}).get("configuration sha256")
    if fingerprint is None and "documents" in recording.metadata:
        raise RecordingError(
            f"{recording.path}: metadata run.configuration sha256 is missing, so it is unknown whether "
            "attachments or setpoints were changed"
        )
    if fingerprint not in (None, setup.fingerprint()):
        raise RecordingError(
            f"{recording.path}: attachments or metadata setpoints were changed: their SHA-256 is not that in "
            "metadata run.configuration sha256"
        )
    return setup


def verify(recording: Recording) -> ReplayReport:
    """Replay and compare.

    Raises ReplayMismatchError at the first difference, and RecordingError when the recording has a gap or is
    damaged.
    """
    first = next((entry for entry in recording.entries() if isinstance(entry, DeadlineCalled)), None)
    if first is None:
        raise RecordingError(
            f"{recording.path}: has no period, so there is nothing to replay; {_what(recording)}"
        )
    try:
        return _replay(recording, _gateway(recording, first.deadline_ns))
    except ReplayMismatchError as error:
        recorded_by = recording.metadata.get("run", {}).get("hil", __version__)
        by = "" if recorded_by == __version__ else f" (recorded by hil {recorded_by}, this is {__version__})"
        raise ReplayMismatchError(f"{recording.path}: {error}{by}") from None


def _what(recording: Recording) -> str:
    """Return in words what a recording without a period has, and how it ended."""
    counts = [f"{count} on {topic}" for topic, count in recording.counts.items() if count]
    found = f"its messages are {', '.join(counts)}" if counts else "it has no message"
    if not recording.complete:
        return f"{found}, and it was cut off"
    reason = recording.metadata.get("ending", {}).get("reason", "")
    return f"{found}; the run ended by: {reason}" if reason else found


def _gateway(recording: Recording, first_deadline_ns: int) -> Gateway:
    """Return the core with which the recording began: a fresh one, or one in the middle of a run."""
    gateway = setup_of(recording).gateway(first_deadline_ns)
    state = recording.documents.get(STATE_NAME)
    if state is not None:
        try:
            restore(gateway, json.loads(state))
        except (HilError, ValueError) as error:
            raise RecordingError(
                f"{recording.path}: the attachment {STATE_NAME}: {error}; a run whose first file is there "
                "can be replayed as a whole: hil replay FOLDER"
            ) from None
    return gateway


def _replay(recording: Recording, gateway: Gateway) -> ReplayReport:
    replay = _Replay(gateway, tuple(recording.axes))
    with _paused_garbage_collection():
        found, number, first_ns, last_ns = replay.run(recording.entries())
    if found is not None:
        raise ReplayMismatchError(f"{(last_ns - first_ns) * 1e-9:.6f} s, message {number}: {found}")
    found = replay.missing_answer()
    if found is not None and recording.complete:
        raise ReplayMismatchError(f"after the last message: {found}")
    recording.check_count()
    return ReplayReport(
        replay.calls,
        replay.frames,
        replay.log_entries,
        replay.periods,
        (last_ns - first_ns) * 1e-9,
        recording.complete,
    )


@contextlib.contextmanager
def _paused_garbage_collection() -> Iterator[None]:
    """Pause the collection of reference cycles: a replay makes many tuples and no cycle."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class _Outcome(NamedTuple):
    """Result of :meth:`_Replay.run`."""

    difference: Difference | None
    messages: int
    """Number of messages up to the difference, or up to the end."""
    first_ns: int
    last_ns: int


class _Replay:
    """Gives recorded calls to a core, and compares its answers with the recorded ones in their order.

    An answer that is equal is compared as it is. Only one that is not is brought into a form that names its
    fields, since computed signals may differ by rounding.
    """

    def __init__(self, gateway: Gateway, axes: tuple[str, ...]) -> None:
        self._gateway = gateway
        self._axes = axes
        self._pending: deque[Quick] = deque()
        """Answers to the last call that have not been compared yet."""
        self.calls = 0
        self.frames = self.log_entries = self.periods = 0
        """Numbers of recorded answers that were compared."""
        self._handlers: dict[type[Entry], Callable[[Any], Difference | None]] = {
            FrameReceived: self._frame_received,
            DeadlineCalled: self._deadline_called,
            Operated: self._operated,
            LinkFailed: self._link_failed,
            FrameSent: self._frame_sent,
            FrameRefused: self._frame_refused,
            Logged: self._logged,
            AxisRecorded: self._axis_recorded,
            CycleRecorded: self._cycle_recorded,
        }

    def run(self, entries: Iterator[Entry]) -> _Outcome:
        """Take all entries, up to the first difference."""
        handlers = self._handlers
        number = first_ns = last_ns = 0
        for entry in entries:
            number += 1
            last_ns = entry[0]
            if number == 1:
                first_ns = last_ns
            found = handlers[type(entry)](entry)
            if found is not None:
                return _Outcome(found, number, first_ns, last_ns)
        return _Outcome(None, number, first_ns, last_ns)

    def missing_answer(self) -> Difference | None:
        """Return the core's next answer as a difference, if the recording lacks it."""
        return Difference(None, typed(self._pending[0])) if self._pending else None

    def _frame_received(self, entry: FrameReceived) -> Difference | None:
        return self._call(self._gateway.receive, entry.frame, entry.now_ns)

    def _deadline_called(self, entry: DeadlineCalled) -> Difference | None:
        expected_ns = self._gateway.next_deadline_ns
        if entry.deadline_ns != expected_ns and not self._pending:
            return Difference(Deadline(entry.deadline_ns), Deadline(expected_ns))
        return self._call(self._gateway.on_deadline, entry.now_ns)

    def _operated(self, entry: Operated) -> Difference | None:
        return self._call(self._gateway.operate, entry.request, entry.now_ns)

    def _link_failed(self, entry: LinkFailed) -> Difference | None:
        self._pending.clear()  # An exception while the frames were sent ended the last answer early.
        return self._call(self._gateway.link_failed, entry.reason)

    def _call(self, method: Callable[..., Output], *arguments: object) -> Difference | None:
        """Give a recorded call to the core, unless an answer to the one before is missing."""
        if self._pending:
            return self.missing_answer()
        self.calls += 1
        try:
            output = method(*arguments)
        except HilError:
            raise
        except Exception as error:  # The recorded run may have ended with the same exception.
            self._pending.append(Raised(f"{type(error).__name__}: {error}"))
        else:
            if output is not NOTHING:
                self._pending.extend(answers_in(output, self._axes))
        return None

    def _frame_sent(self, entry: FrameSent) -> Difference | None:
        self.frames += 1
        if self._pending and self._pending[0] == entry.frame:
            self._pending.popleft()
            return None
        return self._difference(entry)

    def _frame_refused(self, entry: FrameRefused) -> Difference | None:
        if entry.frame.id == RPDO1_DAC:
            self._gateway.command_refused(entry.frame)
        return self._difference(entry)

    def _logged(self, entry: Logged) -> Difference | None:
        if not self._pending:
            return None  # A log entry of the shell, between two answers of the core.
        self.log_entries += 1
        return self._difference(entry)

    def _axis_recorded(self, entry: AxisRecorded) -> Difference | None:
        if self._pending and self._pending[0] == entry[1:]:
            self._pending.popleft()
            return None
        return self._difference(entry)

    def _cycle_recorded(self, entry: CycleRecorded) -> Difference | None:
        self.periods += 1
        if self._pending and self._pending[0][:6] == entry[1:5] + entry[7:]:
            self._pending.popleft()
            return None
        return self._difference(entry)

    def _difference(self, entry: entries.Answer) -> Difference | None:
        """Compare a recorded answer with the core's next one field by field."""
        answer = typed(self._pending.popleft()) if self._pending else None
        return difference(recorded_answer(entry), answer)
