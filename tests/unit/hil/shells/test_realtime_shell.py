"""The real-time shell on a clock and a link of the test's own: late wake-ups, failing links, a stop."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from firmware_sim.plants.linear_plant import LinearPlant
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import LinkError, ReplayMismatchError
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.core.output import Cycle, LogEntry, Severity
from hil.core.sample_guard import SampleGuard
from hil.core.wire import codec
from hil.links import Received
from hil.recording.entries import DeadlineCalled, FrameReceived, FrameRefused, FrameSent
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder, RunHeader
from hil.shells import realtime
from hil.shells.replay import verify
from hil.shells.run_plan import CENTRING_PERIODS, Ending, RunPlan, StopRequest
from hil.shells.run_setup import RunSetup, load_setup
from hil.shells.session import Session

PERIOD_NS = 11_200_000
LATENCY_NS = 400_000
RUN_S = 1.0
MOST_REFUSED = 5


class Clock:
    def __init__(self) -> None:
        self.now_ns = 5_000_000_000

    def __call__(self) -> int:
        return self.now_ns

    def sleep(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9)


class LinkToBoards:
    """Simulated boards behind a link; answers take a while, and the test can break it or hold time up."""

    def __init__(self, setup: RunSetup, clock: Clock) -> None:
        self._boards = SimulatedRig(setup.rig, LinearPlant(setup.rig))
        self._clock = clock
        self._waiting: deque[tuple[int, Frame]] = deque()
        self.send_takes_ns = 0
        self.fails_after_sent: int | None = None
        self.fails_after_received: int | None = None
        self.stall_ns: dict[int, int] = {}
        """After so many sent frames, time jumps by so much."""
        self.stall_at_sync_ns: dict[int, int] = {}
        """After so many SYNC frames, time jumps by so much."""
        self.wakes_late_ns: dict[int, int] = {}
        """After so many SYNC frames, waiting in vain takes so much longer than it should."""
        self.babble_at_sync: dict[int, int] = {}
        """After so many SYNC frames, so many frames that nobody knows."""
        self.mended_by_reopening = 10**9
        """Opened anew so often, a link that fails works again."""
        self.refuses: Callable[[Frame], bool] = lambda _frame: False
        self.unreadable_at: dict[int, int] = {}
        """After so many received frames, so many that cannot be read."""
        self.sent = self.received = self.syncs = self.reopened = self.unreadable = 0
        self._push(self._boards.start(clock.now_ns))

    def send(self, frame: Frame) -> bool:
        if self.sent == self.fails_after_sent and self.reopened < self.mended_by_reopening:
            raise LinkError("cannot send: unplugged")
        if self.refuses(frame):
            return False
        self.sent += 1
        self._clock.now_ns += self.send_takes_ns
        self._push(self._boards.receive(frame, self._clock.now_ns))
        if frame.id == codec.SYNC:
            self.syncs += 1
            self._push((Frame(0x7F0),) * self.babble_at_sync.get(self.syncs, 0))
            self._clock.now_ns += self.stall_at_sync_ns.get(self.syncs, 0)
        self._clock.now_ns += self.stall_ns.get(self.sent, 0)
        return True

    def reopen(self) -> None:
        self.reopened += 1
        if self.reopened < self.mended_by_reopening:
            raise LinkError("cannot be opened: unplugged")

    def receive(self, timeout_s: float) -> Received | None:
        self.unreadable += self.unreadable_at.pop(self.received, 0)
        if self.received == self.fails_after_received:
            raise LinkError("cannot receive: unplugged")
        end_ns = self._clock.now_ns + max(round(timeout_s * 1e9), 0)
        if self._boards.next_deadline_ns <= end_ns:
            self._push(self._boards.on_deadline(max(self._boards.next_deadline_ns, self._clock.now_ns)))
        if self._waiting and self._waiting[0][0] <= end_ns:
            arrival_ns, frame = self._waiting.popleft()
            self._clock.now_ns = max(self._clock.now_ns, arrival_ns)
            self.received += 1
            return Received(frame, arrival_ns, "kernel")
        self._clock.now_ns = end_ns + (self.wakes_late_ns.pop(self.syncs, 0) if timeout_s > 0 else 0)
        return None

    def _push(self, frames: tuple[Frame, ...]) -> None:
        self._waiting.extend((self._clock.now_ns + LATENCY_NS, frame) for frame in frames)


class Audience:
    def __init__(self) -> None:
        self.events: list[LogEntry] = []
        self.cycles: list[Cycle] = []

    def log(self, event: LogEntry) -> None:
        self.events.append(event)

    def cycle(self, cycle: Cycle, _gateway: Gateway) -> None:
        self.cycles.append(cycle)


class Bench:
    """One run; ``finish`` gives its recording."""

    def __init__(self, folder: Path, clock: Clock) -> None:
        self.setup = load_setup(None, {}, {})
        self.clock = clock
        self.link = LinkToBoards(self.setup, clock)
        self.stop = StopRequest()
        self.plan = RunPlan(RUN_S, PERIOD_NS / 1e9)
        self.audience = Audience()
        self.path = folder / "run.mcap"
        texts = {name: ("text/plain", text.encode()) for name, text in self.setup.texts.items()}
        setpoints = {name: setpoint.text for name, setpoint in self.setup.setpoints.items()}
        axes = tuple((name, axis.unit) for name, axis in self.setup.rig.axes.items())
        header = RunHeader(10**18, "test", "kernel", axes, texts, {"setpoints": setpoints})
        self._recorder = Recorder(self.path, header, lossless=True)
        self.gateway = self.setup.gateway(clock.now_ns + PERIOD_NS)
        self.session = Session(
            self.gateway, self.plan, self.link.send, clock, self._recorder, self.audience, MOST_REFUSED
        )
        self.error: Exception | None = None

    def run(self) -> Recording:
        self.error = realtime.run(self.session, self.link, self.stop)  # type: ignore[arg-type]
        assert self._recorder.close({}).failure is None
        return Recording(self.path)


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    clock = Clock()
    monkeypatch.setattr(realtime, "monotonic_ns", clock)
    monkeypatch.setattr(realtime, "sleep", clock.sleep)
    yield Bench(tmp_path, clock)


def commands(recording: Recording) -> list[tuple[float, ...]]:
    frames = [call.frame for call in recording.entries() if isinstance(call, FrameSent)]
    return [codec.decode_rpdo1_dac(frame.data)[:3] for frame in frames if frame.id == codec.RPDO1_DAC]


def test_a_run_completes_and_its_recording_verifies(bench: Bench) -> None:
    recording = bench.run()
    assert bench.plan.ending is Ending.COMPLETED
    timing = recording.timing()
    assert sum(timing["state"] == LifeCycleState.RUNNING) == RUN_S * 1e9 // PERIOD_NS + 1
    assert set(timing["wake_ns"] - timing["deadline_ns"]) == {0}
    assert set((timing["receive_ns"] - timing["wake_ns"])[timing["fresh"]]) == {LATENCY_NS}
    assert commands(recording)[-1] == (5.0, 5.0, 5.0)
    assert verify(recording).frames_compared == bench.link.sent


def test_a_stop_request_centres_the_valves(bench: Bench) -> None:
    bench.stop.set()
    recording = bench.run()
    assert bench.plan.ending is Ending.INTERRUPTED
    assert len(recording.timing()) < 10
    assert commands(recording)[-1] == (5.0, 5.0, 5.0)


def test_missed_deadlines_are_skipped_never_caught_up(bench: Bench) -> None:
    bench.link.stall_ns = {100: 30_000_000}
    recording = bench.run()
    assert bench.plan.ending is Ending.COMPLETED
    assert bench.gateway.missed_periods >= 1
    deadlines = [call.deadline_ns for call in recording.entries() if isinstance(call, DeadlineCalled)]
    called = [call.now_ns for call in recording.entries() if isinstance(call, DeadlineCalled)]
    gaps = [later - sooner for sooner, later in pairwise(called)]
    assert sum(gap < PERIOD_NS for gap in gaps) == 1, "one late period, then the grid again"
    assert all((deadline - deadlines[0]) % PERIOD_NS == 0 for deadline in deadlines)
    assert verify(recording).frames_compared == bench.link.sent


def test_a_long_stall_is_a_fault_that_says_what_it_was(bench: Bench) -> None:
    bench.link.stall_ns = {100: 100_000_000}
    recording = bench.run()
    assert bench.plan.ending is Ending.FAULT
    assert bench.gateway.fault_reason is not None
    assert "limit 5 (rig: adc.stale_after_periods)" in bench.gateway.fault_reason
    assert commands(recording)[-1] == (5.0, 5.0, 5.0)
    assert verify(recording).frames_compared == bench.link.sent


def test_an_answer_that_waits_is_taken_before_a_late_deadline(bench: Bench) -> None:
    """Else it would be mistaken for an answer to the next SYNC, and rejected."""
    bench.link.wakes_late_ns = {50: 5_000_000}
    bench.link.stall_at_sync_ns = {51: 8_000_000}
    recording = bench.run()
    assert bench.plan.ending is Ending.COMPLETED
    timing = recording.timing()
    assert list(np.diff(timing["wake_ns"])[49:51]) == [PERIOD_NS + 5_000_000, 8_000_000]
    assert timing["fresh"][timing["state"] == LifeCycleState.RUNNING].all()
    assert bench.gateway.rejected_frames == 0
    assert bench.gateway.missed_periods == 0
    assert verify(recording).frames_compared == bench.link.sent


def test_a_babbling_bus_does_not_put_a_deadline_off(bench: Bench) -> None:
    """So many frames of a backlog, then what is due."""
    bench.link.stall_at_sync_ns = {50: 12_000_000}
    bench.link.babble_at_sync = {50: 3 * realtime.MOST_WAITING_FRAMES}
    recording = bench.run()
    assert bench.plan.ending is Ending.COMPLETED
    kinds = [type(call) for call in recording.entries()]
    begins = [place for place, kind in enumerate(kinds) if kind is DeadlineCalled]
    received = [kinds[start:end].count(FrameReceived) for start, end in pairwise(begins)]
    assert received[49] == realtime.MOST_WAITING_FRAMES
    assert sum(received[49:52]) > 3 * realtime.MOST_WAITING_FRAMES
    assert verify(recording).frames_compared == bench.link.sent


@pytest.mark.parametrize("at", range(100, 106))
def test_a_link_that_fails_to_send_ends_the_run_and_still_verifies(bench: Bench, at: int) -> None:
    """Whichever frame of an answer it takes with it."""
    bench.link.fails_after_sent = at
    recording = bench.run()
    assert bench.plan.ending is Ending.LINK
    assert bench.gateway.fault_reason == "link: cannot send: unplugged"
    assert bench.gateway.state is LifeCycleState.FAULT
    assert verify(recording).frames_compared == bench.link.sent == at


def test_a_link_that_fails_to_receive_ends_the_run_and_still_verifies(bench: Bench) -> None:
    bench.link.fails_after_received = 50
    recording = bench.run()
    assert bench.plan.ending is Ending.LINK
    assert bench.gateway.fault_reason == "link: cannot receive: unplugged"
    assert commands(recording)[-1] == (5.0, 5.0, 5.0)
    assert verify(recording).frames_compared == bench.link.sent


@pytest.mark.parametrize("at", range(100, 106))
def test_a_link_that_works_again_when_opened_anew_centres_the_valves(bench: Bench, at: int) -> None:
    bench.link.fails_after_sent = at
    bench.link.mended_by_reopening = 4
    recording = bench.run()
    assert bench.plan.ending is Ending.LINK
    assert bench.link.reopened == 4
    assert commands(recording)[-CENTRING_PERIODS:] == [(5.0, 5.0, 5.0)] * CENTRING_PERIODS
    assert bench.audience.events[-1].text == "the valves were centred: the command left 3 times"
    assert verify(recording).frames_compared == bench.link.sent > at


def test_a_link_that_stays_away_leaves_the_valves_to_the_watchdog(bench: Bench) -> None:
    bench.link.fails_after_sent = 100
    recording = bench.run()
    assert bench.audience.events[-1] == LogEntry(
        Severity.ERROR,
        "link",
        "the command that centres the valves left 0 times, not 3: the DAC board's watchdog has to centre "
        "them (rig: dac.watchdog_periods)",
    )
    tried_for_ns = bench.clock.now_ns - next(ns for ns, e in recording.log() if e.severity is Severity.FATAL)
    assert 0 <= tried_for_ns - realtime.CENTRING_PATIENCE_NS < 2 * PERIOD_NS


def test_a_link_that_fails_while_a_completed_run_ends_is_no_success(bench: Bench) -> None:
    """The last frames of a run are those that centre the valves."""

    def refuses(_frame: Frame) -> bool:
        if bench.plan.ending is Ending.COMPLETED:
            raise LinkError("cannot send: unplugged")
        return False

    bench.link.refuses = refuses
    recording = bench.run()
    assert bench.plan.ending is Ending.LINK
    assert verify(recording).frames_compared == bench.link.sent


def refused(recording: Recording) -> int:
    return sum(isinstance(entry, FrameRefused) for entry in recording.entries())


def test_a_frame_that_a_full_queue_refuses_is_not_recorded_as_sent(bench: Bench) -> None:
    """It is told, and the run goes on: at the next period the command is another."""
    asked: list[Frame] = []

    def refuses(frame: Frame) -> bool:
        asked.append(frame)
        number = sum(one.id == codec.RPDO1_DAC for one in asked)
        return frame.id == codec.RPDO1_DAC and number in (40, 41, 43, 60)

    bench.link.refuses = refuses
    recording = bench.run()
    assert bench.plan.ending is Ending.COMPLETED
    assert refused(recording) == 4
    assert len(asked) == bench.link.sent + 4
    told = [event.text for event in bench.audience.events if event.source == "link"]
    assert told[0].startswith("the bus took no frame, its queue is full: ")
    assert told[-1].endswith("4 frames not sent so far")
    assert verify(recording).frames_compared == bench.link.sent


def test_a_frame_recorded_as_not_sent_is_compared_too(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.link.refuses = lambda frame: frame.id == codec.HEARTBEAT_GATEWAY
    frame_refused = Recorder.frame_refused
    monkeypatch.setattr(Recorder, "frame_refused", lambda self, f, ns: frame_refused(self, Frame(f.id), ns))
    recording = bench.run()
    with pytest.raises(ReplayMismatchError, match=r"recorded 701#, the core sends 701#05"):
        verify(recording)


def test_commands_refused_in_a_row_are_a_failed_link(bench: Bench) -> None:
    """The valves would hold for good, and the plant run away."""
    bench.link.refuses = lambda frame: bench.link.syncs > 60 and frame.id == codec.RPDO1_DAC
    recording = bench.run()
    assert bench.plan.ending is Ending.LINK
    assert bench.gateway.fault_reason is not None
    assert bench.gateway.fault_reason.startswith(
        "link: 5 valve commands in a row were not sent, limit 5 (rig: adc.stale_after_periods)"
    )
    assert bench.link.syncs < 60 + MOST_REFUSED + realtime.CENTRING_PATIENCE_NS // PERIOD_NS + 3
    assert refused(recording) > MOST_REFUSED
    assert verify(recording).frames_compared == bench.link.sent


def test_unreadable_frames_are_told_when_their_number_has_doubled(bench: Bench) -> None:
    bench.link.unreadable_at = {20: 1, 30: 1, 40: 1, 50: 7, 60: 1}
    recording = bench.run()
    told = [event.text for _, event in recording.log() if event.source == "link"]
    assert [text.split()[0] for text in told] == ["1", "2", "10"]
    assert verify(recording).frames_compared == bench.link.sent


class TestAnInternalError:
    """Wherever it comes from, it is a FATAL event, and the valves are centred."""

    def check(self, bench: Bench, error: type[Exception]) -> None:
        recording = bench.run()
        assert isinstance(bench.error, error)
        assert bench.plan.ending is Ending.ERROR
        assert commands(recording)[-CENTRING_PERIODS:] == [(5.0, 5.0, 5.0)] * CENTRING_PERIODS
        told = recording.log()[-1][1]
        assert told.severity is Severity.FATAL
        assert told.text == f"internal error, the run was ended: {error.__name__}: {bench.error}"
        assert verify(recording).frames_compared == bench.link.sent

    def test_of_the_link(self, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        receive = bench.link.receive

        def failing(timeout_s: float) -> Received | None:
            if bench.link.received == 100:
                raise KeyError("channel")
            return receive(timeout_s)

        monkeypatch.setattr(bench.link, "receive", failing)
        self.check(bench, KeyError)

    def test_of_the_recorder(self, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        received = bench.link.receive

        def strange(timeout_s: float) -> Received | None:
            message = received(timeout_s)
            if message is None or bench.link.received != 100:
                return message
            return message._replace(frame=Frame(1.5))  # type: ignore[arg-type]

        monkeypatch.setattr(bench.link, "receive", strange)
        self.check(bench, struct.error)

    def test_of_the_core_which_replay_repeats(self, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        check = SampleGuard.check

        def failing(guard: SampleGuard, data: bytes, now_ns: int) -> list[float] | str:
            if data[6] == 50:
                raise ZeroDivisionError("float division by zero")
            return check(guard, data, now_ns)

        monkeypatch.setattr(SampleGuard, "check", failing)
        self.check(bench, ZeroDivisionError)
        monkeypatch.undo()
        with pytest.raises(ReplayMismatchError, match="the core sends"):
            verify(Recording(bench.path))

    def test_of_a_send_within_an_answer(self, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        send = bench.link.send

        def failing(frame: Frame) -> bool:
            if bench.link.sent == 101:
                bench.link.sent += 1
                raise TypeError("an integer is required")
            return send(frame)

        monkeypatch.setattr(bench.session, "_send", failing)
        recording = bench.run()
        assert isinstance(bench.error, TypeError)
        assert commands(recording)[-1] == (5.0, 5.0, 5.0)
        assert verify(recording).frames_compared == bench.link.sent - 1


def test_a_command_is_sent_when_the_link_has_taken_it(bench: Bench) -> None:
    bench.link.send_takes_ns = 30_000
    recording = bench.run()
    running = recording.timing()[recording.timing()["state"] == LifeCycleState.RUNNING]
    assert set(running["sent_ns"] - running["computed_ns"]) == {30_000}
    assert set(running["sent_ns"]) <= set(recording.frames("sent", codec.RPDO1_DAC).time_ns)
    assert set(running["wake_ns"] + 30_000) <= set(recording.frames("sent", codec.SYNC).time_ns)


def test_people_are_told_of_every_event_and_period_and_of_the_recorders_troubles(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    note = LogEntry(Severity.INFO, "rights", "granted: nothing")
    news = LogEntry(Severity.ERROR, "recorder", "recording ended: No space left on device")
    handed_over = iter([None] * 50 + [news])
    real_hand_over = Recorder.hand_over

    def hand_over(recorder: Recorder) -> LogEntry | None:
        real_hand_over(recorder)
        return next(handed_over, None)

    monkeypatch.setattr(Recorder, "hand_over", hand_over)
    bench.session.note(note)
    recording = bench.run()
    recorded = [event for _, event in recording.log()]
    assert note in recorded
    assert [event for event in bench.audience.events if event != news] == recorded
    assert bench.audience.events.count(news) == 1
    assert [cycle.number for cycle in bench.audience.cycles] == list(recording.timing()["number"])
    report = verify(recording)
    assert report.frames_compared == bench.link.sent
    assert report.log_entries_compared == len(recorded) - 1, "the core gave no rights"
    assert report.periods_compared == len(recording.timing())
