"""The response of a linear model to an input that is held constant (zero-order hold), with its dead time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Protocol

from firmware_sim.plants.linear_model import LinearModel
from firmware_sim.plants.step_table import State, Step, step_table


class Response(Protocol):
    """A linear model that was at rest with input 0 before its first ``advance``."""

    @property
    def output(self) -> float:
        """Output at the end of the last ``advance``."""

    def advance(self, duration_ns: int, u: float) -> None:
        """Hold the input at ``u`` for ``duration_ns``."""


def response_of(model: LinearModel, period_ns: int) -> Response:
    """Return the exact response of a model, with its dead time rounded to a nanosecond.

    ``period_ns`` is the usual duration of an advance, for which ``advance`` is fastest.
    Raises ValueError, which says what is wrong, for a model that cannot be simulated.
    """
    dead_time_ns = round(model.dead_time_s * 1e9)
    if not dead_time_ns:
        return HeldResponse(model, [period_ns])
    # A delayed change of the input divides a period into two parts.
    before_ns = dead_time_ns % period_ns
    return DelayedResponse(HeldResponse(model, [period_ns, before_ns, period_ns - before_ns]), dead_time_ns)


class HeldResponse:
    """The response of a model without its dead time.

    ``usual_ns`` are durations that occur often, for which ``advance`` is fastest.
    """

    __slots__ = ("_prepared", "_state", "_step", "_table", "output")

    def __init__(self, model: LinearModel, usual_ns: Iterable[int]) -> None:
        self._table = step_table(model)
        self._step = self._table.advance
        self._state: State = (0.0,) * self._table.order
        self._prepared: dict[int, Step] = {
            duration_ns: self._table.step(duration_ns) for duration_ns in usual_ns if duration_ns
        }
        self.output = 0.0

    def advance(self, duration_ns: int, u: float) -> None:
        """Hold the input at ``u`` for ``duration_ns``."""
        prepared = self._prepared.get(duration_ns)
        if prepared is not None:
            self._state, self.output = self._step(self._state, prepared, u)
            return
        for step in self._table.steps(duration_ns):
            self._state, self.output = self._step(self._state, step, u)


class DelayedResponse:
    """A response whose input is delayed by ``dead_time_ns``."""

    __slots__ = ("_dead_time_ns", "_input", "_pending", "_response", "_time_ns")

    def __init__(self, response: Response, dead_time_ns: int) -> None:
        self._response = response
        self._dead_time_ns = dead_time_ns
        self._time_ns = 0
        self._input = 0.0
        """Input that acts on the undelayed response now."""
        self._pending: deque[tuple[int, float]] = deque()
        """Inputs that act later because of the dead time: (time from which it acts, value)."""

    @property
    def output(self) -> float:
        """Output at the end of the last ``advance``."""
        return self._response.output

    def advance(self, duration_ns: int, u: float) -> None:
        """Hold the input at ``u`` for ``duration_ns``."""
        pending = self._pending
        if u != (pending[-1][1] if pending else self._input):
            pending.append((self._time_ns + self._dead_time_ns, u))
        end_ns = self._time_ns + duration_ns
        while pending and pending[0][0] < end_ns:
            due_ns, following = pending.popleft()
            self._response.advance(due_ns - self._time_ns, self._input)
            self._time_ns, self._input = due_ns, following
        self._response.advance(end_ns - self._time_ns, self._input)
        self._time_ns = end_ns
