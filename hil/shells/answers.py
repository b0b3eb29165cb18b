"""Answers of the core as replay compares them, and the difference between two of them."""

from __future__ import annotations

import math
from typing import NamedTuple

from hil.core.frames import Frame
from hil.core.output import AxisSignals, Cycle, LogEntry, Output
from hil.recording import entries

ROUNDING = 1e-9
"""Accepted difference of a computed signal, absolute in its unit or relative. Machines round differently."""
_ROUNDED = frozenset({"setpoint", "error", "output_v", "command_v"})
"""Signals that a control law or a setpoint computes. The others are scaled samples and compared exactly."""


class AxisAnswer(NamedTuple):
    """The part of a core's answer that is about one axis."""

    axis: str
    stamp_ns: int
    setpoint: float
    position: float
    error: float
    output_v: float
    command_v: float
    potentiometer_v: float
    phase: int
    state: int
    fresh: bool


class PeriodAnswer(NamedTuple):
    """The part of a core's answer that is about the period which ended."""

    number: int
    deadline_ns: int
    wake_ns: int
    receive_ns: int
    state: int
    fresh: bool


class Deadline(NamedTuple):
    """The deadline of a call: the recorded one must be the one that the core has asked for."""

    deadline_ns: int


class Raised(NamedTuple):
    """An exception in place of an answer, as the recorded core may have raised it."""

    text: str


Answer = Frame | LogEntry | AxisAnswer | PeriodAnswer | Deadline | Raised


class Difference(NamedTuple):
    """The first difference between the recorded answer and the core's; None stands for no answer."""

    recorded: Answer | None
    replayed: Answer | None
    field: str = ""
    """Name of the field that differs, where both are answers of the same kind."""

    def __str__(self) -> str:
        verb = "sends" if isinstance(self.replayed, Frame) else "gives"
        recorded, replayed = (_in_words(answer, self.field) for answer in (self.recorded, self.replayed))
        return f"recorded {recorded}, the core {verb} {replayed}"


Quick = Frame | LogEntry | Raised | Cycle | tuple[str, int, AxisSignals, int, bool]
"""An answer of the core as it can be compared fastest: a period as :class:`Cycle`, and an axis as a tuple.

The tuple has the values of ``AxisRecorded`` without its first one.
"""


def answers_in(output: Output, axes: tuple[str, ...]) -> tuple[Quick, ...]:
    """Split an output into answers, in the order in which a session records them."""
    frames, log, cycle, _ = output
    if cycle is None:
        return frames + log
    _, _, wake_ns, _, state, fresh, signals = cycle
    of_axes = [(name, wake_ns, values, state, fresh) for name, values in zip(axes, signals, strict=True)]
    return (*frames, *log, *of_axes, cycle)


def typed(answer: Quick) -> Answer:
    """Return an answer of the core in the form in which differences are described."""
    if isinstance(answer, Cycle):
        number, deadline_ns, wake_ns, receive_ns, state, fresh, _ = answer
        return PeriodAnswer(number, deadline_ns, wake_ns, receive_ns, state, fresh)
    if isinstance(answer, Frame | LogEntry | Raised):
        return answer
    name, wake_ns, signals, state, fresh = answer
    return AxisAnswer(name, wake_ns, *signals, state, fresh)


def recorded_answer(entry: entries.Answer) -> Answer:
    """Return a recorded answer without the instants that the shell adds: when it was computed and sent."""
    if isinstance(entry, entries.AxisRecorded):
        _, name, wake_ns, signals, state, fresh = entry
        return AxisAnswer(name, wake_ns, *signals, state, fresh)
    if isinstance(entry, entries.FrameSent | entries.FrameRefused):
        return entry.frame
    if isinstance(entry, entries.CycleRecorded):
        _, number, deadline_ns, wake_ns, receive_ns, _, _, state, fresh = entry
        return PeriodAnswer(number, deadline_ns, wake_ns, receive_ns, state, fresh)
    return entry.entry


def difference(recorded: Answer, replayed: Answer | None) -> Difference | None:
    """Compare an answer with the core's; returns None if they agree."""
    if type(recorded) is not type(replayed):
        return Difference(recorded, replayed)
    assert replayed is not None
    if recorded == replayed:
        return None
    for field, one, other in zip(recorded._fields, recorded, replayed, strict=True):
        if not _agree(field, one, other):
            return Difference(recorded, replayed, field)
    return None


def _agree(field: str, recorded: object, replayed: object) -> bool:
    """Compare two values of a field; a computed signal may differ by :data:`ROUNDING`."""
    if recorded == replayed:
        return True
    if not isinstance(recorded, float) or not isinstance(replayed, float):
        return False
    if math.isnan(recorded) and math.isnan(replayed):
        return True
    return field in _ROUNDED and abs(recorded - replayed) <= ROUNDING * max(1.0, abs(replayed))


def _in_words(answer: Answer | None, field: str) -> str:
    match answer:
        case None:
            return "nothing"
        case LogEntry(severity, source, text):
            return f"{severity.name.lower()} {source}: {text}"
        case AxisAnswer(axis=axis):
            return f"{axis} {field} {getattr(answer, field)}" if field else f"signals of {axis}"
        case PeriodAnswer(number=number):
            return f"{field} {getattr(answer, field)}" if field else f"period {number}"
        case Deadline(deadline_ns):
            return f"deadline {deadline_ns} ns"
        case Raised(text):
            return f"the exception {text}"
    return str(answer)
