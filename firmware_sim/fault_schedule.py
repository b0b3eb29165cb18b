"""When faults begin and end: their times, their conditions, and the agenda of what is due.

``FaultyRig`` says what has passed on the bus. What a fault does is in ``fault_effects``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from heapq import heappop, heappush
from random import Random
from typing import Final, TypeAlias

from firmware_sim.boards.canopen_slave import Frames
from firmware_sim.faults.condition import Condition, Observation, parse_condition
from firmware_sim.faults.fault_text import fault_text
from firmware_sim.faults.frame_faults import counts_of
from firmware_sim.faults.kinds import FRAME_IDS, AnyFault
from hil.core.frames import Frame
from hil.core.rig import Rig

SAMPLE_ID: Final = FRAME_IDS["sample"]
COMMAND_ID: Final = FRAME_IDS["command"]
_COUNTS_PER_V: Final = (1 << 15) / 10.0

Action: TypeAlias = Callable[[int], Frames]
"""What happens at an instant in nanoseconds, its argument. Returns frames to the gateway."""


class Agenda:
    """Actions that are due at an instant, in the order of their instants and then of their addition."""

    def __init__(self) -> None:
        self.entries: list[tuple[int, int, Action]] = []
        """Heap of instants in nanoseconds, numbers and actions."""
        self._count = 0

    def add(self, due_ns: int, action: Action) -> None:
        """Add an action that is due at ``due_ns``."""
        self._count += 1  # keeps the order of actions that are due at the same instant
        heappush(self.entries, (due_ns, self._count, action))

    def run(self, now_ns: int) -> Frames:
        """Do what is due at ``now_ns`` or before. Returns frames to the gateway."""
        frames: Frames = ()
        while self.entries and self.entries[0][0] <= now_ns:
            due_ns, _, action = heappop(self.entries)
            frames += action(due_ns)
        return frames


class FaultSchedule:
    """Begins and ends each fault at its time, or after its condition.

    ``last`` has the last frame on the bus by identifier; its owner adds each frame before it calls this
    object. ``begin`` and ``end`` do what a fault does. They are given the fault and the time in nanoseconds,
    and ``begin`` the fault's randomness between them; they return frames to the gateway.
    """

    def __init__(
        self,
        rig: Rig,
        agenda: Agenda,
        last: Mapping[int, Frame],
        begin: Callable[[AnyFault, Random, int], Frames],
        end: Callable[[AnyFault, int], Frames],
    ) -> None:
        self.waiting: list[tuple[Condition, AnyFault, Random]] = []
        """Faults whose condition is not met yet."""
        self._rig = rig
        self._agenda = agenda
        self._last = last
        self._begin_fault = begin
        self._end_fault = end
        self._is_running = False
        self._state = ""
        """State that the gateway has entered last; empty if nobody has said."""
        centre_v = [5.0, 5.0, 5.0]
        for axis in rig.axes.values():
            centre_v[axis.valve.channel - 1] = axis.valve.centre_v
        self._centre_counts = [round(volts * _COUNTS_PER_V) for volts in centre_v]

    def plan(self, fault: AnyFault, random: Random, now_ns: int) -> None:
        """Let a fault begin ``at_s`` seconds after ``now_ns``, or after its condition."""
        if COMMAND_ID in self._last:
            self.note_command(self._last[COMMAND_ID])
        if fault.when:
            self.wait_for_condition(fault, random)
        else:
            self._begin_later(fault, random, now_ns)

    def wait_for_condition(self, fault: AnyFault, random: Random) -> None:
        """Let a fault begin ``at_s`` seconds after its condition. Without one, that is the first sample."""
        condition = parse_condition(fault.when, list(self._rig.axes), f"fault {fault_text(fault)!r}")
        self.waiting.append((condition, fault, random))

    def note_command(self, frame: Frame) -> None:
        """Take a command frame: the first one that moves a valve shows that control has begun."""
        if not self._is_running:
            offsets = zip(counts_of(frame), self._centre_counts, strict=True)
            self._is_running = any(abs(counts - centre) > 1 for counts, centre in offsets)

    def judge_conditions(self, now_ns: int) -> Frames:
        """Schedule the faults whose condition is met by the last frames, and begin those that are due."""
        return self._agenda.run(now_ns) if self._schedule_met(now_ns) else ()

    def gateway_entered(self, state: str, now_ns: int) -> None:
        """Take note of a state of the gateway. A fault that is due begins when the agenda is run next."""
        self._state = state
        self._schedule_met(now_ns)

    def _schedule_met(self, now_ns: int) -> bool:
        """Schedule the faults whose condition is met. Return whether there are any."""
        seen = Observation(SAMPLE_ID in self._last, self._is_running, self._positions(), self._state)
        met = [entry for entry in self.waiting if entry[0].is_met(seen)]
        self.waiting = [entry for entry in self.waiting if entry not in met]
        for _, fault, random in met:
            self._begin_later(fault, random, now_ns)
        return bool(met)

    def _positions(self) -> dict[str, float]:
        sample = self._last.get(SAMPLE_ID)
        if sample is None or not any(condition.axis for condition, _, _ in self.waiting):
            return {}
        counts = counts_of(sample)
        return {
            name: axis.potentiometer.position(counts[axis.potentiometer.channel - 1] / _COUNTS_PER_V)
            for name, axis in self._rig.axes.items()
        }

    def _begin_later(self, fault: AnyFault, random: Random, now_ns: int) -> None:
        self._agenda.add(now_ns + round(fault.at_s * 1e9), partial(self._begin, fault, random))

    def _begin(self, fault: AnyFault, random: Random, now_ns: int) -> Frames:
        frames = self._begin_fault(fault, random, now_ns)
        if fault.for_s is not None:
            self._agenda.add(now_ns + round(fault.for_s * 1e9), partial(self._end_fault, fault))
        return frames
