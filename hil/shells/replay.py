"""The replay shell: a recording's calls given to a fresh core, every outgoing byte compared.

The core is built from the documents in the recording, so a file replays alone, on any machine.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from hil.errors import RecordingError, ReplayMismatchError
from hil.frames import Frame
from hil.gateway import Gateway
from hil.life_cycle import Trigger
from hil.recording.reader import DeadlineCalled, FrameReceived, FrameSent, Operated, Recording
from hil.recording.recorder import LINK_FAILED
from hil.run_setup import RunSetup, setup_from_texts


class ReplayReport(NamedTuple):
    """What a verified replay covered."""

    calls: int
    frames_compared: int
    duration_s: float
    complete: bool
    """False where the recording ends without its footer: what it holds was verified."""


def setup_of(recording: Recording) -> RunSetup:
    """Rig, controllers and setpoints as the recorded run had them. Raises DocumentError, SetpointError."""
    texts = {name: content.decode() for name, content in recording.attachments.items()}
    return setup_from_texts(texts, recording.metadata.get("setpoints", {}))


def verify(recording: Recording) -> ReplayReport:
    """Replay and compare. Raises ReplayMismatchError naming the first difference."""
    calls = list(recording.calls())
    first_deadline_ns = next((call.deadline_ns for call in calls if isinstance(call, DeadlineCalled)), None)
    if first_deadline_ns is None:
        raise RecordingError(f"{recording.path}: holds no period; there is nothing to replay")
    gateway = setup_of(recording).gateway(first_deadline_ns)
    answered: deque[Frame] = deque()
    compared = 0
    for number, call in enumerate(calls):
        at = f"{recording.path}: {(call.now_ns - calls[0].now_ns) / 1e9:.6f} s, record {number}"
        if isinstance(call, FrameSent):
            if not answered:
                raise ReplayMismatchError(f"{at}: recorded {call.frame}, the core sends nothing")
            expected = answered.popleft()
            if expected != call.frame:
                raise ReplayMismatchError(f"{at}: recorded {call.frame}, the core sends {expected}")
            compared += 1
            continue
        link_failed = isinstance(call, Operated) and call.command.startswith(LINK_FAILED)
        if answered and not link_failed:  # a failing link took the rest of an answer with it
            raise ReplayMismatchError(f"{at}: the core sends {answered[0]}, the recording has no such frame")
        answered = deque(() if link_failed else _give(gateway, call, at))
    if answered and recording.complete:
        raise ReplayMismatchError(f"{recording.path}: the core sends {answered[0]} after the last record")
    span_ns = calls[-1].now_ns - calls[0].now_ns
    return ReplayReport(len(calls) - compared, compared, span_ns / 1e9, recording.complete)


def _give(gateway: Gateway, call: FrameReceived | DeadlineCalled | Operated, at: str) -> tuple[Frame, ...]:
    """Make one recorded call; returns the frames the core answers with."""
    if isinstance(call, FrameReceived):
        return gateway.receive(call.frame, call.now_ns).frames
    if isinstance(call, DeadlineCalled):
        if call.deadline_ns != gateway.next_deadline_ns:
            raise ReplayMismatchError(
                f"{at}: recorded deadline {call.deadline_ns} ns, the core's is {gateway.next_deadline_ns} ns"
            )
        return gateway.on_deadline(call.now_ns).frames
    try:
        trigger = Trigger(call.command)
    except ValueError:
        raise RecordingError(f"{at}: {call.command!r} is no operator command") from None
    return gateway.operate(trigger, call.now_ns).frames
