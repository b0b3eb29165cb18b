"""Runs made of given signals, and recorded; in memory where only the file counts, not the process."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event as Waiter
from time import monotonic
from unittest import mock

from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import AxisSignals, Cycle, LogEntry, Severity
from hil.recording.direct_writer import DirectWriter
from hil.recording.handover import RunHeader
from hil.recording.recorder import Recorder
from support.constants import PERIOD_NS, PERIOD_S

EPOCH_OFFSET_NS = 1_700_000_000_000_000_000
START_NS = 5_000_000_000
AXES = (("vertical", "m"), ("horizontal", "m"), ("rotation", "rad"))
RUN_HEADER = RunHeader(
    epoch_offset_ns=EPOCH_OFFSET_NS,
    bus="vcan0",
    stamp_origin="kernel",
    axes=AXES,
    attachments={
        "rig.toml": ("application/toml", b"[loop]\nperiod_s = 0.0112\n"),
        "arm.dbc": ("text/plain", b""),
    },
    metadata={"run": {"hil": "0.1.0"}, "setpoints": {"vertical": "step:0.1@1"}},
)
CENTRED = AxisSignals(0.0, 0.0, 0.0, 0.0, 5.0, 5.0)
SYNC = Frame(0x080)

Signals = Callable[[float], AxisSignals]
"""Function that returns an axis' signals at t seconds of the run."""


def following(setpoint: Callable[[float], float], position: Callable[[float], float]) -> Signals:
    """Return the signals of an axis with a given position and a proportional controller of 10 V per unit."""

    def at(t: float) -> AxisSignals:
        r, y = setpoint(t), position(t)
        return AxisSignals(r, y, r - y, 10.0 * (r - y), 5.0 + 10.0 * (r - y), 5.0 + 30.0 * y)

    return at


def step(size: float, at_s: float) -> Callable[[float], float]:
    return lambda t: size if t >= at_s else 0.0


def lag(size: float, at_s: float, tau_s: float) -> Callable[[float], float]:
    """Return the step response of a first-order lag: it settles to 2 % in tau ln 50 and never overshoots."""
    return lambda t: size * -math.expm1(-max(t - at_s, 0.0) / tau_s)


TENTH_STEP = following(step(0.1, 1.0), lag(0.1, 1.0, 0.2))


def record_periods(
    recorder: Recorder,
    periods: int,
    signals: Signals = TENTH_STEP,
    *,
    first: int = 0,
    state: LifeCycleState = LifeCycleState.RUNNING,
    axes: int = len(AXES),
    lateness_ns: Callable[[int], int] = lambda number: 100_000,
    response_ns: Callable[[int], int] = lambda number: 400_000,
    sync_ns: int = 0,
) -> list[LogEntry]:
    """Record periods as a live shell does, with the same signals on all axes.

    ``lateness_ns``: time from deadline to wake-up; ``sync_ns``, ``response_ns``: time from wake-up to SYNC
    and to the command. Returns the log entries of the recorder.
    """
    log = []
    for number in range(first, first + periods):
        deadline_ns = START_NS + number * PERIOD_NS
        wake_ns = deadline_ns + lateness_ns(number)
        sent_ns = wake_ns + response_ns(number)
        receive_ns = (wake_ns + sent_ns) // 2
        recorder.deadline_called(deadline_ns, wake_ns)
        recorder.frame_sent(SYNC, wake_ns + sync_ns)
        sample = Frame(0x190, number.to_bytes(8, "little", signed=True))
        recorder.frame_received(sample, receive_ns, receive_ns + EPOCH_OFFSET_NS - 30_000)
        recorder.frame_sent(Frame(0x220, number.to_bytes(6, "big", signed=True)), sent_ns)
        same = (signals(number * PERIOD_S),) * axes
        cycle = Cycle(number, deadline_ns, wake_ns, receive_ns, state, True, same)
        recorder.cycle(cycle, receive_ns + 50_000, sent_ns)
        entry = recorder.hand_over()
        if entry is not None:
            log.append(entry)
    return log


def record_run(
    path: Path, periods: int, signals: Signals = TENTH_STEP, header: RunHeader = RUN_HEADER
) -> None:
    """Record a run in memory: three periods armed, ``periods`` running, three armed, then the link fails."""
    with in_memory(path):
        recorder = Recorder(path, header, lossless=True)
    recorder.operated(Trigger.START, START_NS - 4 * PERIOD_NS)
    record_periods(recorder, 3, lambda t: CENTRED, first=-3, state=LifeCycleState.ARMED)
    recorder.log_entry(LogEntry(Severity.INFO, "life cycle", "armed -> running (start)"), START_NS)
    record_periods(recorder, periods, signals)
    recorder.operated(Trigger.STOP, START_NS + periods * PERIOD_NS)
    record_periods(recorder, 3, lambda t: CENTRED, first=periods, state=LifeCycleState.ARMED)
    end_ns = START_NS + (periods + 3) * PERIOD_NS
    recorder.frame_refused(SYNC, end_ns)
    recorder.link_failed("Network is down", end_ns)
    recorder.close({"ending": {"reason": "completed"}})


def in_memory(path: Path) -> mock._patch[Callable[..., DirectWriter]]:
    """Let recorders write to ``path`` themselves when they are closed: the same bytes, without a process."""
    return mock.patch("hil.recording.recorder.RecorderPipe", DirectWriter)


def children_of(process_id: int) -> Sequence[int]:
    """Return the process ids of the children."""
    return [int(text) for text in Path(f"/proc/{process_id}/task/{process_id}/children").read_text().split()]


def wait_until(condition: Callable[[], bool], what: str, timeout_s: float = 20.0) -> None:
    """Wait until ``condition`` holds; fail when it does not within ``timeout_s``."""
    deadline_s = monotonic() + timeout_s
    waiter = Waiter()
    while not condition():
        assert monotonic() < deadline_s, f"{what}: not within {timeout_s} s"
        waiter.wait(0.01)
