"""The real-time shell on a simulated clock and link: late wake-ups, failing links, a stop request."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.constants import CENTRED, PERIOD_NS, PERIOD_S
from support.gateway_bench import rig_text

from firmware_sim.plants.linear_plant import LinearPlant
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import LinkError, ReplayMismatchError
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.core.output import Cycle, LogEntry, Severity
from hil.core.rig import VOLTS_PER_COUNT
from hil.core.sample_guard import SampleGuard, Verdict
from hil.core.wire import codec
from hil.links import Received
from hil.recording.entries import DeadlineCalled, FrameReceived, FrameRefused, FrameSent
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder, RunHeader
from hil.shells import realtime
from hil.shells.lead_time import FIRST_REHEARSAL_NS
from hil.shells.realtime import NO_POLLING, Polling
from hil.shells.replay import verify
from hil.shells.run_plan import CENTRING_PERIODS, Ending, RunPlan, StopRequest
from hil.shells.run_setup import RunSetup, load_setup
from hil.shells.session import Session

LATENCY_NS = 400_000
RUN_S = 1.0
MAX_REFUSED = 5


class Clock:
    def __init__(self) -> None:
        self.now_ns = 5_000_000_000
        self.reading_takes_ns = 0

    def __call__(self) -> int:
        self.now_ns += self.reading_takes_ns
        return self.now_ns

    def sleep(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9)


class LinkToBoards:
    """Simulated boards behind a link with latency. A test can make the link fail, or let time jump."""

    def __init__(self, setup: RunSetup, clock: Clock) -> None:
        self._boards = SimulatedRig(setup.rig, LinearPlant(setup.rig))
        self._clock = clock
        self._waiting: deque[tuple[int, Frame]] = deque()
        self.send_takes_ns = 0
        self.latency_ns = LATENCY_NS
        self.stall_while_polling_ns: dict[int, int] = {}
        """Time jumps: after which number of SYNC frames a look at the link takes longer, by how much."""
        self.fails_after_sent: int | None = None
        self.fails_after_received: int | None = None
        self.stall_ns: dict[int, int] = {}
        """Time jumps: after which number of sent frames, by how much."""
        self.stall_at_sync_ns: dict[int, int] = {}
        """Time jumps: after which number of SYNC frames, by how much."""
        self.wakes_late_ns: dict[int, int] = {}
        """Late wake-ups: after which number of SYNC frames a timeout lasts longer, by how much."""
        self.babble_at_sync: dict[int, int] = {}
        """Unknown frames: after which number of SYNC frames, how many."""
        self.works_after_reopening = 10**9
        """How often a failed link must be opened again before it works."""
        self.refuses: Callable[[Frame], bool] = lambda _frame: False
        self.unreadable_at: dict[int, int] = {}
        """Unreadable frames: after which number of received frames, how many."""
        self.sent = self.received = self.syncs = self.reopened = self.unreadable = 0
        self._push(self._boards.start(clock.now_ns))

    def send(self, frame: Frame) -> bool:
        if self.sent == self.fails_after_sent and self.reopened < self.works_after_reopening:
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
        if self.reopened < self.works_after_reopening:
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
        if timeout_s == 0.0:
            self._clock.now_ns += self.stall_while_polling_ns.pop(self.syncs, 0)
            return None
        self._clock.now_ns = end_ns + (self.wakes_late_ns.pop(self.syncs, 0) if timeout_s > 0 else 0)
        return None

    def _push(self, frames: tuple[Frame, ...]) -> None:
        self._waiting.extend((self._clock.now_ns + self.latency_ns, frame) for frame in frames)


class Listener:
    def __init__(self) -> None:
        self.entries: list[LogEntry] = []
        self.cycles: list[Cycle] = []

    def log(self, entry: LogEntry) -> None:
        self.entries.append(entry)

    def cycle(self, cycle: Cycle, _gateway: Gateway) -> None:
        self.cycles.append(cycle)


class Bench:
    """One run in real time, simulated. ``run`` returns its recording."""

    def __init__(self, folder: Path, clock: Clock, setup: RunSetup) -> None:
        self.setup = setup
        self.clock = clock
        self.link = LinkToBoards(self.setup, clock)
        self.stop = StopRequest()
        self.plan = RunPlan(RUN_S, PERIOD_S)
        self.observer = Listener()
        self.path = folder / "run.mcap"
        texts = {name: ("text/plain", text.encode()) for name, text in self.setup.texts.items()}
        setpoints = {name: setpoint.text for name, setpoint in self.setup.setpoints.items()}
        axes = tuple((name, axis.unit) for name, axis in self.setup.rig.axes.items())
        header = RunHeader(10**18, "test", "kernel", axes, texts, {"setpoints": setpoints})
        self._recorder = Recorder(self.path, header, lossless=True)
        self.gateway = self.setup.gateway(clock.now_ns + PERIOD_NS)
        self.session = Session(
            self.gateway, self.plan, self.link.send, clock, self._recorder, self.observer, MAX_REFUSED
        )
        self.error: Exception | None = None
        self.polling = NO_POLLING

    def run(self) -> Recording:
        self.error = realtime.run(self.session, self.link, self.stop, polling=self.polling)  # type: ignore[arg-type]
        assert self._recorder.close({}).failure is None
        return Recording(self.path)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    simulated = Clock()
    monkeypatch.setattr(realtime, "monotonic_ns", simulated)
    monkeypatch.setattr(realtime, "sleep", simulated.sleep)
    return simulated


@pytest.fixture
def bench(tmp_path: Path, clock: Clock) -> Bench:
    return Bench(tmp_path, clock, load_setup(None, {}, {}))


@pytest.fixture
def slow_valve_bench(tmp_path: Path, clock: Clock) -> Bench:
    """A bench whose vertical valve may move by 25 V/s, 0.28 V in a period, with a step at 0.2 s."""
    rig = tmp_path / "rig.toml"
    changes = {"axes.vertical.valve.max_rate_v_s": "25.0", "adc.stale_after_periods": "5"}
    rig.write_text(rig_text(changes))
    return Bench(tmp_path, clock, load_setup(rig, {}, {"vertical": "step:0.15@0.2"}))


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
    assert commands(recording)[-1] == CENTRED
    assert verify(recording).frames_compared == bench.link.sent


def test_a_stop_request_centres_the_valves(bench: Bench) -> None:
    bench.stop.set()
    recording = bench.run()
    assert bench.plan.ending is Ending.INTERRUPTED
    assert len(recording.timing()) < 10
    assert commands(recording)[-1] == CENTRED


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


def test_a_long_stall_is_a_fault_that_names_the_limit(bench: Bench) -> None:
    bench.link.stall_ns = {100: 100_000_000}
    recording = bench.run()
    assert bench.plan.ending is Ending.FAULT
    assert bench.gateway.fault_reason is not None
    assert "limit 5 (rig: adc.stale_after_periods)" in bench.gateway.fault_reason
    assert commands(recording)[-1] == CENTRED
    assert verify(recording).frames_compared == bench.link.sent


def test_a_waiting_answer_is_read_before_a_late_deadline(bench: Bench) -> None:
    """Otherwise it would be taken for an answer to the next SYNC, and rejected."""
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


def test_a_babbling_bus_does_not_delay_a_deadline(bench: Bench) -> None:
    """At most 64 waiting frames are read before a deadline that is due."""
    bench.link.stall_at_sync_ns = {50: 12_000_000}
    bench.link.babble_at_sync = {50: 3 * realtime.MAX_WAITING_FRAMES}
    recording = bench.run()
    assert bench.plan.ending is Ending.COMPLETED
    kinds = [type(call) for call in recording.entries()]
    begins = [place for place, kind in enumerate(kinds) if kind is DeadlineCalled]
    received = [kinds[start:end].count(FrameReceived) for start, end in pairwise(begins)]
    assert received[49] == realtime.MAX_WAITING_FRAMES
    assert sum(received[49:52]) > 3 * realtime.MAX_WAITING_FRAMES
    assert verify(recording).frames_compared == bench.link.sent


class TestPolling:
    """Shortly before a deadline, the loop polls the clock and the link instead of sleeping."""

    POLL_NS = 150_000
    READING_NS = 1_000

    @pytest.fixture
    def polling_bench(self, bench: Bench) -> Bench:
        bench.polling = Polling(self.POLL_NS)
        bench.clock.reading_takes_ns = self.READING_NS
        return bench

    def lateness_ns(self, recording: Recording) -> np.ndarray:
        timing = recording.timing()
        lateness: np.ndarray = timing["wake_ns"] - timing["deadline_ns"]
        return lateness

    def test_late_wake_ups_within_the_polling_time_make_no_late_sync(self, polling_bench: Bench) -> None:
        polling_bench.link.wakes_late_ns = dict.fromkeys(range(1000), self.POLL_NS - 10_000)
        recording = polling_bench.run()
        assert polling_bench.plan.ending is Ending.COMPLETED
        assert self.lateness_ns(recording).min() >= 0
        assert self.lateness_ns(recording).max() <= self.READING_NS
        assert verify(recording).frames_compared == polling_bench.link.sent

    def test_a_wake_up_that_is_later_is_served_at_once(self, polling_bench: Bench) -> None:
        polling_bench.link.wakes_late_ns = {50: self.POLL_NS + 300_000}
        recording = polling_bench.run()
        assert polling_bench.plan.ending is Ending.COMPLETED
        assert sorted(self.lateness_ns(recording))[-2] <= self.READING_NS
        assert 0 <= self.lateness_ns(recording).max() - 300_000 <= 4 * self.READING_NS

    def test_a_frame_that_arrives_while_polling_is_served_before_the_deadline(
        self, polling_bench: Bench
    ) -> None:
        arrives_before_ns = 60_000
        polling_bench.link.latency_ns = PERIOD_NS - arrives_before_ns
        recording = polling_bench.run()
        assert polling_bench.plan.ending is Ending.COMPLETED
        timing = recording.timing()
        left_ns = (timing["deadline_ns"] + PERIOD_NS - timing["receive_ns"])[timing["fresh"]]
        assert left_ns.min() > 0
        assert left_ns.max() <= arrives_before_ns
        assert sum(timing["fresh"]) > 50
        assert verify(recording).frames_compared == polling_bench.link.sent

    def test_after_a_stall_while_polling_frames_that_wait_are_read_first(self, polling_bench: Bench) -> None:
        polling_bench.link.stall_while_polling_ns = {50: 3_000_000}
        polling_bench.link.latency_ns = PERIOD_NS - 20_000
        recording = polling_bench.run()
        assert polling_bench.plan.ending is Ending.COMPLETED
        assert self.lateness_ns(recording).max() > 2_500_000
        calls = [call for call in recording.entries() if isinstance(call, FrameReceived | DeadlineCalled)]
        late = next(
            place
            for place, call in enumerate(calls)
            if isinstance(call, DeadlineCalled) and call.now_ns - call.deadline_ns > 2_500_000
        )
        waited = calls[late - 1]
        assert isinstance(waited, FrameReceived)
        assert waited.frame.id == codec.TPDO1_ADC
        assert waited.now_ns <= calls[late].now_ns
        assert verify(recording).frames_compared == polling_bench.link.sent

    def leads_ns(self, recording: Recording, began_ns: list[int]) -> np.ndarray:
        """Return for each deadline the time since the last rehearsal began."""
        deadlines_ns = recording.timing()["deadline_ns"]
        before = np.searchsorted(began_ns, deadlines_ns) - 1
        assert before.min() >= 0
        leads: np.ndarray = deadlines_ns - np.array(began_ns)[before]
        return leads

    def rehearse_for(self, bench: Bench, durations_ns: Callable[[int], int]) -> list[int]:
        """Rehearse for ``durations_ns(number of SYNC frames)``. Return the list of the times of beginning."""
        began_ns: list[int] = []

        def rehearse() -> None:
            began_ns.append(bench.clock.now_ns)
            bench.clock.now_ns += durations_ns(bench.link.syncs)

        bench.polling = Polling(self.POLL_NS, rehearse=rehearse)
        return began_ns

    @pytest.mark.parametrize("duration_ns", [50_000, FIRST_REHEARSAL_NS, Polling().max_rehearsal_ns - 20_000])
    def test_a_rehearsal_precedes_each_deadline_and_does_not_delay_it(
        self, polling_bench: Bench, duration_ns: int
    ) -> None:
        began_ns = self.rehearse_for(polling_bench, lambda _syncs: duration_ns)
        recording = polling_bench.run()
        assert polling_bench.plan.ending is Ending.COMPLETED
        assert self.lateness_ns(recording)[1:].max() <= self.READING_NS
        leads_ns = self.leads_ns(recording, began_ns)
        assert leads_ns.max() < PERIOD_NS, "each deadline has a rehearsal of its own"
        assert leads_ns[1:].min() >= duration_ns + self.POLL_NS - 6 * self.READING_NS
        assert verify(recording).frames_compared == polling_bench.link.sent

    def test_the_loop_wakes_up_later_once_rehearsals_are_short(self, polling_bench: Bench) -> None:
        began_ns = self.rehearse_for(polling_bench, lambda syncs: FIRST_REHEARSAL_NS if syncs < 5 else 50_000)
        leads_ns = self.leads_ns(polling_bench.run(), began_ns)
        assert leads_ns[-1] < 0.7 * leads_ns[0]
        assert leads_ns[-1] >= 50_000 + self.POLL_NS

    def test_a_late_wake_up_omits_the_rehearsal(self, polling_bench: Bench) -> None:
        rehearsed_after: list[int] = []
        polling_bench.polling = Polling(
            self.POLL_NS, rehearse=lambda: rehearsed_after.append(polling_bench.link.syncs)
        )
        polling_bench.link.wakes_late_ns = {50: self.POLL_NS + 10_000}
        recording = polling_bench.run()
        assert self.lateness_ns(recording).max() <= self.READING_NS
        assert [sync for sync in range(60) if sync not in rehearsed_after] == [50]

    def test_a_stalled_rehearsal_delays_one_deadline_and_omits_the_next_rehearsals(
        self, polling_bench: Bench
    ) -> None:
        stall_ns = 3 * Polling().max_rehearsal_ns // 2
        began_ns = self.rehearse_for(polling_bench, lambda syncs: stall_ns if syncs == 10 else 50_000)
        recording = polling_bench.run()
        late_ns = self.lateness_ns(recording)
        assert sum(late_ns > self.READING_NS) == 1
        is_omitted = self.leads_ns(recording, began_ns) > PERIOD_NS
        assert is_omitted[15]
        assert not is_omitted[-20:].any()

    @pytest.mark.parametrize(("answer_after_ns", "is_polled"), [(400_000, True), (1_500_000, False)])
    def test_the_loop_polls_for_the_sample_for_a_limited_time(
        self, polling_bench: Bench, answer_after_ns: int, is_polled: bool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        polling_bench.polling = Polling(for_sample_ns=1_000_000)
        polling_bench.link.latency_ns = answer_after_ns
        receive, slept = polling_bench.link.receive, []

        def note(timeout_s: float) -> Received | None:
            state = polling_bench.gateway.state
            is_due = polling_bench.gateway.awaits_sample
            received = receive(timeout_s)
            if received is not None and received.frame.id == codec.TPDO1_ADC and is_due:
                assert state is LifeCycleState.RUNNING
                slept.append(timeout_s > 0)
            return received

        monkeypatch.setattr(polling_bench.link, "receive", note)
        recording = polling_bench.run()
        assert polling_bench.plan.ending is Ending.COMPLETED
        assert set(slept) == {not is_polled}
        timing = recording.timing()
        answered_ns = (timing["receive_ns"] - timing["wake_ns"])[timing["fresh"]]
        assert answered_ns.min() >= answer_after_ns
        assert answered_ns.max() <= answer_after_ns + 5 * self.READING_NS
        assert verify(recording).frames_compared == polling_bench.link.sent


@pytest.mark.parametrize("at", range(100, 106))
def test_a_link_that_fails_to_send_ends_the_run_and_still_verifies(bench: Bench, at: int) -> None:
    """The link fails at each of the frames that a call of the core returns."""
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
    assert commands(recording)[-1] == CENTRED
    assert verify(recording).frames_compared == bench.link.sent


@pytest.mark.parametrize("at", range(100, 106))
def test_a_link_that_works_after_reopening_centres_the_valves(bench: Bench, at: int) -> None:
    bench.link.fails_after_sent = at
    bench.link.works_after_reopening = 4
    recording = bench.run()
    assert bench.plan.ending is Ending.LINK
    assert bench.link.reopened == 4
    assert commands(recording)[-CENTRING_PERIODS:] == [CENTRED] * CENTRING_PERIODS
    assert bench.observer.entries[-1].text == "the valves were centred: the command was sent 3 times"
    assert verify(recording).frames_compared == bench.link.sent > at


def test_a_link_that_stays_broken_leaves_the_valves_to_the_watchdog(bench: Bench) -> None:
    bench.link.fails_after_sent = 100
    recording = bench.run()
    assert bench.observer.entries[-1] == LogEntry(
        Severity.ERROR,
        "link",
        "the command that centres the valves was sent 0 times, not 3: the DAC board's watchdog has to "
        "centre them (rig: dac.watchdog_timeout_s)",
    )
    tried_for_ns = bench.clock.now_ns - next(ns for ns, e in recording.log() if e.severity is Severity.FATAL)
    assert 0 <= tried_for_ns - realtime.CENTRING_TIMEOUT_NS < 2 * PERIOD_NS


def test_a_link_that_fails_while_a_completed_run_ends_is_a_failure(bench: Bench) -> None:
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


def test_a_frame_that_a_full_queue_refuses_is_recorded_as_not_sent(bench: Bench) -> None:
    """The refusal is reported and the run continues, because the next period has a new command."""
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
    texts = [entry.text for entry in bench.observer.entries if entry.source == "link"]
    assert texts[0].startswith("the bus' transmit queue is full: ")
    assert texts[-1].endswith("4 frames not sent so far")
    assert verify(recording).frames_compared == bench.link.sent


def test_after_refusals_a_valve_steps_by_the_rate_of_one_period(slow_valve_bench: Bench) -> None:
    """The core is given each refused command, and the replay repeats that."""
    bench, asked = slow_valve_bench, list[Frame]()

    def refuses(frame: Frame) -> bool:
        if frame.id != codec.RPDO1_DAC:
            return False
        asked.append(frame)
        return len(asked) in (33, 34, 35, 36)  # the valve moves at its rate limit from command 30 on

    bench.link.refuses = refuses
    recording = bench.run()
    assert refused(recording) == 4
    steps_v = [after[0] - before[0] for before, after in pairwise(commands(recording))]
    assert steps_v[28:34] == pytest.approx([0.28] * 6, abs=VOLTS_PER_COUNT)
    assert max(map(abs, steps_v[:60])) <= 0.28 + VOLTS_PER_COUNT
    assert verify(recording).frames_compared == bench.link.sent


def test_replay_compares_frames_that_were_not_sent(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.link.refuses = lambda frame: frame.id == codec.HEARTBEAT_GATEWAY
    frame_refused = Recorder.frame_refused
    monkeypatch.setattr(Recorder, "frame_refused", lambda self, f, ns: frame_refused(self, Frame(f.id), ns))
    recording = bench.run()
    with pytest.raises(ReplayMismatchError, match=r"recorded 701#, the core sends 701#05"):
        verify(recording)


def test_several_commands_refused_in_a_row_are_a_failed_link(bench: Bench) -> None:
    """Otherwise the valves would hold their last command, and the plant would run away."""
    bench.link.refuses = lambda frame: bench.link.syncs > 60 and frame.id == codec.RPDO1_DAC
    recording = bench.run()
    assert bench.plan.ending is Ending.LINK
    assert bench.gateway.fault_reason is not None
    assert bench.gateway.fault_reason.startswith(
        "link: 5 valve commands in a row were not sent, limit 5 (rig: adc.stale_after_periods)"
    )
    assert bench.link.syncs < 60 + MAX_REFUSED + realtime.CENTRING_TIMEOUT_NS // PERIOD_NS + 3
    assert refused(recording) > MAX_REFUSED
    assert verify(recording).frames_compared == bench.link.sent


def test_unreadable_frames_are_reported_when_their_number_has_doubled(bench: Bench) -> None:
    bench.link.unreadable_at = {20: 1, 30: 1, 40: 1, 50: 7, 60: 1}
    recording = bench.run()
    texts = [entry.text for _, entry in recording.log() if entry.source == "link"]
    assert [text.split()[0] for text in texts] == ["1", "2", "10"]
    assert texts[0] == "1 unreadable frames discarded so far: not classic CAN, or corrupt"
    assert verify(recording).frames_compared == bench.link.sent


class TestAnInternalError:
    """An internal error is a fatal log entry, and the valves are centred."""

    def check(self, bench: Bench, error: type[Exception]) -> None:
        recording = bench.run()
        assert isinstance(bench.error, error)
        assert bench.plan.ending is Ending.ERROR
        assert commands(recording)[-CENTRING_PERIODS:] == [CENTRED] * CENTRING_PERIODS
        last = recording.log()[-1][1]
        assert last.severity is Severity.FATAL
        assert last.text == f"an internal error ended the run: {error.__name__}: {bench.error}"
        assert verify(recording).frames_compared == bench.link.sent

    def test_in_the_link(self, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        receive = bench.link.receive

        def failing(timeout_s: float) -> Received | None:
            if bench.link.received == 100:
                raise KeyError("channel")
            return receive(timeout_s)

        monkeypatch.setattr(bench.link, "receive", failing)
        self.check(bench, KeyError)

    def test_in_the_recorder(self, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        received = bench.link.receive

        def strange(timeout_s: float) -> Received | None:
            message = received(timeout_s)
            if message is None or bench.link.received != 100:
                return message
            return message._replace(frame=Frame(1.5))  # type: ignore[arg-type]

        monkeypatch.setattr(bench.link, "receive", strange)
        self.check(bench, struct.error)

    def test_in_the_core_and_replay_repeats_it(self, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        check = SampleGuard.check

        def failing(guard: SampleGuard, data: bytes, now_ns: int) -> Verdict:
            if data[6] == 50:
                raise ZeroDivisionError("float division by zero")
            return check(guard, data, now_ns)

        monkeypatch.setattr(SampleGuard, "check", failing)
        self.check(bench, ZeroDivisionError)
        monkeypatch.undo()
        with pytest.raises(ReplayMismatchError, match="the core sends"):
            verify(Recording(bench.path))

    def test_while_sending(self, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        send = bench.link.send

        def failing(frame: Frame) -> bool:
            if bench.link.sent == 101:
                bench.link.sent += 1
                raise TypeError("an integer is required")
            return send(frame)

        monkeypatch.setattr(bench.session, "_send", failing)
        recording = bench.run()
        assert isinstance(bench.error, TypeError)
        assert commands(recording)[-1] == CENTRED
        assert verify(recording).frames_compared == bench.link.sent - 1


def test_the_sending_time_is_taken_when_the_link_has_taken_the_frame(bench: Bench) -> None:
    bench.link.send_takes_ns = 30_000
    recording = bench.run()
    running = recording.timing()[recording.timing()["state"] == LifeCycleState.RUNNING]
    assert set(running["sent_ns"] - running["computed_ns"]) == {30_000}
    assert set(running["sent_ns"]) <= set(recording.frames("sent", codec.RPDO1_DAC).time_ns)
    assert set(running["wake_ns"] + 30_000) <= set(recording.frames("sent", codec.SYNC).time_ns)


def test_the_observer_gets_every_log_entry_and_period_and_the_recorders_news(
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
    recorded = [entry for _, entry in recording.log()]
    assert note in recorded
    assert [entry for entry in bench.observer.entries if entry != news] == recorded
    assert bench.observer.entries.count(news) == 1
    assert [cycle.number for cycle in bench.observer.cycles] == list(recording.timing()["number"])
    report = verify(recording)
    assert report.frames_compared == bench.link.sent
    assert report.log_entries_compared == len(recorded) - 1, "the core gave no rights"
    assert report.periods_compared == len(recording.timing())
