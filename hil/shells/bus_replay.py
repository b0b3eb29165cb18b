"""Replay onto a bus: sends the recorded frames of one side at their original instants.

Each frame has an absolute deadline, so that the error of one does not move the next. Before a deadline the
replay waits for frames of other nodes, which also empties the receive queue, and in the last fraction of a
millisecond it polls the clock: a process that sleeps wakes up too late.
"""

from __future__ import annotations

import contextlib
from array import array
from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from time import monotonic_ns
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from hil.core.errors import LinkError, RecordingError
from hil.core.foreign_frames import COMMANDS_TO_BOARDS, OWN_IDENTIFIERS
from hil.core.frames import Frame
from hil.core.rig import Rig
from hil.core.valve_commands import ValveCommands, command_crc
from hil.core.wire import codec
from hil.core.wire.frame_crc import FrameCrc
from hil.links.link import Received
from hil.recording.reader import Recording
from hil.recording.tables import FrameTable
from hil.shells.run_plan import CENTRING_PERIODS, StopRequest

MIN_POLLING_NS, MAX_POLLING_NS = 200_000, 2_000_000
"""Shortest and longest time before a deadline in which the clock is polled.

Between them it follows the machine: one and a half times the latest late wake-ups.
"""
MAX_WAIT_NS = 100_000_000
"""Longest wait after which a request to stop is looked at."""
REPORT_INTERVAL_NS = 1_000_000_000
"""Time from one report of progress to the next."""


class Side(StrEnum):
    """Side of the bus whose frames are sent."""

    BOARDS = "boards"
    GATEWAY = "gateway"


class Schedule:
    """Frames and the instants at which they are due, in ns from the begin of the replay."""

    def __init__(
        self,
        table: FrameTable,
        begin_ns: int,
        first: Sequence[Frame] = (),
        answers: Sequence[Frame] = (),
        left_out: int = 0,
    ) -> None:
        """``begin_ns`` is the instant of the recording at which the replay begins."""
        self.due_ns: npt.NDArray[np.int64] = table.time_ns - begin_ns
        self.left_out = left_out
        """Number of recorded frames that are not sent: error frames, and commands of other masters."""
        self.first = first
        """Frames that are sent before all others: the start of boards that were started earlier."""
        self.answers = answers
        """Samples that are sent in answer to SYNC, one for each, instead of at their instants."""
        self._table = table

    def __len__(self) -> int:
        return len(self.due_ns)

    def frames(self) -> Iterator[tuple[int, Frame]]:
        """Yield each frame with the instant at which it is due."""
        for row, frame in _frames(self._table):
            yield int(self.due_ns[row]), frame

    @property
    def loop_ns(self) -> int:
        """Duration of one round of an endless replay: the last frame is followed by one usual interval."""
        identifiers, counts = np.unique(self._table.id, return_counts=True)
        usual = self.due_ns[self._table.id == identifiers[np.argmax(counts)]]
        interval_ns = int(np.median(np.diff(usual))) if len(usual) > 1 else REPORT_INTERVAL_NS
        return int(self.due_ns[-1]) + max(interval_ns, 1_000_000)


def schedule_of(
    recording: Recording,
    side: Side,
    from_s: float | None = None,
    to_s: float | None = None,
    *,
    answer_sync: bool = False,
) -> Schedule:
    """Return the frames that one side sent from ``from_s`` to ``to_s``, in seconds from the first period.

    The boards' side leaves out what only a gateway may send, so that it cannot move a valve. The gateway's
    side begins with the NMT commands from before ``from_s``, because the boards act only when operational.
    With ``answer_sync``, the samples of the boards' side wait for SYNC. Raises RecordingError when there is
    no frame with an instant of its own.
    """
    table = recording.between(from_s, to_s).frames("received" if side is Side.BOARDS else "sent")
    sendable = ~table.is_error
    if side is Side.BOARDS:
        commands = np.isin(table.id, [*OWN_IDENTIFIERS, *COMMANDS_TO_BOARDS])
        sendable &= ~commands | table.is_extended
    is_sample = (table.id == codec.TPDO1_ADC) & ~table.is_extended & ~table.is_remote
    waiting = sendable & is_sample & (answer_sync and side is Side.BOARDS)
    timed = table[sendable & ~waiting]
    if len(timed) == 0:
        raise RecordingError(
            f"{recording.path}: has no frame of the {side} to send"
            + ("" if from_s is None and to_s is None else " in this range; see --from and --to")
        )
    first: list[Frame] = []
    begin_ns = int(timed.time_ns[0])
    if from_s is not None:
        begin_ns = min(begin_ns, recording.start_ns + round(from_s * 1e9))
        if side is Side.GATEWAY:
            first = _nmt_commands(recording.between(None, from_s).frames("sent", codec.NMT))
    answers = [frame for _, frame in _frames(table[waiting])]
    return Schedule(timed, begin_ns, first, answers, int(np.count_nonzero(~sendable)))


def _frames(table: FrameTable) -> Iterator[tuple[int, Frame]]:
    """Yield the frames of a table with their row numbers."""
    for row in range(len(table)):
        data = table.data[row, : table.length[row]].tobytes()
        yield row, Frame(int(table.id[row]), data, bool(table.is_extended[row]), bool(table.is_remote[row]))


def _nmt_commands(table: FrameTable) -> list[Frame]:
    """Return each NMT command once, in the order of the last time that it was sent."""
    rows = {frame: row for row, frame in _frames(table)}
    return sorted(rows, key=rows.__getitem__)


def fresh_samples(wire_version: int) -> Callable[[Frame], Frame]:
    """Return a function that gives each sample (TPDO1) the next counter and its CRC; other frames pass."""
    counter = -1
    crc = FrameCrc(codec.TPDO1_ADC, wire_version)

    def fresh(frame: Frame) -> Frame:
        nonlocal counter
        if frame.id != codec.TPDO1_ADC or frame.is_extended or len(frame.data) != codec.TPDO1_ADC_LENGTH:
            return frame
        counter = (counter + 1) & 0xFF
        return Frame(frame.id, crc.append(frame.data[:6] + bytes((counter,))))

    return fresh


class Bus(Protocol):
    """The part of a link that a replay uses; see :class:`hil.links.link.Link`."""

    def send(self, frame: Frame) -> bool:
        """Hand over a frame; False if a full queue refuses it."""

    def receive(self, timeout_s: float) -> Received | None:
        """Return the next frame of another node, or None after the timeout."""


class TimingError(NamedTuple):
    """Time from the deadlines of frames to the instants at which the bus had taken them, in ms."""

    p50_ms: float
    p99_ms: float
    worst_ms: float

    def __str__(self) -> str:
        return f"p50 {self.p50_ms:.3f} ms, p99 {self.p99_ms:.3f} ms, worst {self.worst_ms:.3f} ms"


class BusReplay:
    """One replay: sends a schedule, and measures its timing."""

    def __init__(
        self,
        bus: Bus,
        schedule: Schedule,
        *,
        speed: float = 1.0,
        change: Callable[[Frame], Frame] = lambda frame: frame,
        clock_ns: Callable[[], int] = monotonic_ns,
        watch: Callable[[float, float], None] = lambda time_s, worst_ms: None,
    ) -> None:
        """``change`` is applied to every frame before it is sent. ``watch`` is called about once a second
        with the time of the replay in seconds and the worst timing error since the last call in ms.
        """
        self._bus = bus
        self._schedule = schedule
        self._speed = speed
        self._change = change
        self._clock_ns = clock_ns
        self._watch = watch
        self._polling_ns = MIN_POLLING_NS
        self._answers = iter(schedule.answers)
        self._late_ns = array("q")
        self._watched = 0
        self._watched_ns = 0
        self.sent = self.refused = self.received = self.answered = 0
        """Number of frames that were sent, that a full queue refused, that other nodes sent meanwhile, and of
        SYNCs that were answered.
        """
        self.last_counter: int | None = None
        """Counter in the last valve command that was sent; None without one."""

    def run(self, stop: StopRequest, *, endless: bool = False) -> bool:
        """Send all frames, again and again if ``endless``; return False if ``stop`` ended it.

        Raises LinkError when the bus fails.
        """
        begin_ns = self._clock_ns()
        for frame in self._schedule.first:
            self._send(frame)
        round_ns = round(self._schedule.loop_ns / self._speed) if endless else 0
        self._watched_ns = begin_ns = max(begin_ns, self._clock_ns())
        while True:
            for due_ns, frame in self._schedule.frames():
                at_ns = begin_ns + round(due_ns / self._speed)
                changed = self._change(frame)
                if not self._wait_until(at_ns, stop):
                    return False
                self._send(changed)
                now_ns = self._clock_ns()
                self._late_ns.append(now_ns - at_ns)
                if now_ns - self._watched_ns >= REPORT_INTERVAL_NS:
                    self._report(now_ns, begin_ns)
            if not endless:
                return True
            begin_ns += round_ns
            self._answers = iter(self._schedule.answers)

    def timing_error(self) -> TimingError:
        """Return the timing error of all frames that were due."""
        late_ms = np.asarray(self._late_ns, np.float64) * 1e-6
        if len(late_ms) == 0:
            return TimingError(0.0, 0.0, 0.0)
        p50, p99 = np.percentile(late_ms, (50, 99))
        return TimingError(float(p50), float(p99), float(late_ms.max()))

    def centre(self, rig: Rig) -> int:
        """Send the command that centres the valves, with SYNC to apply it; return how often it was sent."""
        valves = ValveCommands(
            [axis.valve for axis in rig.axes.values()], rig.loop.period_s, command_crc(rig)
        )
        if self.last_counter is not None:
            for _ in range(self.last_counter + 1):
                valves.frame()  # the counter of the next one follows the last that was sent
        sent = 0
        for _ in range(CENTRING_PERIODS):
            sent += self._bus.send(valves.frame())
            self._bus.send(Frame(codec.SYNC))
            self._wait_until(self._clock_ns() + rig.loop.period_ns, StopRequest())
        return sent

    def _send(self, frame: Frame) -> None:
        if self._bus.send(frame):
            self.sent += 1
            is_command = frame.id == codec.RPDO1_DAC and not frame.is_extended
            if is_command and len(frame.data) == codec.RPDO1_DAC_LENGTH:
                self.last_counter = frame.data[6]
        else:
            self.refused += 1

    def _wait_until(self, at_ns: int, stop: StopRequest) -> bool:
        """Receive frames until shortly before ``at_ns``, then poll the clock; return False to stop."""
        while True:
            if stop.is_set:
                return False
            wait_ns = at_ns - self._polling_ns - self._clock_ns()
            if wait_ns <= 0:
                break
            target_ns = self._clock_ns() + min(wait_ns, MAX_WAIT_NS)
            received = self._bus.receive(min(wait_ns, MAX_WAIT_NS) * 1e-9)
            if received is not None:
                self._take(received.frame)
            else:
                self._adapt_polling(self._clock_ns() - target_ns)
        while self._clock_ns() < at_ns:
            pass
        return True

    def _take(self, frame: Frame) -> None:
        """Count a frame of another node, and answer it if it is a SYNC and samples wait for one."""
        self.received += 1
        if frame.id != codec.SYNC or frame.is_extended or frame.is_remote or frame.is_error:
            return
        sample = next(self._answers, None)
        if sample is not None:
            self.answered += 1
            self._send(self._change(sample))

    def _adapt_polling(self, overslept_ns: int) -> None:
        """Poll for longer at once after a late wake-up, and for less again little by little."""
        wanted_ns = max(overslept_ns * 3 // 2, self._polling_ns * 31 // 32)
        self._polling_ns = min(max(wanted_ns, MIN_POLLING_NS), MAX_POLLING_NS)

    def _report(self, now_ns: int, begin_ns: int) -> None:
        recent_ns = self._late_ns[self._watched :]
        self._watched, self._watched_ns = len(self._late_ns), now_ns
        self._watch((now_ns - begin_ns) * 1e-9 * self._speed, max(recent_ns) * 1e-6)


def centre_after(replay: BusReplay, rig: Rig, reopen: Callable[[], None]) -> int:
    """Centre the valves after a replay of the gateway's side; return how often the command was sent.

    A bus that fails is opened again by ``reopen``, once. If it is gone, the DAC board's watchdog centres the
    valves.
    """
    with contextlib.suppress(LinkError):
        return replay.centre(rig)
    with contextlib.suppress(LinkError):
        reopen()
        return replay.centre(rig)
    return 0
