"""Figures of the loop's timing and of the life cycle, collected window by window.

Memory does not grow with the length of the run. Only changes of the state are kept, and how often each
duration was observed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from hil.core.wire.codec import SYNC
from hil.recording.reader import Recording
from hil.recording.tables import FloatArray, IntArray, TimingTable
from hil.views.duration_counts import DurationCounts
from hil.views.life_cycle_stays import Stay

WINDOW_S = 300.0
"""Length of the ranges of time that are read at once."""


class LoopFigures:
    """Collects figures of the periods, which are given in their order."""

    def __init__(self, state_names: Mapping[int, str]) -> None:
        self._names = state_names
        self._offline = [value for value, name in state_names.items() if name == "offline"]
        self.periods = 0
        self.bring_up_periods = 0
        """Number of periods before the gateway first left the state offline."""
        self._is_up = False
        self._numbers = 0, 0
        """Numbers of the first and of the last period."""
        self.periods_without_sample = 0
        """Number of periods without a good sample after the boards were up."""
        self.lateness, self.response = DurationCounts(), DurationCounts()
        self.first_s = self.last_s = 0.0
        """Times of the first and of the last period."""
        self.period_s = 0.0
        """Median time between the periods of the first window; 0 with one period or none."""
        self._running_s: tuple[float, float, float] | None = None
        """Time of the first period under control, and deadlines of the first and of the last one."""
        self._entered: list[tuple[int, float]] = []
        """States in their order, and when each was entered."""

    def add(self, timing: TimingTable, response_ns: IntArray) -> None:
        """Take the periods that follow; ``response_ns`` is negative in a period without a command."""
        count = len(timing)
        if count == 0:
            return
        if self.periods == 0:
            self.first_s = float(timing.time_s[0])
            self.period_s = float(np.median(np.diff(timing.time_s))) if count > 1 else 0.0
            self._numbers = int(timing.number[0]), 0
        self.last_s = float(timing.time_s[-1])
        self._numbers = self._numbers[0], int(timing.number[-1])
        self.periods += count
        self._add_samples(timing)
        lateness_ns = timing.wake_ns - timing.deadline_ns
        self.lateness.add(lateness_ns)
        self.response.add(response_ns[response_ns >= 0])
        self._add_running(timing, np.asarray(lateness_ns * 1e-9, np.float64))
        self._add_states(timing)

    def _add_samples(self, timing: TimingTable) -> None:
        first_up = 0
        if not self._is_up:
            is_up = ~np.isin(timing.state, self._offline)
            self._is_up = bool(is_up.any())
            first_up = int(np.argmax(is_up)) if self._is_up else len(timing)
            self.bring_up_periods += first_up
        self.periods_without_sample += int(np.count_nonzero(~timing.fresh[first_up:]))

    def _add_running(self, timing: TimingTable, lateness_s: FloatArray) -> None:
        running = np.flatnonzero(timing.running)
        if len(running) == 0:
            return
        first, last = int(running[0]), int(running[-1])
        time_s = timing.time_s
        start = self._running_s or (float(time_s[first]), float(time_s[first] - lateness_s[first]), 0.0)
        self._running_s = (*start[:2], float(time_s[last] - lateness_s[last]))

    def _add_states(self, timing: TimingTable) -> None:
        states = timing.state.astype(np.int64)
        before = self._entered[-1][0] if self._entered else -1
        for row in np.flatnonzero(np.diff(states, prepend=before)).tolist():
            self._entered.append((int(states[row]), float(timing.time_s[row])))

    @property
    def missed_periods(self) -> int:
        """Number of periods whose deadline passed before the core was called."""
        first, last = self._numbers
        return last - first - (self.periods - 1) if self.periods else 0

    @property
    def start_s(self) -> float:
        """Time of the first period under control; of the first one if none was."""
        return self.first_s if self._running_s is None else self._running_s[0]

    @property
    def origin(self) -> str:
        """What happened at :attr:`start_s`, in words."""
        return "the recording began" if self._running_s is None else "control began"

    @property
    def controlled_s(self) -> float:
        """Time from the first deadline under control to the last one."""
        return 0.0 if self._running_s is None else self._running_s[2] - self._running_s[1]

    def stays(self) -> list[Stay]:
        """Return the stays in the states of the life cycle; time 0 is :attr:`start_s`."""
        left_s = [*(entered_s for _, entered_s in self._entered[1:]), self.last_s]
        return [
            Stay(self._names.get(state, f"state {state}"), entered_s - self.start_s, end_s - self.start_s)
            for (state, entered_s), end_s in zip(self._entered, left_s, strict=True)
        ]


def loop_figures(recording: Recording) -> LoopFigures:
    """Read the timing of the loop. Raises RecordingError when it is not recorded."""
    figures = LoopFigures(recording.state_names)
    for timing, response_ns in timing_windows(recording):
        figures.add(timing, response_ns)
    return figures


def timing_windows(recording: Recording) -> Iterator[tuple[TimingTable, IntArray]]:
    """Yield the timing of the loop window by window, with the response times in ns.

    A response time is the time from SYNC to the command, both as taken by the link; -1 without a good sample
    or a SYNC.
    """
    last_sync = np.empty(0, np.int64)
    for window in recording.windows(WINDOW_S):
        timing = window.timing()
        sync_ns = np.concatenate([last_sync, window.frames("sent", SYNC).time_ns])
        yield timing, _response_ns(timing, sync_ns)
        last_sync = sync_ns[-1:]


def _response_ns(timing: TimingTable, sync_ns: IntArray) -> IntArray:
    """Return the times from the last SYNC before each sample to the period's command; -1 without them."""
    last = np.searchsorted(sync_ns, timing.receive_ns, side="right") - 1
    known = timing.fresh & (last >= 0)
    response = np.full(len(timing), -1, np.int64)
    response[known] = timing.sent_ns[known] - sync_ns[last[known]]
    return response
