"""Operators' requests: each one is taken or refused, and the reply says what happened, or why not.

The requests of one axis' setpoint or controller are those of ``axis_requests``, and jogs are those of
``jogging``. This module adds the life cycle's triggers: arm, start, stop, disarm and reset.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from hil.core.arming import Arming
from hil.core.axis_loops import AxisLoops
from hil.core.axis_requests import AxisRequests, Prepared
from hil.core.hardware_protection import ENABLE, HardwareProtection
from hil.core.jogging import Jogging
from hil.core.life_cycle import OPERATOR_TRIGGERS, LifeCycleState, Trigger
from hil.core.operating_state import OperatingState
from hil.core.output import LogEntry, Output, Severity, answer, combine
from hil.core.requests import ArmRequest, ControllerRequest, JogRequest, Reply, Request, SetpointRequest
from hil.core.rig import Rig
from hil.core.setpoint_change import PreparedSetpoint


class OperatorRequests:
    """Takes operators' requests in the present state of the life cycle.

    ``circumstances`` describes the boards at a time, for refusals. ``on_start`` and ``on_reset`` are called
    when the controllers take over, and when an operator resets a fault.
    """

    def __init__(
        self,
        rig: Rig,
        loops: AxisLoops,
        state: OperatingState,
        protection: HardwareProtection,
        jogging: Jogging,
        arming: Arming,
        circumstances: Callable[[int], str],
        on_start: Callable[[], None],
        on_reset: Callable[[], None],
    ) -> None:
        self._calibrated_axis = rig.calibration
        self._loops = loops
        self._state = state
        self._protection = protection
        self._jogging = jogging
        self._arming = arming
        self._circumstances = circumstances
        self._on_start = on_start
        self._on_reset = on_reset
        self._axis_requests = AxisRequests(rig, loops)

    def take(self, request: Request, now_ns: int, prepared: Prepared | None) -> Output:
        """Take a request, or refuse it. The output has a ``reply``.

        ``prepared`` is used if it belongs to this request.
        """
        match request:
            case SetpointRequest() | ControllerRequest():
                return self._change(request, prepared)
            case JogRequest():
                return self._axis_requests.refuse(request) or self._jogging.take(request, now_ns)
        before = self._state.current
        output = self._take_trigger(request, now_ns)
        text = "; ".join(entry.text for entry in output.log)
        return output._replace(reply=Reply(self._state.current is not before, text))

    def refuse_setpoint(self, request: SetpointRequest, prepared: PreparedSetpoint | None) -> Reply | None:
        """Return why a setpoint would be refused now, or None. Nothing is changed."""
        if self._state.fault_reason is not None:
            return Reply(False, f"{request.axis}: {self._setpoint_in_fault}")
        return self._axis_requests.refuse_setpoint(request, prepared)

    def _change(self, request: SetpointRequest | ControllerRequest, prepared: Prepared | None) -> Output:
        if self._state.fault_reason is not None and isinstance(request, SetpointRequest):
            return self._axis_requests.refuse(request) or answer(
                request.axis, Reply(False, self._setpoint_in_fault)
            )
        output = self._axis_requests.change(request, self._is_controlling, prepared)
        is_accepted = output.reply is not None and output.reply.accepted
        if is_accepted and isinstance(request, ControllerRequest):
            self._arming.controller_changed(request.axis)
        return output

    @property
    def _setpoint_in_fault(self) -> str:
        """Refusal of a setpoint in state fault."""
        return (
            f"setpoint refused: the state is fault ({self._state.fault_reason}), and a reset returns to the "
            "first setpoints; give it after `hil reset`"
        )

    @property
    def _is_controlling(self) -> bool:
        """True if the controllers act on the valves."""
        return self._state.current is LifeCycleState.RUNNING and not self._jogging.is_active

    def _take_trigger(self, request: Trigger | ArmRequest, now_ns: int) -> Output:
        """Take an operator's trigger (arm, start, stop, disarm, reset), or refuse it in the present state."""
        trigger = Trigger.ARM if isinstance(request, ArmRequest) else request
        if trigger not in OPERATOR_TRIGGERS or not self._state.allows(trigger):
            return self._state.refuse(trigger, self._circumstances(now_ns))
        if trigger is Trigger.START:
            return self._start(now_ns)
        if trigger is Trigger.ARM:
            return self._arming.arm(request if isinstance(request, ArmRequest) else ArmRequest())
        if trigger is Trigger.STOP and self._jogging.is_active:
            self._jogging.await_release(now_ns)
        changed = self._state.enter(trigger)
        self._loops.forget_setpoints()  # The next start must not move an axis to an old setpoint.
        if trigger is Trigger.STOP:
            return combine(changed, Output((self._loops.centre(),)))
        if trigger is Trigger.RESET:
            self._on_reset()
        return changed

    def _start(self, now_ns: int) -> Output:
        """Begin to control, or refuse, such as for a first setpoint outside the envelope."""
        refusals = tuple(
            LogEntry(Severity.WARNING, source, f"start refused: {reason}")
            for source, reason in self._start_refusals(now_ns)
        )
        if refusals:
            return Output(log=refusals)
        self._loops.restart()
        self._jogging.cancel()
        self._on_start()
        moves = tuple(
            LogEntry(Severity.INFO, "setpoint", f"{axis} approaches {text}")
            for axis, text in self._loops.requested_setpoints()
        )
        return combine(self._state.enter(Trigger.START), Output(log=moves + self._arming.disabled_checks))

    def _start_refusals(self, now_ns: int) -> Iterator[tuple[str, str]]:
        """Yield source and reason of each refusal to start."""
        yield from self._loops.start_refusals()
        if self._calibrated_axis is not None:
            yield (
                self._calibrated_axis,
                "this axis is being calibrated (rig: calibration); it can only be jogged",
            )
        if self._loops.experiment is None:
            return
        problem = self._protection.enable_problem(now_ns)
        if problem is not None:
            yield ENABLE, problem
