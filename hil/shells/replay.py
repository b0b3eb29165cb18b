"""The replay shell: gives a recording's calls to a fresh core, and compares all that the core answers.

Every frame, log entry, signal and period is compared. The core is built from the documents in the recording,
so a file can be replayed alone, on any machine.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter, deque
from typing import NamedTuple

from hil import __version__
from hil.core.core_state import restore
from hil.core.errors import HilError, RecordingError, ReplayMismatchError
from hil.core.gateway import Gateway
from hil.core.output import Output
from hil.core.wire.codec import RPDO1_DAC
from hil.recording.entries import (
    Call,
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
    Answer,
    Deadline,
    Difference,
    Raised,
    answers_in,
    difference,
    recorded_answer,
)
from hil.shells.run_setup import RunSetup, setup_from_texts


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
        raise RecordingError(f"{recording.path}: has no period; there is nothing to replay")
    try:
        return _replay(recording, _gateway(recording, first.deadline_ns))
    except ReplayMismatchError as error:
        recorded_by = recording.metadata.get("run", {}).get("hil", __version__)
        by = "" if recorded_by == __version__ else f" (recorded by hil {recorded_by}, this is {__version__})"
        raise ReplayMismatchError(f"{recording.path}: {error}{by}") from None


def _gateway(recording: Recording, first_deadline_ns: int) -> Gateway:
    """Return the core with which the recording began: a fresh one, or one in the middle of a run."""
    gateway = setup_of(recording).gateway(first_deadline_ns)
    state = recording.documents.get(STATE_NAME)
    if state is not None:
        try:
            restore(gateway, json.loads(state))
        except (HilError, ValueError) as error:
            raise RecordingError(f"{recording.path}: the attachment {STATE_NAME}: {error}") from None
    return gateway


def _replay(recording: Recording, gateway: Gateway) -> ReplayReport:
    replay = _Replay(gateway, tuple(recording.axes))
    first_ns: int | None = None
    last_ns = 0
    for number, entry in enumerate(recording.entries(), 1):
        if first_ns is None:
            first_ns = entry.now_ns
        found = replay.take(entry)
        last_ns = entry.now_ns
        if found is not None:
            duration_s = (last_ns - first_ns) * 1e-9
            raise ReplayMismatchError(f"{duration_s:.6f} s, message {number}: {found}")
    found = replay.missing_answer()
    if found is not None and recording.complete:
        raise ReplayMismatchError(f"after the last message: {found}")
    recording.check_count()
    compared = replay.compared
    return ReplayReport(
        replay.calls,
        compared[FrameSent],
        compared[Logged],
        compared[CycleRecorded],
        0.0 if first_ns is None else (last_ns - first_ns) * 1e-9,
        recording.complete,
    )


_CALLS = (FrameReceived, DeadlineCalled, Operated, LinkFailed)


class _Replay:
    """Gives recorded calls to a core, and compares its answers with the recorded ones in their order."""

    def __init__(self, gateway: Gateway, axes: tuple[str, ...]) -> None:
        self._gateway = gateway
        self._axes = axes
        self._pending: deque[Answer] = deque()
        """Answers to the last call that have not been compared yet."""
        self.calls = 0
        self.compared: Counter[type[Entry]] = Counter()
        """Number of recorded answers that were compared, by kind of entry."""

    def take(self, entry: Entry) -> Difference | None:
        """Give a recorded call to the core, or compare a recorded answer with the core's next one."""
        if isinstance(entry, _CALLS):
            if isinstance(entry, LinkFailed):
                self._pending.clear()  # An exception while the frames were sent ended the last answer early.
            return self.missing_answer() or self._call(entry)
        if isinstance(entry, Logged) and not self._pending:
            return None  # A log entry of the shell, between two answers of the core.
        self.compared[type(entry)] += 1
        if isinstance(entry, FrameRefused) and entry.frame.id == RPDO1_DAC:
            self._gateway.command_refused(entry.frame)
        return difference(recorded_answer(entry), self._pending.popleft() if self._pending else None)

    def missing_answer(self) -> Difference | None:
        """Return the core's next answer as a difference, if the recording lacks it."""
        return Difference(None, self._pending[0]) if self._pending else None

    def _call(self, call: Call) -> Difference | None:
        self.calls += 1
        expected_ns = self._gateway.next_deadline_ns
        if isinstance(call, DeadlineCalled) and call.deadline_ns != expected_ns:
            return Difference(Deadline(call.deadline_ns), Deadline(expected_ns))
        try:
            self._pending.extend(answers_in(_output(self._gateway, call), self._axes))
        except HilError:
            raise
        except Exception as error:  # The recorded run may have ended with the same exception.
            self._pending.append(Raised(f"{type(error).__name__}: {error}"))
        return None


def _output(gateway: Gateway, call: Call) -> Output:
    match call:
        case FrameReceived():
            return gateway.receive(call.frame, call.now_ns)
        case DeadlineCalled():
            return gateway.on_deadline(call.now_ns)
        case Operated():
            return gateway.operate(call.request, call.now_ns)
        case LinkFailed():
            return gateway.link_failed(call.reason)
