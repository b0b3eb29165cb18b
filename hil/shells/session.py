"""What every live shell does around a call to the core: send, record and show what the core returns."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Protocol

from hil.core.axis_requests import Prepared
from hil.core.errors import LinkError
from hil.core.frames import Frame
from hil.core.gateway import Gateway
from hil.core.output import Cycle, LogEntry, LogThrottle, Output, Severity
from hil.core.requests import ArmRequest, ControllerRequest, JogRequest, Reply, Request
from hil.core.wire.codec import RPDO1_DAC
from hil.recording.no_recorder import RunRecorder
from hil.recording.request_texts import describe_request
from hil.shells.recordings import Recordings
from hil.shells.run_plan import Ending, Plan


class Observer(Protocol):
    """Recipient of a run's log entries and periods, such as a display. Its methods must never block."""

    def log(self, entry: LogEntry) -> None:
        """Take a log entry."""

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        """Take a completed period of ``gateway``."""


class PeriodFeed(Protocol):
    """Recipient of every period after its command was sent and recorded. Its methods must never block."""

    def period(self, cycle: Cycle, computed_ns: int, sent_ns: int) -> None:
        """Take a period, the time at which the core had answered, and that of the last frame sent."""

    def controller_changed(self, request: ControllerRequest) -> None:
        """Take note that the core uses another controller."""


class Session:
    """One run: the core, its plan, the bus on which it sends, its recorder and its observer.

    ``send`` returns False if the bus does not take the frame because its queue is full. After
    ``max_refused_commands`` valve commands in a row that were not taken, the link counts as failed, because
    the valves hold meanwhile; None means no limit. ``clock_ns`` returns monotonic nanoseconds.

    Methods that give something to the core raise LinkError if the link has failed.
    """

    def __init__(
        self,
        gateway: Gateway,
        plan: Plan,
        send: Callable[[Frame], bool],
        clock_ns: Callable[[], int],
        recorder: RunRecorder,
        observer: Observer,
        max_refused_commands: int | None = None,
        recordings: Recordings | None = None,
        feed: PeriodFeed | None = None,
    ) -> None:
        """``recordings`` are the files of ``recorder``, if new ones may begin while the loop runs.

        ``feed`` is what live views are fed with.
        """
        self.gateway = gateway
        self.plan = plan
        self._send = send
        self._clock_ns = clock_ns
        self._recorder = recorder
        self._observer = observer
        self._max_refused_commands = max_refused_commands
        self._recordings = recordings
        self._feed = feed
        self._sent_ns = 0
        """Time at which the last frame was handed to the bus."""
        self._refused_frames = self._refused_commands_in_row = 0
        self._throttle = LogThrottle()
        self.commands_taken = 0
        """Number of valve commands that the bus took, since the run began or has failed."""

    def on_deadline(self, now_ns: int) -> None:
        """Begin a period, then give the core the trigger that the plan asks for."""
        gateway = self.gateway
        record = partial(self._recorder.deadline_called, gateway.next_deadline_ns, now_ns)
        self._handle(partial(gateway.on_deadline, now_ns), record, now_ns)
        trigger = self.plan.after_period(gateway)
        if trigger is not None:
            self.operate(trigger)

    def receive(self, frame: Frame, now_ns: int, stamp_ns: int) -> None:
        """Give the core a frame that the link stamped ``stamp_ns`` and that was read at ``now_ns``."""
        record = partial(self._recorder.frame_received, frame, now_ns, stamp_ns)
        self._handle(partial(self.gateway.receive, frame, now_ns), record, now_ns)

    def operate(self, request: Request, asked_by: str = "", prepared: Prepared | None = None) -> Reply:
        """Give the core an operator's request, and return its reply.

        ``asked_by`` says who asked, such as ``uid 1000, pid 4711``; it is recorded with the request. A
        controller or a table that was prepared in another process saves the core the time to read it.
        """
        goes_on = isinstance(request, JogRequest) and self.gateway.is_jogging
        if asked_by and not goes_on:
            text = f"{asked_by} asks: {describe_request(request)}"
            overrides = isinstance(request, ArmRequest) and bool(request.overrides)
            self.note(LogEntry(Severity.WARNING if overrides else Severity.INFO, "operator", text))
        now_ns = self._clock_ns()
        record = partial(self._recorder.operated, request, now_ns, asked_by)
        output = self._handle(partial(self.gateway.operate, request, now_ns, prepared), record, now_ns)
        reply = output.reply
        assert reply is not None, f"no reply to {request}"
        if isinstance(request, ControllerRequest) and reply.accepted:
            if self._recordings is not None:
                self._recordings.controller_changed(request)
            if self._feed is not None:
                self._feed.controller_changed(request)
        return reply

    def record_new(self, asked_by: str = "", path: Path | None = None) -> Reply:
        """End the present recording, if there is one, and begin another: ``path``, or the next number.

        Call this between two calls of the core.
        """
        return self._record("record new", asked_by, lambda files: files.begin(self.gateway, path))

    def record_stop(self, asked_by: str = "") -> Reply:
        """End the present recording. The loop goes on without one."""
        return self._record("record stop", asked_by, lambda files: files.stop())

    def _record(self, request: str, asked_by: str, action: Callable[[Recordings], Reply]) -> Reply:
        if asked_by:
            self.note(LogEntry(Severity.INFO, "operator", f"{asked_by} asks: {request}"))
        if self._recordings is None:
            reply = Reply(False, "this gateway was started without a recording (--no-record)")
        else:
            reply = action(self._recordings)
        severity = Severity.INFO if reply.accepted else Severity.WARNING
        self.note(LogEntry(severity, "recorder", reply.text))
        return reply

    def end_with_failure(self, ending: Ending, reason: str) -> None:
        """End the run because the link or this program failed. The core faults and centres the valves.

        Frames of an earlier call that were not sent yet are discarded.
        """
        now_ns = self._clock_ns()
        self.plan.fail(ending)
        self.commands_taken = self._refused_commands_in_row = 0
        record = partial(self._recorder.link_failed, reason, now_ns)
        self._handle(partial(self.gateway.link_failed, reason), record, now_ns)

    def note(self, entry: LogEntry, at_ns: int | None = None) -> None:
        """Record and show a log entry of the shell itself. ``at_ns`` is its monotonic time; None: now."""
        self._recorder.log_entry(entry, self._clock_ns() if at_ns is None else at_ns)
        self._observer.log(entry)

    def _handle(self, call: Callable[[], Output], record: Callable[[], None], now_ns: int) -> Output:
        """Make a call of the core at ``now_ns``. Send, record and show what it returns, and return it.

        ``record`` records the call itself. Frames are sent before anything is recorded, because nothing may
        delay them. The recording has the call first, then its frames, also when the call or a send fails.
        """
        tried: list[tuple[Frame, bool, int]] = []
        refused_before = self._refused_frames
        try:
            output = call()
            if output.cycle is not None:
                computed_ns = self._sent_ns = self._clock_ns()
            failure = self._send_frames(output.frames, tried) if output.frames else None
        finally:
            record()
            self._record_frames(tried)
        for entry in output.log:
            self._recorder.log_entry(entry, now_ns)
            self._observer.log(entry)
        if output.cycle is not None:
            self._complete(output.cycle, computed_ns)
        if self._refused_frames != refused_before:
            self._report_refused()
            failure = failure or self._check_refused_commands()
        if failure is not None:
            raise failure
        return output

    def _send_frames(
        self, frames: tuple[Frame, ...], tried: list[tuple[Frame, bool, int]]
    ) -> LinkError | None:
        """Send frames in order. Return the first error; frames after it are tried all the same.

        Adds to ``tried`` each frame, whether the bus took it, and the time after that.
        """
        failure: LinkError | None = None
        for frame in frames:
            try:
                is_taken = self._send(frame)
            except LinkError as error:
                is_taken, failure = False, failure or error
            else:
                self._count(frame, is_taken)
            self._sent_ns = self._clock_ns()
            tried.append((frame, is_taken, self._sent_ns))
            if not is_taken and frame.id == RPDO1_DAC:
                self.gateway.command_refused(frame)
        return failure

    def _record_frames(self, tried: list[tuple[Frame, bool, int]]) -> None:
        """Record frames that the bus took or refused."""
        for frame, is_taken, sent_ns in tried:
            if is_taken:
                self._recorder.frame_sent(frame, sent_ns)
            else:
                self._recorder.frame_refused(frame, sent_ns)

    def _count(self, frame: Frame, is_taken: bool) -> None:
        """Count a frame that the bus took or refused."""
        is_command = frame.id == RPDO1_DAC
        if not is_taken:
            self._refused_frames += 1
            self._refused_commands_in_row += is_command
        elif is_command:
            self.commands_taken += 1
            self._refused_commands_in_row = 0

    def _complete(self, cycle: Cycle, computed_ns: int) -> None:
        """Record and show a completed period, and let the recorder pass on what it has."""
        self._recorder.cycle(cycle, computed_ns, self._sent_ns)
        self._observer.cycle(cycle, self.gateway)
        if self._feed is not None:
            self._feed.period(cycle, computed_ns, self._sent_ns)
        news = self._recorder.hand_over()
        if news is not None:
            self._observer.log(news)
        if self._recordings is not None:
            entry = self._recordings.after_period(cycle, self.gateway)
            if entry is not None:
                self.note(entry)

    def _report_refused(self) -> None:
        if self._throttle.should_report("refused"):
            text = f"the bus' transmit queue is full: {self._refused_frames} frames not sent so far"
            self.note(LogEntry(Severity.WARNING, "link", text))

    def _check_refused_commands(self) -> LinkError | None:
        limit = self._max_refused_commands
        if limit is None or self._refused_commands_in_row < limit:
            return None
        return LinkError(
            f"{self._refused_commands_in_row} valve commands in a row were not sent, limit {limit} "
            "(rig: adc.stale_after_periods): the bus' transmit queue stays full; check the cable, and that "
            "another node is there to acknowledge frames"
        )
