"""What every live shell does around a call to the core: send what it answers, record both, tell people."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from hil.events import Cycle, Event, Output
from hil.frames import Frame
from hil.gateway import Gateway
from hil.life_cycle import Trigger
from hil.recording.recorder import LINK_FAILED, Recorder
from hil.shells.run_plan import Ending, RunPlan


class Audience(Protocol):
    """Whoever watches a run; must never block."""

    def event(self, event: Event) -> None: ...  # noqa: D102
    def cycle(self, cycle: Cycle, gateway: Gateway) -> None: ...  # noqa: D102


class Session:
    """One run: the core, the bus it sends on, its recording and its audience."""

    def __init__(
        self,
        gateway: Gateway,
        plan: RunPlan,
        send: Callable[[Frame], None],
        clock_ns: Callable[[], int],
        recorder: Recorder,
        audience: Audience,
    ) -> None:
        self.gateway = gateway
        self.plan = plan
        self._send = send
        self._clock_ns = clock_ns
        self._recorder = recorder
        self._audience = audience

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
        self._recorder.operated(trigger.value, now_ns)
        self._answer(self.gateway.operate(trigger, now_ns), now_ns)

    def link_failed(self, reason: str) -> None:
        """Tell the core that the bus is gone, and end the run; what the core answers cannot leave."""
        now_ns = self._clock_ns()
        self.plan.end(Ending.LINK)
        self._recorder.operated(LINK_FAILED + reason, now_ns)
        self._answer(self.gateway.link_failed(reason)._replace(frames=()), now_ns)

    def note(self, event: Event) -> None:
        """Record and show something that the shell has to say."""
        self._recorder.event(event, self._clock_ns())
        self._audience.event(event)

    def _answer(self, output: Output, now_ns: int) -> None:
        frames, events, cycle = output
        recorder = self._recorder
        computed_ns = sent_ns = self._clock_ns()
        for frame in frames:
            self._send(frame)
            sent_ns = self._clock_ns()
            recorder.frame_sent(frame, sent_ns)
        for event in events:
            recorder.event(event, now_ns)
            self._audience.event(event)
        if cycle is not None:
            recorder.cycle(cycle, computed_ns, sent_ns)
            self._audience.cycle(cycle, self.gateway)
            news = recorder.hand_over()
            if news is not None:
                self._audience.event(news)
