"""What a call to the gateway core returns: frames, log entries, the signals of a period, and a reply."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from hil.core.frames import Frame
from hil.core.requests import Reply


class Severity(IntEnum):
    """Severity of a log entry.

    The numbers are the levels of ``rcl_interfaces/msg/Log``, so viewers colour them.
    """

    INFO = 20
    WARNING = 30
    ERROR = 40
    FATAL = 50


class LogEntry(NamedTuple):
    """A message for people.

    ``source`` is the part that it is about: a board, an axis, ``bus``, ``life cycle``.
    """

    severity: Severity
    source: str
    text: str


class AxisSignals(NamedTuple):
    """Signals of one axis in one period. Setpoint, position and error are in the axis' unit (m or rad)."""

    setpoint: float
    """Setpoint r."""
    position: float
    """Measured output y."""
    error: float
    """Control error e = r - y."""
    output_v: float
    """Manipulated variable u before the limits, in volts: the offset from the valve's centre voltage."""
    command_v: float
    """Commanded valve voltage in volts, after the limits and before quantisation: centre + limited u."""
    potentiometer_v: float
    """Potentiometer voltage in volts that the position was computed from."""
    phase: int = 0
    """``phase.Phase`` of the experiment on this axis; 0 for an axis that is not excited."""


class Cycle(NamedTuple):
    """One period of the loop. Times are nanoseconds on the shell's monotonic clock."""

    number: int
    """Number of the period. Skipped periods are counted too."""
    deadline_ns: int
    """Time at which SYNC was due."""
    wake_ns: int
    """Time that ``Gateway.on_deadline`` was given. SYNC leaves right after it."""
    receive_ns: int
    """Time that ``Gateway.receive`` was given with the sample; 0 in a period without a good sample."""
    state: int
    """The :class:`~hil.core.life_cycle.LifeCycleState` after the period, as a number."""
    fresh: bool
    """True if a good sample arrived in this period. If False, ``axes`` repeats the last signals."""
    axes: tuple[AxisSignals, ...]
    """Signals of each axis, in the order of the rig file."""


class Output(NamedTuple):
    """Result of one call to the gateway core."""

    frames: tuple[Frame, ...] = ()
    """Frames to send at once, in this order."""
    log: tuple[LogEntry, ...] = ()
    """Log entries to record and show, in this order."""
    cycle: Cycle | None = None
    """The period that this call completed, if it completed one."""
    reply: Reply | None = None
    """Answer to an operator's request; None for every call but ``Gateway.operate``."""


NOTHING = Output()
"""Output of a call that has no effect."""


def combine(*outputs: Output) -> Output:
    """Join outputs in order: frames after frames, log entries after log entries, last cycle, last reply."""
    joined = NOTHING
    for output in outputs:
        if joined is NOTHING:
            joined = output
        elif output is not NOTHING:
            joined = Output(
                joined.frames + output.frames,
                joined.log + output.log,
                output.cycle or joined.cycle,
                output.reply or joined.reply,
            )
    return joined


def answer(axis: str, reply: Reply) -> Output:
    """Return the reply to a request about an axis, which is also a log entry."""
    severity = Severity.INFO if reply.accepted else Severity.WARNING
    return Output(log=(LogEntry(severity, axis, reply.text),), reply=reply)


class LogThrottle:
    """Limits how many log entries of one kind are reported.

    A fault that repeats with every frame would otherwise fill the recording. The first eight entries of a
    kind are reported, then only those whose number is a power of two.
    """

    ALWAYS_REPORTED = 8

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def report(self, severity: Severity, source: str, text: str, kind: str = "") -> Output:
        """Return a log entry, or nothing if enough of its ``kind`` have been reported.

        By default, entries of one severity and source are one kind.
        """
        if not self.should_report(kind or f"{severity} {source}"):
            return NOTHING
        return Output(log=(LogEntry(severity, source, text),))

    def should_report(self, kind: str) -> bool:
        """Count one more entry of ``kind`` and return whether this one is reported."""
        self._counts[kind] = count = self._counts.get(kind, 0) + 1
        return count <= self.ALWAYS_REPORTED or count.bit_count() == 1

    def reset(self) -> None:
        """Set the count of every kind to zero."""
        self._counts.clear()
