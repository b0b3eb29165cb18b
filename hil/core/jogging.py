"""The life cycle's side of a jog: when one begins, goes on and ends.

A jog begins in state armed. The gateway is then in state running, while one axis has its offset voltage and
the other valves are centred. It goes back to state armed when the time is over, or at the travel fence.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hil.core.axis_loops import AxisLoops, LoopFailure
from hil.core.jog import Jog, JogEnd, limits_refusal
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.operating_state import OperatingState
from hil.core.output import NOTHING, Output, answer, combine
from hil.core.requests import JogRequest, Reply
from hil.core.rig import Rig

RELEASE_NS = 500_000_000
"""Time without a request after which an axis can be jogged again, if its jog was stopped."""


class Jogging:
    """The present jog, if there is one. The last one counts only in state running, until control starts.

    ``circumstances`` describes the boards, for refusals. ``enable_problem`` returns why the enable switch
    does not count as held at a time, or None.
    """

    def __init__(
        self,
        rig: Rig,
        loops: AxisLoops,
        state: OperatingState,
        circumstances: Callable[[], str],
        enable_problem: Callable[[int], str | None],
    ) -> None:
        self._rig = rig
        self._loops = loops
        self._state = state
        self._circumstances = circumstances
        self._enable_problem = enable_problem
        self._jog: Jog | None = None
        self._refused_until_ns: int | None = None
        """Time until which jogs are refused, because whoever jogs has not let go yet; None before a stop."""

    @property
    def is_active(self) -> bool:
        """True if an axis is jogged."""
        return self._jog is not None and self._state.current is LifeCycleState.RUNNING

    def cancel(self) -> None:
        """Forget the last jog, because the controllers take over."""
        self._jog = None

    def await_release(self, now_ns: int) -> None:
        """Refuse jogs until nobody has asked for one for ``RELEASE_NS``: the present one was stopped.

        Otherwise the next request of whoever jogs would begin it again.
        """
        self._refused_until_ns = now_ns + RELEASE_NS

    def take(self, request: JogRequest, now_ns: int) -> Output:
        """Begin or extend a jog of an axis that the rig has, or refuse it."""
        reason = self._refusal(request, now_ns)
        if reason is not None:
            return answer(request.axis, Reply(False, f"jog refused: {reason}"))
        motion = f"{request.offset_v:+g} V for {request.duration_s:g} s"
        if self._jog is not None and self.is_active:
            self._jog.extend(request, now_ns)
            return Output(reply=Reply(True, f"jog goes on: {motion}"))
        self._loops.restart()
        self._jog = Jog(self._rig.axes[request.axis], request, now_ns)
        begun = answer(request.axis, Reply(True, f"jog begins: {motion}"))
        return combine(self._state.enter(Trigger.START, "jog"), begun)

    def begin_period(self, now_ns: int) -> Output:
        """End a jog whose time is over."""
        if self._jog is None or not self.is_active or now_ns < self._jog.end_ns:
            return NOTHING
        return self.end("its time is over")

    def move(self, volts: Sequence[float], deadline_ns: int, now_ns: int) -> JogEnd | LoopFailure | None:
        """Command the jogged axis; see :meth:`AxisLoops.jog`."""
        assert self._jog is not None
        return self._loops.jog(self._jog, volts, deadline_ns, now_ns)

    def end(self, cause: str) -> Output:
        """Go back to state armed because of ``cause``.

        The caller sends the command that centres the valves.
        """
        return self._state.enter(Trigger.STOP, f"jog ended: {cause}")

    def _refusal(self, request: JogRequest, now_ns: int) -> str | None:
        """Return why a jog is not possible now, or None."""
        state, axis = self._state.current, request.axis
        if self._refused_until_ns is not None and now_ns < self._refused_until_ns:
            self.await_release(now_ns)
            return f"the jog was stopped; let go, and jog again after {RELEASE_NS / 1e9:g} s"
        if self._jog is not None and self.is_active:
            if self._jog.axis != axis:
                return f"{self._jog.axis} is being jogged; one axis at a time"
        elif state is not LifeCycleState.ARMED:
            return f"the state is {state.name.lower()} ({self._circumstances()}), but must be armed"
        if self._loops.experiment is not None:
            return "an experiment is planned, which begins with the next start"
        if (problem := self._enable_problem(now_ns)) is not None:
            return f"enable: {problem}"
        return limits_refusal(request, self._rig.axes[axis]) or self._loops.position_refusal(axis)
