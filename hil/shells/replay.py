"""The replay shell: a recording's calls given to a fresh core, and all that the core gives compared.

Every outgoing byte, every event, every signal. The core is built from the documents in the recording, so a
file replays alone, on any machine.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter, deque
from collections.abc import Iterator
from typing import NamedTuple

from hil import __version__
from hil.core.errors import HilError, RecordingError, ReplayMismatchError
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.life_cycle import Trigger
from hil.core.output import AxisSignals, LogEntry, Output
from hil.recording.reader import (
    AxisRecorded,
    CycleRecorded,
    DeadlineCalled,
    Entry,
    EventTold,
    FrameReceived,
    FrameSent,
    Operated,
    Recording,
)
from hil.recording.recorder import LINK_FAILED, NOT_SENT
from hil.shells.run_setup import RunSetup, setup_from_texts

ROUNDING = 1e-9
"""Signals behind a law or a sine may differ by so much, in their unit or relatively: machines round apart."""
_EXACT = ("position", "potentiometer_v")
"""Signals that are the same on every machine: a received sample, scaled."""


class ReplayReport(NamedTuple):
    """What a verified replay covered."""

    calls: int
    frames_compared: int
    log_entries_compared: int
    periods_compared: int
    """Periods whose signals and instants were compared."""
    duration_s: float
    complete: bool
    """False where the recording ends without its footer: what it holds was verified."""


Answer = dict[str, object]
"""One thing that the core gives back: what it is called, and its value."""


def setup_of(recording: Recording) -> RunSetup:
    """Rig, controllers and setpoints as the recorded run had them.

    Raises RecordingError where they are not those of the recorded fingerprints, DocumentError, SetpointError.
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
    texts = {name: content.decode(errors="replace") for name, content in recording.attachments.items()}
    setup = setup_from_texts(texts, recording.metadata.get("setpoints", {}))
    fingerprint = recording.metadata.get("run", {}).get("configuration sha256")
    if fingerprint not in (None, setup.fingerprint()):
        raise RecordingError(
            f"{recording.path}: attachments or metadata setpoints were changed: their SHA-256 is not that in "
            "metadata run.configuration sha256"
        )
    return setup


def verify(recording: Recording) -> ReplayReport:
    """Replay and compare. Raises ReplayMismatchError naming the first difference."""
    first = next((entry for entry in recording.entries() if isinstance(entry, DeadlineCalled)), None)
    if first is None:
        raise RecordingError(f"{recording.path}: holds no period; there is nothing to replay")
    try:
        return _replay(recording, setup_of(recording).gateway(first.deadline_ns))
    except ReplayMismatchError as error:
        recorded_by = recording.metadata.get("run", {}).get("hil", __version__)
        by = "" if recorded_by == __version__ else f" (recorded by hil {recorded_by}, this is {__version__})"
        raise ReplayMismatchError(f"{recording.path}: {error}{by}") from None


def _replay(recording: Recording, gateway: Gateway) -> ReplayReport:
    axes = tuple(recording.axes)
    answers: deque[Answer] = deque()
    calls = began_ns = now_ns = 0
    compared: Counter[type[Entry]] = Counter()
    for number, entry in enumerate(recording.entries(), 1):
        now_ns = entry.now_ns
        if number == 1:
            began_ns = now_ns
        at = f"{(now_ns - began_ns) / 1e9:.6f} s, message {number}"
        if isinstance(entry, FrameReceived | DeadlineCalled) or (
            isinstance(entry, Operated) and not entry.command.startswith(NOT_SENT)
        ):
            has_failed = isinstance(entry, Operated) and entry.command.startswith(LINK_FAILED)
            if answers and not has_failed:  # an error within an answer took the rest of it
                raise ReplayMismatchError(f"{at}: {_difference(None, answers[0])}")
            answers = deque(_given(gateway, entry, axes, at))
            calls += 1
        elif answers or not isinstance(entry, EventTold):  # between answers, the shell has its say
            difference = _difference(_recorded(entry), answers.popleft() if answers else None)
            if difference:
                raise ReplayMismatchError(f"{at}: {difference}")
            compared[type(entry)] += 1
    if answers and recording.complete:
        raise ReplayMismatchError(f"after the last message: {_difference(None, answers[0])}")
    return ReplayReport(
        calls,
        compared[FrameSent],
        compared[EventTold],
        compared[CycleRecorded],
        (now_ns - began_ns) / 1e9,
        recording.complete,
    )


def _given(
    gateway: Gateway, call: FrameReceived | DeadlineCalled | Operated, axes: tuple[str, ...], at: str
) -> list[Answer]:
    """What the core answers to a recorded call: an error, too, where it fails as it did then."""
    try:
        return list(_answers(_give(gateway, call, at), axes))
    except HilError:
        raise
    except Exception as error:
        return [{"error": f"{type(error).__name__}: {error}"}]


def _give(gateway: Gateway, call: FrameReceived | DeadlineCalled | Operated, at: str) -> Output:
    """Make one recorded call; returns what the core gives."""
    if isinstance(call, FrameReceived):
        return gateway.receive(call.frame, call.now_ns)
    if isinstance(call, DeadlineCalled):
        if call.deadline_ns != gateway.next_deadline_ns:
            raise ReplayMismatchError(
                f"{at}: recorded deadline {call.deadline_ns} ns, the core's is {gateway.next_deadline_ns} ns"
            )
        return gateway.on_deadline(call.now_ns)
    if call.command.startswith(LINK_FAILED):
        return gateway.link_failed(call.command.removeprefix(LINK_FAILED))
    try:
        trigger = Trigger(call.command)
    except ValueError:
        raise ReplayMismatchError(f"{at}: recorded {call.command!r}, no operator's command") from None
    return gateway.operate(trigger, call.now_ns)


def _answers(output: Output, axes: tuple[str, ...]) -> Iterator[Answer]:
    """What the core gives, in the order in which a session records it."""
    for frame in output.frames:
        yield {"frame": frame}
    for event in output.log:
        yield {"event": event}
    if output.cycle is not None:
        number, deadline_ns, wake_ns, receive_ns, state, fresh, signals = output.cycle
        for name, of_axis in zip(axes, signals, strict=True):
            yield _axis(name, wake_ns, of_axis, state, fresh)
        yield _period(number, deadline_ns, wake_ns, receive_ns, state, fresh)


def _recorded(entry: Entry) -> Answer:
    """A recorded answer without what the shell adds: when it was computed and sent."""
    match entry:
        case FrameSent():
            return {"frame": entry.frame}
        case Operated(_, command):
            return {"frame": command.removeprefix(NOT_SENT)}
        case EventTold():
            return {"event": entry.event}
        case AxisRecorded(_, name, wake_ns, signals, state, fresh):
            return _axis(name, wake_ns, signals, state, fresh)
        case CycleRecorded(_, number, deadline_ns, wake_ns, receive_ns, _, _, state, fresh):
            return _period(number, deadline_ns, wake_ns, receive_ns, state, fresh)
    raise AssertionError(entry)


def _axis(name: str, wake_ns: int, signals: AxisSignals, state: int, fresh: bool) -> Answer:
    values = {f"{name} {signal}": value for signal, value in zip(AxisSignals._fields, signals, strict=True)}
    return {f"{name} stamp_ns": wake_ns, **values, f"{name} state": int(state), f"{name} fresh": fresh}


def _period(number: int, deadline_ns: int, wake_ns: int, receive_ns: int, state: int, fresh: bool) -> Answer:
    return {
        "period": number,
        "deadline_ns": deadline_ns,
        "wake_ns": wake_ns,
        "receive_ns": receive_ns,
        "state": int(state),
        "fresh": fresh,
    }


def _difference(recorded: Answer | None, given: Answer | None) -> str:
    """Where they differ, in words; empty where they do not."""
    if recorded is None or given is None or recorded.keys() != given.keys():
        verb = "sends" if given and "frame" in given else "gives"
        return f"recorded {_words(recorded)}, the core {verb} {_words(given)}"
    for name, value in recorded.items():
        if not _same(name, value, given[name]):
            verb = "sends" if name == "frame" else "gives"
            return f"recorded {_words({name: value})}, the core {verb} {_words({name: given[name]})}"
    return ""


def _same(name: str, recorded: object, given: object) -> bool:
    if isinstance(recorded, str) and isinstance(given, Frame):  # one that was not sent
        return recorded == str(given)
    if not isinstance(recorded, float) or not isinstance(given, float):
        return recorded == given
    if recorded == given or (math.isnan(recorded) and math.isnan(given)):
        return True
    return not name.endswith(_EXACT) and abs(recorded - given) <= ROUNDING * max(1.0, abs(given))


def _words(answer: Answer | None) -> str:
    if answer is None:
        return "nothing"
    name, value = next(iter(answer.items()))
    match value:
        case LogEntry(severity, source, text):
            return f"{severity.name.lower()} {source}: {text}"
        case Frame():
            return str(value)
    return f"{name} {value}"
