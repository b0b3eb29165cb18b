"""What the gateway reports besides frames: events for people, and a cycle of signals every period."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

from hil.core.frames import Frame


class Severity(IntEnum):
    """Levels of ``rcl_interfaces/msg/Log``, so that viewers colour them."""

    INFO = 20
    WARNING = 30
    ERROR = 40
    FATAL = 50


class LogEntry(NamedTuple):
    """Something a person wants to read. ``source`` is a board, an axis or ``life cycle``."""

    severity: Severity
    source: str
    text: str


class LogThrottle:
    """Keeps what comes with every frame from filling a recording: tells the first few of a kind, then those
    at which its number doubles.
    """

    FIRST = 8

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def should_report(self, kind: str) -> bool:
        """Count one more of ``kind``; whether it is to be told."""
        self._numbers[kind] = number = self._numbers.get(kind, 0) + 1
        return number <= self.FIRST or number.bit_count() == 1

    def forget(self) -> None:
        """Begin anew."""
        self._numbers.clear()


class AxisSignals(NamedTuple):
    """One axis in one period. r, y, e in the axis' unit; voltages in volts."""

    setpoint: float
    position: float
    error: float
    output_v: float
    """u, the control law's output before the limits: offset from the valve's centre."""
    command_v: float
    """The valve voltage that left, after the limits, before quantisation: centre + limited u."""
    potentiometer_v: float


class Cycle(NamedTuple):
    """One period of the core. Instants are on the shell's monotonic clock, in nanoseconds."""

    number: int
    deadline_ns: int
    """When SYNC was due."""
    wake_ns: int
    """The time that ``on_deadline`` was given; SYNC left right after."""
    receive_ns: int
    """The time that ``receive`` was given with the sample; 0 when the period had none."""
    state: int
    """``life_cycle.State`` after the period."""
    fresh: bool
    """Whether a good sample arrived; without one, the last signals are held."""
    axes: tuple[AxisSignals, ...]
    """In the rig file's order."""


class Output(NamedTuple):
    """What a call to the core gives back: frames to send at once, in order, and what to report."""

    frames: tuple[Frame, ...] = ()
    log: tuple[LogEntry, ...] = ()
    cycle: Cycle | None = None
