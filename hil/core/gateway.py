"""The gateway core: given frames and the time, it gives back frames, events and its next deadline.

No socket, no clock, no thread, no file: the shells own those. One period:

    on_deadline -> SYNC     ADC samples     receive(TPDO1) -> guards -> control laws -> limits -> RPDO1

A command leaves only in answer to a good sample of the same period (RUNNING), or centres the valves (every
other state). A sample that answers an earlier SYNC is rejected; where one may still come, a period passes
without SYNC. A missing or rejected sample sends nothing: the board holds, and after
``adc.stale_after_periods`` such periods the gateway faults. A fault centres the valves at once: at a deadline
its command goes before SYNC, so that a board which applies at SYNC does not hold for one period more.
"""

from __future__ import annotations

from collections.abc import Mapping

from hil.core.axis_loops import AxisLoops
from hil.core.board_watch import BoardWatch, NmtState, describe_emergency
from hil.core.control_law import ControlLaw
from hil.core.frames import Frame
from hil.core.life_cycle import OPERATOR_TRIGGERS, LifeCycleState, Trigger, allowed_triggers, next_state
from hil.core.output import Cycle, LogEntry, LogThrottle, Output, Severity
from hil.core.rig import Rig, nanoseconds
from hil.core.sample_guard import NOT_ALONE, SampleGuard, Unasked
from hil.core.setpoints import Setpoint
from hil.core.wire import codec

ADC_NODE, DAC_NODE = 0x10, 0x20
BUS_OFF = 0x40
"""CAN_ERR_BUSOFF of linux/can/error.h."""

MOST_REPORTED = 64
"""Unexpected identifiers that are reported: a babbling node must not fill the recording with events."""

OWN_IDENTIFIERS = {
    codec.RPDO1_DAC: "RPDO1_DAC",
    codec.SYNC: "SYNC",
    codec.NMT: "NMT",
    codec.HEARTBEAT_GATEWAY: "HEARTBEAT_GATEWAY",
}
"""What only the gateway sends: the same from elsewhere is a second master on the bus."""

COMMANDS_TO_BOARDS = {
    0x320: "RPDO2 to the DAC board",
    0x420: "RPDO3 to the DAC board",
    0x520: "RPDO4 to the DAC board",
    0x600 + DAC_NODE: "SDO to the DAC board",
    0x600 + ADC_NODE: "SDO to the ADC board",
}
"""What could move a valve, or change a board, behind the gateway's back: none while it is armed."""

_SYNC_FRAME = Frame(codec.SYNC)
_NOTHING = Output()


class Gateway:
    """The state machine. ``laws`` and ``setpoints`` are by axis name; times are monotonic nanoseconds."""

    def __init__(
        self,
        rig: Rig,
        laws: Mapping[str, ControlLaw],
        setpoints: Mapping[str, Setpoint],
        first_deadline_ns: int,
    ) -> None:
        self._rig = rig
        self._period_ns = rig.loop.period_ns
        self._loops = AxisLoops(rig, laws, setpoints)
        self._guard = SampleGuard(rig)
        self._adc = BoardWatch(
            "adc", ADC_NODE, nanoseconds(rig.adc.heartbeat_timeout_s), "adc.heartbeat_timeout_s"
        )
        self._dac = BoardWatch(
            "dac", DAC_NODE, nanoseconds(rig.dac.heartbeat_timeout_s), "dac.heartbeat_timeout_s"
        )
        self._boards = (self._adc, self._dac)
        self.state = LifeCycleState.OFFLINE
        self.fault_reason: str | None = None
        self.next_deadline_ns = first_deadline_ns
        self.missed_periods = 0
        """Periods whose deadline passed before the core was called; they are skipped, never caught up."""
        self.rejected_frames = 0
        self.error_frames = 0
        self._number = -1
        self._heartbeat_periods = rig.heartbeat_periods
        self._heartbeat_number = 0
        self._deadline_ns = first_deadline_ns
        self._wake_ns = 0
        self._state_before = self.state
        self._has_sample = True
        self._stale_periods = 0
        self._last_rejection = ""
        self._reported: set[Frame] = set()
        """Frames without their data that were told once."""
        self._throttle = LogThrottle()
        self._started_boards: set[str] = set()
        """Those sent an NMT start in this period: one is enough, whatever their heartbeats say."""

    @property
    def _boards_are_fit(self) -> bool:
        return self._adc.is_fit and self._dac.is_fit

    @property
    def lost_samples(self) -> int:
        """Samples that the ADC board's counter says were lost on the way."""
        return self._guard.lost

    @property
    def readiness(self) -> str:
        """What is known of the boards and their samples, in words: what the gateway waits for."""
        boards = "; ".join(f"{board.name} {board.describe()}" for board in self._boards)
        return f"{boards}; last sample rejected: {self._last_rejection}" if self._last_rejection else boards

    def on_deadline(self, now_ns: int) -> Output:
        """Begin the period that is due: SYNC, supervision, and centring where nothing is running."""
        frames: list[Frame] = []
        events: list[LogEntry] = []
        deadline_ns = self.next_deadline_ns
        skipped = (now_ns - deadline_ns) // self._period_ns
        if skipped > 0:
            text = f"woke {(now_ns - deadline_ns) / 1e6:.1f} ms late: {skipped} periods skipped"
            events.append(LogEntry(Severity.WARNING, "loop", text))
            deadline_ns += skipped * self._period_ns
            self.missed_periods += skipped
        cycle = self._close_period(max(skipped, 0), frames, events)
        for board in self._boards:
            reason = board.overdue(now_ns)
            if reason is not None:
                self._lose(board.name, reason, frames, events)
        self._number += 1 + max(skipped, 0)
        self._deadline_ns = deadline_ns
        self._wake_ns = now_ns
        self._has_sample = False
        self._started_boards.clear()
        self.next_deadline_ns = deadline_ns + self._period_ns
        # A command that centres the valves, as every change of state may, never waits for its SYNC.
        is_settled = self.state is self._state_before and self.state is not LifeCycleState.FAULT
        self._state_before = self.state
        late_ns = now_ns - deadline_ns
        if is_settled and late_ns > self._period_ns // 2:
            # The next SYNC would follow too soon: valves would move by two periods' steps at once.
            self.missed_periods += 1
            text = f"woke {late_ns / 1e6:.1f} ms late: this period passes without SYNC"
            events.extend(self._tell(Severity.WARNING, "loop", text).log)
        elif self._guard.begin_period(now_ns, may_wait=is_settled):
            frames.append(_SYNC_FRAME)
        elif self.state is not LifeCycleState.OFFLINE:
            text = "a period without SYNC, to tell late from lost"
            events.extend(self._tell(Severity.WARNING, "guard", text, kind="no SYNC").log)
        if self._number >= self._heartbeat_number:
            self._heartbeat_number = self._number + self._heartbeat_periods
            frames.append(
                Frame(codec.HEARTBEAT_GATEWAY, codec.encode_heartbeat_gateway(NmtState.OPERATIONAL))
            )
        if self.state is not LifeCycleState.RUNNING:
            frames.append(self._loops.centre())
        return Output(tuple(frames), tuple(events), cycle)

    def receive(self, frame: Frame, now_ns: int) -> Output:
        """Take a frame from the bus."""
        identifier, data, is_extended, is_remote, is_error = frame
        if is_extended or is_remote or is_error:
            return self._receive_unusual(frame)
        if identifier == codec.TPDO1_ADC:
            return self._receive_sample(data, now_ns)
        if identifier == codec.HEARTBEAT_ADC:
            return self._receive_heartbeat(self._adc, data, now_ns)
        if identifier == codec.HEARTBEAT_DAC:
            return self._receive_heartbeat(self._dac, data, now_ns)
        if identifier == codec.EMCY_ADC:
            return self._receive_emergency(self._adc, data)
        if identifier == codec.EMCY_DAC:
            return self._receive_emergency(self._dac, data)
        if identifier in OWN_IDENTIFIERS:
            return self._receive_foreign(frame)
        if identifier in COMMANDS_TO_BOARDS and self.state in (LifeCycleState.ARMED, LifeCycleState.RUNNING):
            text = f"{COMMANDS_TO_BOARDS[identifier]}, frame {frame}: another master commands this bus"
            return self._fault("bus", text)
        return self._report_unexpected(frame)

    def operate(self, trigger: Trigger, now_ns: int) -> Output:
        """An operator's arm, start, stop, disarm or reset. What the state does not allow is refused."""
        if trigger not in OPERATOR_TRIGGERS or next_state(self.state, trigger) is None:
            allowed = ", ".join(allowed_triggers(self.state)) or "nothing"
            why = "; ".join(f"{board.name} {board.describe()}" for board in self._boards)
            text = f"{trigger.value} refused in state {self.state.name.lower()} ({why}); allowed: {allowed}"
            return Output(log=(LogEntry(Severity.WARNING, "life cycle", text),))
        events: list[LogEntry] = []
        self._enter(trigger, events)
        if trigger is Trigger.START:
            self._loops.begin_anew()
        elif trigger is Trigger.RESET:
            self.fault_reason = None
            self._last_rejection = ""
            self._guard.forget()
            self._throttle.forget()
        frames = (self._loops.centre(),) if trigger is Trigger.STOP else ()
        return Output(frames, tuple(events))

    def link_failed(self, reason: str) -> Output:
        """The shell has lost the bus."""
        return self._fault("link", reason)

    # One period

    def _receive_sample(self, data: bytes, now_ns: int) -> Output:
        events: list[LogEntry] = []
        lost_before = self._guard.lost
        checked = self._guard.check(data, now_ns)
        if self._guard.lost != lost_before:
            self._report_lost(lost_before, events)
        if (
            self._guard.surplus > 0
            and self.state is LifeCycleState.READY
            and not isinstance(checked, Unasked)
        ):
            checked = Unasked(f"TPDO1_ADC: more answers than SYNCs: {NOT_ALONE}")
        if isinstance(checked, Unasked):
            self.rejected_frames += 1
            self._last_rejection = checked
            unasked: list[Frame] = []
            self._lose("adc", checked, unasked, events)
            return Output(tuple(unasked), tuple(events))
        if isinstance(checked, str):
            return Output(log=(*events, *self._reject(checked).log))
        self._has_sample = True
        self._stale_periods = 0
        self._last_rejection = ""
        frames: tuple[Frame, ...] = ()
        if self.state is LifeCycleState.OFFLINE and self._boards_are_fit and self._guard.surplus == 0:
            self._enter(Trigger.BOARDS_UP, events)
        if self.state is not LifeCycleState.RUNNING:
            self._loops.observe(checked)
        elif (culprit := self._loops.control(checked, self._deadline_ns, now_ns)) is None:
            frames = (self._loops.command(),)
        else:
            r, y, _, u, _, _ = culprit.signals
            fault = self._fault(culprit.name, f"control law gave {u} V at setpoint {r:g}, position {y:g}")
            frames, events = fault.frames, [*events, *fault.log]
        return Output(frames, tuple(events), self._cycle(now_ns, True))

    def _close_period(self, skipped: int, frames: list[Frame], events: list[LogEntry]) -> Cycle | None:
        """Account for a period that ends without a good sample, and for deadlines that were missed."""
        cycle = None if self._has_sample else self._cycle(0, False)
        missing = skipped + (0 if self._has_sample else 1)
        if missing == 0 or self.state is LifeCycleState.OFFLINE:
            return cycle
        self._stale_periods += missing
        limit = self._rig.adc.stale_after_periods
        if self._stale_periods >= limit:
            cause = self._last_rejection or (
                f"the loop itself missed {skipped} deadlines" if skipped else "no TPDO1_ADC came"
            )
            self._lose(
                "adc",
                f"no good sample for {self._stale_periods} periods, limit {limit} "
                f"(rig: adc.stale_after_periods); last: {cause}",
                frames,
                events,
            )
        return cycle

    def _cycle(self, receive_ns: int, fresh: bool) -> Cycle:
        return Cycle(
            self._number,
            self._deadline_ns,
            self._wake_ns,
            receive_ns,
            self.state,
            fresh,
            self._loops.signals,
        )

    # Everything that is not a sample

    def _receive_heartbeat(self, board: BoardWatch, data: bytes, now_ns: int) -> Output:
        if len(data) != 1:
            return self._reject(f"heartbeat of {board.name} has {len(data)} bytes, not 1")
        was_up, before = board.is_up, board.nmt_state
        start = board.heartbeat(data[0], now_ns)
        frames: list[Frame] = []
        events: list[LogEntry] = []
        if board.nmt_state != before:
            events.extend(
                self._tell(Severity.INFO, board.name, board.describe(), kind=f"{board.name} state").log
            )
        if start is not None:
            if board is self._adc:
                self._guard.forget()
            if was_up:
                self._lose(board.name, f"left operational: {board.describe()}", frames, events)
            if board.name not in self._started_boards:
                self._started_boards.add(board.name)
                frames.append(start)
        return Output(tuple(frames), tuple(events))

    def _receive_emergency(self, board: BoardWatch, data: bytes) -> Output:
        if len(data) != codec.EMCY_ADC_LENGTH:
            return self._reject(f"EMCY of {board.name} has {len(data)} bytes, not {codec.EMCY_ADC_LENGTH}")
        emergency = codec.decode_emcy_adc(data)
        if emergency.error_code == 0:
            board.error = None
            return self._tell(Severity.INFO, board.name, "EMCY: no error")
        text = describe_emergency(emergency.error_code, emergency.error_register, data[3:])
        board.error = text
        frames: list[Frame] = []
        events: list[LogEntry] = []
        if self.state is LifeCycleState.FAULT:
            return self._tell(Severity.WARNING, board.name, text)
        self._lose(board.name, text, frames, events)
        return Output(tuple(frames), tuple(events))

    def _receive_unusual(self, frame: Frame) -> Output:
        if frame.is_error:
            if frame.id & BUS_OFF and self.state is not LifeCycleState.FAULT:
                return self._fault("bus", "bus-off: check wiring, termination and bit rate")
            self.error_frames += 1
            return self._tell(Severity.WARNING, "bus", f"error frame {frame}, {self.error_frames} so far")
        return self._report_unexpected(frame)

    def _receive_foreign(self, frame: Frame) -> Output:
        """A frame that only the gateway sends: a fault; in state fault reported once an identifier."""
        kind = frame._replace(data=b"")
        if self.state is LifeCycleState.FAULT and kind in self._reported:
            return _NOTHING
        self._reported.add(kind)
        text = f"foreign {OWN_IDENTIFIERS[frame.id]} frame {frame}: another master commands this bus"
        return self._fault("bus", text)

    def _report_unexpected(self, frame: Frame) -> Output:
        kind = frame._replace(data=b"")
        if kind in self._reported or len(self._reported) >= MOST_REPORTED:
            return _NOTHING
        self._reported.add(kind)
        text = f"frame {frame} is not in arm.dbc; further ones of its identifier are ignored in silence"
        return Output(log=(LogEntry(Severity.WARNING, "bus", text),))

    def _report_lost(self, lost_before: int, events: list[LogEntry]) -> None:
        """Samples that the counter missed."""
        lost = self._guard.lost
        text = f"TPDO1_ADC: counter skipped {lost - lost_before}, {lost} so far"
        events.extend(self._tell(Severity.WARNING, "guard", text, kind="lost").log)

    def _reject(self, reason: str) -> Output:
        self.rejected_frames += 1
        is_repeated = self._last_rejection != ""
        self._last_rejection = reason
        if is_repeated:
            return _NOTHING  # one report until a good sample comes
        number = f" ({self.rejected_frames} so far)" if self.rejected_frames > LogThrottle.FIRST else ""
        return self._tell(Severity.WARNING, "guard", f"rejected{number}: {reason}")

    # Life cycle

    def _lose(self, source: str, reason: str, frames: list[Frame], events: list[LogEntry]) -> None:
        """A board or its samples are gone: a fault once armed, else offline."""
        if self.state in (LifeCycleState.ARMED, LifeCycleState.RUNNING):
            fault = self._fault(source, reason)
            frames.extend(fault.frames)
            events.extend(fault.log)
            return
        if self.state is not LifeCycleState.FAULT:
            events.extend(self._tell(Severity.WARNING, source, reason).log)
        if self.state is LifeCycleState.READY:
            self._enter(Trigger.BOARDS_LOST, events)

    def _fault(self, source: str, reason: str) -> Output:
        """Latch a fault and centre every valve at once."""
        if self.state is LifeCycleState.FAULT:
            return Output(log=(LogEntry(Severity.WARNING, source, reason),))
        self.fault_reason = f"{source}: {reason}"
        events = [LogEntry(Severity.FATAL, source, reason)]
        self._enter(Trigger.FAULT, events)
        return Output((self._loops.centre(),), tuple(events))

    def _tell(self, severity: Severity, source: str, text: str, kind: str = "") -> Output:
        """What may come with every frame, as far as the moderator lets it; counted by source, or ``kind``."""
        if not self._throttle.should_report(kind or f"{severity} {source}"):
            return _NOTHING
        return Output(log=(LogEntry(severity, source, text),))

    def _enter(self, trigger: Trigger, events: list[LogEntry]) -> None:
        after = next_state(self.state, trigger)
        assert after is not None, f"{trigger} in {self.state}"
        text = f"{self.state.name.lower()} -> {after.name.lower()} ({trigger.value})"
        events.append(LogEntry(Severity.INFO, "life cycle", text))
        self.state = after
