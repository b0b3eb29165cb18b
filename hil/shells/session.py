"""What every live shell does around a call to the core: send what it answers, record both, tell people."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.life_cycle import Trigger
from hil.core.output import Cycle, LogEntry, LogThrottle, Output, Severity
from hil.core.wire.codec import RPDO1_DAC
from hil.recording.recorder import Recorder
from hil.shells.run_plan import Ending, RunPlan


class Audience(Protocol):
    """Whoever watches a run; must never block."""

    def log(self, event: LogEntry) -> None: ...  # noqa: D102
    def cycle(self, cycle: Cycle, gateway: Gateway) -> None: ...  # noqa: D102


class Session:
    """One run: the core, the bus it sends on, its recording and its audience.

    ``send`` says whether the bus took the frame. After ``most_refused`` valve commands in a row that it did
    not take (None: never), the link counts as failed: the valves hold meanwhile.
    """

    def __init__(
        self,
        gateway: Gateway,
        plan: RunPlan,
        send: Callable[[Frame], bool],
        clock_ns: Callable[[], int],
        recorder: Recorder,
        audience: Audience,
        most_refused: int | None = None,
    ) -> None:
        self.gateway = gateway
        self.plan = plan
        self._send = send
        self._clock_ns = clock_ns
        self._recorder = recorder
        self._audience = audience
        self._most_refused = most_refused
        self._refused = self._refused_in_row = 0
        self._throttle = LogThrottle()
        self.commands_taken = 0
        """Valve commands that the bus took, since the run began or ``failed`` was called."""

    def on_deadline(self, now_ns: int) -> None:
        """Begin a period, then let the plan act."""
        self._recorder.deadline_called(self.gateway.next_deadline_ns, now_ns)
        self._answer(self.gateway.on_deadline(now_ns), now_ns)
        trigger = self.plan.after_period(self.gateway)
        if trigger is not None:
            self.operate(trigger)

    def receive(self, frame: Frame, now_ns: int, stamp_ns: int) -> None:
        """Give a frame to the core."""
        self._recorder.frame_received(frame, now_ns, stamp_ns)
        self._answer(self.gateway.receive(frame, now_ns), now_ns)

    def operate(self, trigger: Trigger) -> None:
        """Give an operator's trigger to the core."""
        now_ns = self._clock_ns()
        self._recorder.operated(trigger, now_ns)
        self._answer(self.gateway.operate(trigger, now_ns), now_ns)

    def failed(self, ending: Ending, reason: str) -> None:
        """Tell the core that the link, or this program, failed: it centres the valves, and the run is over.

        What an unfinished answer had not given yet is lost. Raises LinkError where nothing can leave.
        """
        now_ns = self._clock_ns()
        self.plan.fail(ending)
        self.commands_taken = self._refused_in_row = 0
        self._recorder.link_failed(reason, now_ns)
        self._answer(self.gateway.link_failed(reason), now_ns)

    def note(self, event: LogEntry) -> None:
        """Record and show something that the shell has to say."""
        self._recorder.log_entry(event, self._clock_ns())
        self._audience.log(event)

    def _answer(self, output: Output, now_ns: int) -> None:
        frames, events, cycle = output
        recorder = self._recorder
        computed_ns = sent_ns = self._clock_ns()
        failure: LinkError | None = None
        refused_before = self._refused
        for frame in frames:
            try:
                is_taken = self._send(frame)
            except LinkError as error:
                is_taken, failure = False, failure or error
            else:
                self._count(frame, is_taken)
            sent_ns = self._clock_ns()
            if is_taken:
                recorder.frame_sent(frame, sent_ns)
            else:
                recorder.frame_refused(frame, sent_ns)
        for event in events:
            recorder.log_entry(event, now_ns)
            self._audience.log(event)
        if cycle is not None:
            recorder.cycle(cycle, computed_ns, sent_ns)
            self._audience.cycle(cycle, self.gateway)
            news = recorder.hand_over()
            if news is not None:
                self._audience.log(news)
        if self._refused != refused_before and self._throttle.should_report("refused"):
            text = f"the bus took no frame, its queue is full: {self._refused} frames not sent so far"
            self.note(LogEntry(Severity.WARNING, "link", text))
        if failure is None and self._most_refused is not None and self._refused_in_row >= self._most_refused:
            failure = LinkError(
                f"{self._refused_in_row} valve commands in a row were not sent, limit {self._most_refused} "
                "(rig: adc.stale_after_periods): the bus' queue stays full; is another node there to "
                "acknowledge, and is the cable whole?"
            )
        if failure is not None:
            raise failure

    def _count(self, frame: Frame, is_taken: bool) -> None:
        """Keep account of what the bus takes."""
        is_command = frame.id == RPDO1_DAC
        if is_taken:
            if is_command:
                self.commands_taken += 1
                self._refused_in_row = 0
            return
        self._refused += 1
        self._refused_in_row += is_command
