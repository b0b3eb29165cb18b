"""Protection by hardware that the rig file may name: emergency stop, enable switch, read-back of the valves.

=====================  ==========================================  ===========================================
part                   before arming                               armed or running
=====================  ==========================================  ===========================================
``emergency_stop``     the gateway does not become ready           an open contact is a fault
``dac.read_back``      the gateway does not become ready           a valve that does not follow is a fault
``enable``             motion that needs it is refused             such motion stops, and the state is armed
=====================  ==========================================  ===========================================

A contact opens by its bit, or because no good frame arrives in time. The check is made when a frame arrives,
at each deadline, and before each command in answer to a sample. A fault or a stop centres the valves in the
same call.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hil.core.life_cycle import LifeCycleState
from hil.core.operating_state import OperatingState
from hil.core.output import NOTHING, LogThrottle, Output, Severity, combine
from hil.core.rig import Rig
from hil.core.valve_read_back import ValveReadBack
from hil.core.watched_input import WatchedInput
from hil.core.wire import codec

EMERGENCY_STOP, ENABLE, VALVES = "emergency stop", "enable", "dac"
"""Sources of log entries."""
PRESSED = "it is pressed, or its wire is broken"
RELEASED = "nobody holds the switch, or its wire is broken"


class HardwareProtection:
    """The protection of a rig. Without any, no method has an effect. Times are monotonic nanoseconds.

    ``needs_enable`` returns whether the present motion needs the enable switch. ``stop`` stops it for the
    given reason, with centred valves.
    """

    def __init__(
        self,
        rig: Rig,
        state: OperatingState,
        throttle: LogThrottle,
        needs_enable: Callable[[], bool],
        stop: Callable[[str], Output],
    ) -> None:
        self._state = state
        self._throttle = throttle
        self._needs_enable = needs_enable
        self._stop = stop
        self._emergency_stop: WatchedInput | None = None
        self._enable: WatchedInput | None = None
        version = rig.bus.wire_version
        if rig.emergency_stop is not None:
            self._emergency_stop = WatchedInput("emergency_stop", rig.emergency_stop, version, PRESSED)
        if rig.enable is not None:
            self._enable = WatchedInput("enable", rig.enable, version, RELEASED)
        self._inputs = [contact for contact in (self._emergency_stop, self._enable) if contact is not None]
        self._read_back = ValveReadBack(rig) if rig.dac.read_back else None
        read_back_ids = {codec.TPDO1_DAC} if self._read_back is not None else set()
        self.identifiers = frozenset({contact.identifier for contact in self._inputs} | read_back_ids)
        """Identifiers of the frames that :meth:`receive` takes."""
        self._stop_was_closed = False
        """True if the emergency stop was closed at the last check."""
        self._valves_followed = False
        """True if the valves followed their commands at the last check."""

    def obstacles(self, now_ns: int) -> list[str]:
        """Return why the gateway must not become ready, or nothing. Each text names its source."""
        found = (
            (EMERGENCY_STOP, self._emergency_stop.problem(now_ns) if self._emergency_stop else None),
            (VALVES, self._read_back.problem if self._read_back else None),
        )
        return [f"{source}: {problem}" for source, problem in found if problem is not None]

    def enable_problem(self, now_ns: int) -> str | None:
        """Return why motion that needs the enable switch must not begin, or None."""
        return self._enable.problem(now_ns) if self._enable else None

    def receive(self, identifier: int, data: bytes, now_ns: int) -> Output:
        """Take a frame with one of ``identifiers``."""
        rejected = NOTHING
        for contact in self._inputs:
            if contact.identifier == identifier:
                reason = contact.receive(data, now_ns)
                rejected = NOTHING if reason is None else self._reject(reason)
        if self._read_back is not None and identifier == codec.TPDO1_DAC:
            reason = self._read_back.receive(data)
            rejected = NOTHING if reason is None else self._reject(reason)
        return combine(rejected, self.check(now_ns))

    def check(self, now_ns: int) -> Output:
        """React to a contact that has opened and to valves that do not follow, once for each time."""
        return combine(self._check_emergency_stop(now_ns), self._check_valves(), self._check_enable(now_ns))

    def sync_sent(self, commanded_v: Sequence[float]) -> Output:
        """Take the last commands (V, by axis) when SYNC is sent."""
        if self._read_back is None:
            return NOTHING
        self._read_back.sync_sent(commanded_v)
        return self._check_valves()

    def _reject(self, reason: str) -> Output:
        return self._throttle.report(
            Severity.WARNING, "guard", f"rejected: {reason}", kind="rejected protection"
        )

    def _check_emergency_stop(self, now_ns: int) -> Output:
        if self._emergency_stop is None:
            return NOTHING
        problem = self._emergency_stop.problem(now_ns)
        was_closed, self._stop_was_closed = self._stop_was_closed, problem is None
        return self._lose(EMERGENCY_STOP, problem, was_closed, "the contact is closed")

    def _check_valves(self) -> Output:
        if self._read_back is None:
            return NOTHING
        problem = self._read_back.problem
        followed, self._valves_followed = self._valves_followed, problem is None
        return self._lose(VALVES, problem, followed, "the valves follow their commands")

    def _lose(self, source: str, problem: str | None, was_good: bool, good_text: str) -> Output:
        """React to a protection that is lost, and report one that is good again."""
        if problem is None:
            if was_good:
                return NOTHING
            return self._throttle.report(Severity.INFO, source, good_text, kind=f"{source} good")
        if not was_good and self._state.current not in (LifeCycleState.ARMED, LifeCycleState.RUNNING):
            return NOTHING
        if self._state.current is LifeCycleState.FAULT:
            return self._throttle.report(Severity.WARNING, source, problem)
        return self._state.lose(source, problem)

    def _check_enable(self, now_ns: int) -> Output:
        if self._enable is None or self._state.current is not LifeCycleState.RUNNING:
            return NOTHING
        problem = self._enable.problem(now_ns)
        return self._stop(problem) if problem is not None and self._needs_enable() else NOTHING
