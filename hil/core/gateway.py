"""The gateway core: it is given frames and the time, and returns frames, log entries and its next deadline.

The core opens no socket, reads no clock, starts no thread and writes no file. The shells do that. One period:

    on_deadline -> SYNC     ADC samples     receive(TPDO1) -> sample guard -> control laws -> limits -> RPDO1

In state running, a command leaves only in answer to a good sample of the same period. In every other state, a
command leaves in every period and centres the valves. It leaves after SYNC. If the valves are not centred
yet, it leaves before SYNC, and SYNC is never withheld then: a board that applies commands at SYNC would hold
the old command for at least one more period.

A missing or rejected sample sends nothing: the board holds its last command. After
``adc.stale_after_periods`` such periods the gateway faults. In some periods the sample guard sends no SYNC,
to find out whether samples are late.

A fault centres the valves at once. If it is found at a deadline, its command leaves before SYNC too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hil.core.arming import Arming
from hil.core.axis_loops import AxisLoops, LoopFailure
from hil.core.axis_requests import Prepared
from hil.core.board_supervision import BoardSupervision
from hil.core.board_watch import NmtState
from hil.core.control_law import ControlLaw
from hil.core.excited_loop import ExcitedLoop
from hil.core.experiment import Experiment
from hil.core.foreign_frames import ForeignFrames, Intrusion, UnknownFrame
from hil.core.frames import Frame
from hil.core.hardware_protection import ENABLE, HardwareProtection
from hil.core.jog import JogEnd
from hil.core.jogging import Jogging
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.operating_state import OperatingState
from hil.core.operator_requests import OperatorRequests
from hil.core.output import NOTHING, Cycle, LogEntry, LogThrottle, Output, Severity, combine
from hil.core.period_clock import PeriodClock
from hil.core.phase import Phase
from hil.core.rejections import Rejections
from hil.core.requests import Reply, Request, SetpointRequest
from hil.core.rig import Rig
from hil.core.sample_guard import Accepted, Rejected, RejectionSeverity, SampleGuard
from hil.core.setpoint_change import PreparedSetpoint
from hil.core.setpoints import Setpoint
from hil.core.stale_periods import StalePeriods
from hil.core.wire import codec

BUS_OFF = 0x40
"""Error class of an error frame that reports bus-off (``CAN_ERR_BUSOFF`` of ``linux/can/error.h``)."""

_SYNC = Output((Frame(codec.SYNC),))
_HEARTBEAT = Output((Frame(codec.HEARTBEAT_GATEWAY, codec.encode_heartbeat_gateway(NmtState.OPERATIONAL)),))


class Gateway:
    """The gateway as a state machine.

    ``laws`` and ``setpoints`` are given by axis name. Times are nanoseconds on one monotonic clock.
    """

    def __init__(
        self,
        rig: Rig,
        laws: Mapping[str, ControlLaw],
        setpoints: Mapping[str, Setpoint],
        first_deadline_ns: int,
        experiment: Experiment | None = None,
        controller_failures: Mapping[str, str] | None = None,
    ) -> None:
        """``experiment`` excites one axis in state running, in place of its setpoint.

        ``controller_failures`` says, by axis name, why a controller must not run. Arming is then refused.
        """
        self._heartbeat_periods = rig.heartbeat_periods
        self._clock = PeriodClock(rig.loop.period_ns, first_deadline_ns)
        self._loops = AxisLoops(rig, laws, setpoints, experiment)
        self._guard = SampleGuard(rig)
        self._throttle = LogThrottle()
        self._rejections = Rejections(self._throttle)
        self._state = OperatingState(self._loops.centre, self._throttle)
        self._stale_periods = StalePeriods(rig, self._state, self._rejections)
        self._boards = BoardSupervision(
            rig, self._state, self._throttle, self._rejections, on_adc_restart=self._guard.restart
        )
        self._protection = HardwareProtection(
            rig,
            self._state,
            self._throttle,
            needs_enable=self._needs_enable,
            stop=self._stop_motion,
        )
        self._jogging = Jogging(
            rig,
            self._loops,
            self._state,
            circumstances=lambda: self._describe(self._clock.wake_ns),
            enable_problem=self._protection.enable_problem,
        )
        self._arming = Arming(rig, self._loops, self._state, controller_failures or {})
        self._requests = OperatorRequests(
            rig,
            self._loops,
            self._state,
            self._protection,
            self._jogging,
            self._arming,
            circumstances=self._describe,
            on_start=self._forget_phase,
            on_reset=self._forget_faults,
        )
        self._foreign_frames = ForeignFrames()
        self.error_frames = 0
        """Number of error frames of the bus, without those that caused a fault."""
        self.lost_samples = 0
        """Number of samples that were lost on their way, by the ADC board's counter."""
        self._state_at_deadline = LifeCycleState.OFFLINE
        self._next_heartbeat_number = 0
        self._has_sample = True
        """True if a good sample has arrived in the present period, and before the first period."""
        self._reported_phase = Phase.NONE

    @property
    def state(self) -> LifeCycleState:
        """Present state of the life cycle."""
        return self._state.current

    @property
    def fault_reason(self) -> str | None:
        """Source and reason of the fault in state fault, else None."""
        return self._state.fault_reason

    @property
    def next_deadline_ns(self) -> int:
        """Time at which ``on_deadline`` is to be called next."""
        return self._clock.next_deadline_ns

    @property
    def awaits_sample(self) -> bool:
        """True if a sample of the present period would be answered with a command of the controllers."""
        return not self._has_sample and self._state.current is LifeCycleState.RUNNING

    @property
    def missed_periods(self) -> int:
        """Number of periods that were skipped or sent no SYNC because ``on_deadline`` was called too late."""
        return self._clock.missed_periods

    @property
    def rejected_frames(self) -> int:
        """Number of samples, heartbeats and emergency messages that were rejected."""
        return self._rejections.count

    @property
    def experiment(self) -> ExcitedLoop | None:
        """The loop that an experiment excites, or None if the run is no experiment."""
        return self._loops.experiment

    @property
    def readiness(self) -> str:
        """What is known about the boards and their samples, in words. It says what the gateway waits for."""
        reason = self._rejections.last_reason
        circumstances = self._describe(self._clock.wake_ns)
        return f"{circumstances}; last sample rejected: {reason}" if reason else circumstances

    def on_deadline(self, now_ns: int) -> Output:
        """Begin the period that is due: end the one before, send SYNC, and centre the valves unless running.

        Deadlines that passed before the call are skipped.
        """
        skipped = self._clock.skipped_periods(now_ns)
        ended = self._end_period(skipped, now_ns)
        timeouts = combine(self._boards.begin_period(now_ns), self._protection.check(now_ns))
        jog_ended = self._jogging.begin_period(now_ns)
        self._clock.begin_period(now_ns, skipped)
        self._has_sample = False
        if self._state.current is LifeCycleState.RUNNING:
            return combine(ended, timeouts, jog_ended, self._sync(now_ns, True), self._heartbeat())
        if self._loops.are_centred:
            sync = self._sync(now_ns, True)
            return combine(ended, timeouts, jog_ended, sync, self._heartbeat(), self._centre())
        centred = self._centre()
        return combine(ended, timeouts, jog_ended, centred, self._sync(now_ns, False), self._heartbeat())

    def receive(self, frame: Frame, now_ns: int) -> Output:
        """Take a frame from the bus."""
        identifier, data, is_extended, is_remote, is_error = frame
        if is_error:
            return self._receive_error_frame(frame)
        if is_extended or is_remote:
            return self._receive_foreign(frame)
        if identifier == codec.TPDO1_ADC:
            return self._receive_sample(data, now_ns)
        if identifier == codec.HEARTBEAT_ADC:
            return self._boards.receive_heartbeat(self._boards.adc, data, now_ns)
        if identifier == codec.HEARTBEAT_DAC:
            return self._boards.receive_heartbeat(self._boards.dac, data, now_ns)
        if identifier == codec.EMCY_ADC:
            return self._boards.receive_adc_emergency(data)
        if identifier == codec.EMCY_DAC:
            return self._boards.receive_dac_emergency(data)
        if identifier in self._protection.identifiers:
            return self._protection.receive(identifier, data, now_ns)
        answer = self._boards.receive_answer(identifier, data, now_ns)
        return self._receive_foreign(frame) if answer is None else answer

    def operate(self, request: Request, now_ns: int, prepared: Prepared | None = None) -> Output:
        """Take an operator's request, or refuse it. The output's ``reply`` says what happened, or why not.

        ``prepared`` is the result of ``controller_change.prepare_controller`` or
        ``setpoint_change.prepare_setpoint`` for this request, if another process has read the controller or
        the table already. It saves time and changes nothing else.
        """
        checked = self._protection.check(now_ns)
        return combine(checked, self._requests.take(request, now_ns, prepared))

    def refuse_setpoint(
        self, request: SetpointRequest, prepared: PreparedSetpoint | None = None
    ) -> Reply | None:
        """Return why a setpoint would be refused now, or None. Nothing is changed.

        With this, a shell gives the setpoints of several axes only if none is refused.
        """
        return self._requests.refuse_setpoint(request, prepared)

    @property
    def overridden_checks(self) -> tuple[str, ...]:
        """Names of the failed checks that an operator has overridden; empty unless armed or running."""
        return self._arming.overridden

    @property
    def is_jogging(self) -> bool:
        """True if an operator jogs an axis."""
        return self._jogging.is_active

    def command_refused(self, frame: Frame) -> None:
        """Take the shell's report that the bus did not take this valve command, before any other call.

        The rate limits of the next command start from the last command that the bus took.
        """
        self._loops.command_refused(frame)

    def link_failed(self, reason: str) -> Output:
        """Take the shell's report that the bus cannot be used any more."""
        return self._state.fault("link", reason)

    def _describe(self, now_ns: int) -> str:
        """Return in words what is known about the boards, and what the protection by hardware lacks."""
        return "; ".join([self._boards.describe(), *self._protection.obstacles(now_ns)])

    def _needs_enable(self) -> bool:
        """Return whether the present motion needs the enable switch: that of an experiment or a jog."""
        return self._loops.experiment is not None or self._jogging.is_active

    def _stop_motion(self, reason: str) -> Output:
        """Stop such a motion because an operator has released the enable switch."""
        return combine(self._state.stop(ENABLE, reason), self._centre())

    def _forget_phase(self) -> None:
        """Report the phases of the experiment anew, because the controllers take over."""
        self._reported_phase = Phase.NONE

    def _forget_faults(self) -> None:
        """Begin anew with the samples and with what was reported, because an operator resets a fault."""
        self._guard.restart()
        self._rejections.forget_reason()
        self._throttle.reset()

    # The end of a period and the beginning of the next

    def _end_period(self, skipped: int, now_ns: int) -> Output:
        """Report skipped periods and one that ends without a good sample; fault after too many in a row."""
        late = self._report_skipped(skipped, now_ns) if skipped else NOTHING
        ended = NOTHING if self._has_sample else Output(cycle=self._cycle(0, False))
        stale = self._stale_periods.add(skipped + (not self._has_sample), skipped)
        return combine(late, ended, stale)

    def _report_skipped(self, skipped: int, now_ns: int) -> Output:
        late_ms = (now_ns - self._clock.next_deadline_ns) / 1e6
        text = f"woke up {late_ms:.1f} ms late, skipped periods: {skipped}"
        return Output(log=(LogEntry(Severity.WARNING, "loop", text),))

    def _sync(self, now_ns: int, may_wait: bool) -> Output:
        state = self._state.current
        # A change of state, and a fault, centre the valves. The command must not wait for a later SYNC.
        may_wait = may_wait and state is self._state_at_deadline and state is not LifeCycleState.FAULT
        self._state_at_deadline = state
        if may_wait and self._clock.is_very_late:
            return self._omit_sync_when_late(now_ns)
        if self._guard.begin_period(now_ns, may_wait):
            return combine(self._protection.sync_sent(self._loops.commanded_v), _SYNC)
        if state is LifeCycleState.OFFLINE:
            return NOTHING
        text = "no SYNC in this period, to find out whether the last sample was late or a SYNC was lost"
        return self._throttle.report(Severity.WARNING, "guard", text, kind="no SYNC")

    def _omit_sync_when_late(self, now_ns: int) -> Output:
        """Send no SYNC because the next one would follow too soon.

        With both, the valves would move by the steps of two periods at nearly the same time.
        """
        self._clock.count_missed_period()
        late_ms = (now_ns - self._clock.deadline_ns) / 1e6
        text = f"woke up {late_ms:.1f} ms late: no SYNC in this period"
        return self._throttle.report(Severity.WARNING, "loop", text)

    def _heartbeat(self) -> Output:
        if self._clock.number < self._next_heartbeat_number:
            return NOTHING
        self._next_heartbeat_number = self._clock.number + self._heartbeat_periods
        return _HEARTBEAT

    def _centre(self) -> Output:
        return Output((self._loops.centre(),))

    # Samples

    def _receive_sample(self, data: bytes, now_ns: int) -> Output:
        # In state ready nothing moves yet, and nobody may arm a rig with two senders.
        is_ready = self._state.current is LifeCycleState.READY
        check = self._guard.check_strictly if is_ready else self._guard.check
        verdict = check(data, now_ns)
        lost = self._count_lost(verdict.lost_before) if verdict.lost_before else NOTHING
        if isinstance(verdict, Accepted):
            return combine(lost, self._protection.check(now_ns), self._use_sample(verdict, now_ns))
        return combine(lost, self._reject_sample(verdict))

    def _reject_sample(self, verdict: Rejected) -> Output:
        if verdict.severity is RejectionSeverity.SECOND_SENDER:
            self._rejections.add_silently(verdict.reason)
            return self._state.lose("adc", verdict.reason)
        return self._rejections.add(verdict.reason)

    def _use_sample(self, sample: Accepted, now_ns: int) -> Output:
        self._has_sample = True
        self._stale_periods.restart()
        self._rejections.forget_reason()
        if self._state.current is LifeCycleState.RUNNING:
            return self._control(sample.volts, now_ns)
        self._loops.observe(sample.volts)
        is_offline = self._state.current is LifeCycleState.OFFLINE
        is_ready = (
            is_offline
            and self._boards.are_fit
            and not self._guard.suspects_second_sender
            and not self._protection.obstacles(now_ns)
        )
        changed = self._state.enter(Trigger.BOARDS_UP) if is_ready else NOTHING
        return combine(changed, Output(cycle=self._cycle(now_ns, True)))

    def _control(self, volts: Sequence[float], now_ns: int) -> Output:
        if self._jogging.is_active:
            return self._jog(volts, now_ns)
        failed = self._loops.control(volts, self._clock.deadline_ns, now_ns)
        if failed is None:
            commands = Output((self._loops.command(),), cycle=self._cycle(now_ns, True))
            return combine(commands, self._report_phase())
        return self._fail(failed, now_ns)

    def _jog(self, volts: Sequence[float], now_ns: int) -> Output:
        """Give the jogged axis its voltage, or centre the valves because the jog must end."""
        match self._jogging.move(volts, self._clock.deadline_ns, now_ns):
            case LoopFailure() as failed:
                return self._fail(failed, now_ns)
            case JogEnd(reason):
                self._jogging.await_release(now_ns)
                ended = self._jogging.end(reason)
                return combine(ended, self._centre(), Output(cycle=self._cycle(now_ns, True)))
        return Output((self._loops.command(),), cycle=self._cycle(now_ns, True))

    def _fail(self, failed: LoopFailure, now_ns: int) -> Output:
        fault = self._state.fault(failed.axis, failed.reason)
        return combine(fault, Output(cycle=self._cycle(now_ns, True)))

    def _report_phase(self) -> Output:
        """Report a new phase of the experiment, once."""
        loop = self.experiment
        if loop is None or loop.phase is self._reported_phase:
            return NOTHING
        self._reported_phase = loop.phase
        severity = Severity.WARNING if loop.phase is Phase.RECOVER else Severity.INFO
        return Output(log=(LogEntry(severity, "experiment", loop.describe()),))

    def _count_lost(self, samples: int) -> Output:
        self.lost_samples += samples
        text = f"TPDO1_ADC: counter skipped {samples}, {self.lost_samples} samples lost so far"
        return self._throttle.report(Severity.WARNING, "guard", text, kind="lost")

    def _cycle(self, receive_ns: int, fresh: bool) -> Cycle:
        return Cycle(
            self._clock.number,
            self._clock.deadline_ns,
            self._clock.wake_ns,
            receive_ns,
            self._state.current,
            fresh,
            self._loops.signals,
        )

    # Frames that no board sends

    def _receive_error_frame(self, frame: Frame) -> Output:
        if frame.id & BUS_OFF and self._state.current is not LifeCycleState.FAULT:
            return self._state.fault("bus", "bus-off: check wiring, termination and bit rate")
        self.error_frames += 1
        text = f"error frame {frame}, {self.error_frames} so far"
        return self._throttle.report(Severity.WARNING, "bus", text)

    def _receive_foreign(self, frame: Frame) -> Output:
        match self._foreign_frames.check(frame, self._state.current):
            case Intrusion(reason):
                return self._state.fault("bus", reason)
            case UnknownFrame(text):
                return Output(log=(LogEntry(Severity.WARNING, "bus", text),))
            case None:
                return NOTHING
