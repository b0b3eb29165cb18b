"""The checks that must pass before the gateway arms, and their overrides.

State ready says that both boards are operational, that samples are fresh and that the emergency stop is
closed. No override replaces it. The other checks have names, and an operator may override each by its name:

===================  =========================  ==================================================
check                made by                    fails if
===================  =========================  ==================================================
``position-AXIS``    the core, at the request   the last position is outside the envelope
``controller-AXIS``  the core, at its start     the loop with the plant of the controller's file is
                                                unstable
others               the shell                  this machine lacks what the rig demands, such as a right
===================  =========================  ==================================================

The shell's results are part of the request, so that they are recorded with it and a replay has them too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from hil.core.axis_loops import AxisLoops
from hil.core.check_names import CONTROLLER, POSITION
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.operating_state import OperatingState
from hil.core.output import LogEntry, Output, Severity, combine
from hil.core.requests import ArmRequest, CheckFailure
from hil.core.rig import Rig

STAYS_REFUSED = ", because `hil start` and a jog of this axis stay refused, also with an override"
"""End of the text of a failed check of a position."""
SOURCE = "preflight"
"""Source of log entries about these checks."""


class Arming:
    """Makes the checks of a request to arm. ``controller_failures`` are given by axis name."""

    def __init__(
        self, rig: Rig, loops: AxisLoops, state: OperatingState, controller_failures: Mapping[str, str]
    ) -> None:
        self._axes = tuple(rig.axes)
        self._loops = loops
        self._state = state
        self._controller_failures = dict(controller_failures)
        self._overridden: tuple[str, ...] = ()
        self.disabled_checks = tuple(_disabled_checks(rig))
        """Warnings of the envelope's checks that the rig file disables, for each arming and each start."""

    @property
    def overridden(self) -> tuple[str, ...]:
        """Names of the failed checks that an operator has overridden; empty unless armed or running."""
        is_armed = self._state.current in (LifeCycleState.ARMED, LifeCycleState.RUNNING)
        return self._overridden if is_armed else ()

    def controller_changed(self, axis: str) -> None:
        """Forget that the first controller of ``axis`` failed its check: a checked one has replaced it."""
        self._controller_failures.pop(axis, None)

    def arm(self, request: ArmRequest) -> Output:
        """Enter state armed, or report which checks do not allow it. The present state must allow it."""
        failures = [*request.failures, *self._core_failures()]
        remaining = [failure for failure in failures if failure.check not in request.overrides]
        if remaining:
            return _refusal(remaining)
        self._overridden = tuple(failure.check for failure in failures)
        warnings = tuple(
            LogEntry(Severity.WARNING, SOURCE, f"{check} is overridden: {text}") for check, text in failures
        )
        return combine(self._state.enter(Trigger.ARM), Output(log=warnings + self.disabled_checks))

    def _core_failures(self) -> Iterator[CheckFailure]:
        for axis in self._axes:
            text = self._loops.position_refusal(axis)
            if text is not None:
                yield CheckFailure(f"{POSITION}{axis}", text + STAYS_REFUSED)
            if axis in self._controller_failures:
                yield CheckFailure(f"{CONTROLLER}{axis}", self._controller_failures[axis])


def _refusal(failures: Sequence[CheckFailure]) -> Output:
    """Return the refusal to arm, which says what each check has found and how to arm all the same."""
    found = "; ".join(f"{check}: {text}" for check, text in failures)
    names = " ".join(check for check, _ in failures)
    text = f"arm refused: {found}; or arm all the same with --override {names}"
    return Output(log=(LogEntry(Severity.WARNING, SOURCE, text),))


def _disabled_checks(rig: Rig) -> Iterator[LogEntry]:
    """Yield a warning for each axis with checks that are disabled or cannot act."""
    for name, axis in rig.axes.items():
        if axis.envelope.disabled:
            keys = ", ".join(axis.envelope.disabled)
            text = f"not protected by {keys} (rig: axes.{name}.envelope.disabled)"
            yield LogEntry(Severity.WARNING, name, text)
        opening_v, far_open_v = axis.range.valve_v, axis.limits.far_open_v
        if opening_v < far_open_v and "max_still_s" not in axis.envelope.disabled:
            text = (
                f"not protected by max_still_s, because the valve opens by {opening_v:g} V (rig: "
                f"axes.{name}.valve) and is far open from {far_open_v:g} V on; give "
                f"axes.{name}.envelope.far_open_v"
            )
            yield LogEntry(Severity.WARNING, name, text)
