"""The rules for what a gateway may send, checked after every call from the frames and the log alone.

=====================  =================================================================================
rule                   what must hold
=====================  =================================================================================
magnitude              each valve is within its limits; a channel without an axis has 5 V
rate                   a valve moves by no more than its rate allows since the last command
centre                 outside state running, every command centres all valves
answer                 a command that opens a valve answers an intact, new and timely sample
frame                  identifiers, lengths, counters and checksums of what the gateway sends
life cycle             only transitions of the table, each with its cause
fault                  what must be a fault is one in the same call, and centres the valves
stop                   what must end a motion ends it in the same call, and centres the valves
SYNC                   at most one SYNC in a period; a change of state does not wait for one
number                 signals are finite numbers, and positions are those of the sample
=====================  =================================================================================

The checker imports nothing from the gateway. It reads frames, log entries and cycles by their attributes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from fuzz import rigs, wire
from fuzz.broken_rule import BrokenRule
from fuzz.followers import ROUNDING, Contact, Motion, ReadBack
from fuzz.life_cycle_follower import LifeCycleFollower
from fuzz.rigs import Axis, RigFacts

PERIOD_NS = rigs.PERIOD_NS
BUS_OFF = 0x40
FATAL = 50
MAX_SILENT_PERIODS = 5
"""Largest number of consecutive periods without SYNC, to find out whether samples are late."""
STATES = ("offline", "ready", "armed", "running", "fault")
"""States of the life cycle, in the order of their numbers in a cycle."""
_MOTION = frozenset({"armed", "running"})


class Jog(NamedTuple):
    """A request to jog an axis."""

    axis: str
    offset_v: float
    duration_s: float


class Arm(NamedTuple):
    """A request to arm with results of checks."""

    may_arm: bool
    """True if each failed check is overridden."""


class Sent(NamedTuple):
    """A command that the bus took."""

    counts: tuple[int, int, int]
    now_ns: int
    is_rest: bool
    """True if the valves rest at their centres: state running is over or has not moved them yet."""
    data: bytes


class Checker:
    """Observer of one gateway. ``given_…`` is called before a call of the gateway, ``returned`` after it."""

    def __init__(self, rig: RigFacts, first_deadline_ns: int) -> None:
        self.rig = rig
        self.follower = LifeCycleFollower()
        self.open_commands = 0
        """Number of commands so far that open a valve."""
        self._sample_length = wire.length(wire.ANALOGUE_LENGTH, rig.adc_protected)
        self._command_length = wire.length(wire.ANALOGUE_LENGTH, rig.dac_protected)
        self._centre = _centre_counts(rig.axes)
        self._motions = [Motion(axis) for axis in rig.axes]
        self._stop = Contact(rigs.STOP_MASK, rig) if rig.has_stop else None
        self._enable = Contact(rigs.ENABLE_MASK, rig) if rig.has_enable else None
        self._read_back = ReadBack(rig) if rig.read_back else None
        self._commands = [Sent(self._centre, 0, True, b"")]
        """The last commands that the bus took, the newest at the end."""
        self._command_counter = 0
        self._heartbeat_ns: dict[int, int | None] = {wire.ADC_HEARTBEAT: None, wire.DAC_HEARTBEAT: None}
        # The present period.
        self._due_ns = first_deadline_ns
        self._deadline_ns = first_deadline_ns
        self._number = -1
        self._fresh_number = -1
        self._sync_ns: int | None = None
        """Time of the last SYNC; None if its answer has been taken."""
        self._silent_periods = 0
        self._is_very_late = False
        self._state_at_deadline = "offline"
        # The present stay in state running.
        self._jog: Jog | None = None
        self._jog_end_ns = 0
        self._is_first_sample = True
        self._sample_counter: int | None = None
        # The present call.
        self._kind = ""
        self._request: object = None
        self._fault_due: str | None = None
        self._stop_due: str | None = None
        self._sample: bytes | None = None
        self._sample_problem = "the call is no sample"
        self._has_faulted = self._has_sync = False
        self._before = self._centre
        """Counts of the last command before the call."""

    # Before a call

    def given_deadline(self, now_ns: int) -> None:
        """Prepare for ``on_deadline``."""
        self._begin("deadline", now_ns)
        skipped = max((now_ns - self._due_ns) // PERIOD_NS, 0)
        self._number += 1 + skipped
        self._deadline_ns = self._due_ns + skipped * PERIOD_NS
        self._due_ns = self._deadline_ns + PERIOD_NS
        self._is_very_late = now_ns - self._deadline_ns > PERIOD_NS // 2
        for identifier, heartbeat_ns in self._heartbeat_ns.items():
            if heartbeat_ns is not None and now_ns - heartbeat_ns > rigs.HEARTBEAT_TIMEOUT_NS:
                self._heartbeat_ns[identifier] = None
                self._fault_due = f"no heartbeat 0x{identifier:03X}"
        if self._number - 1 - self._fresh_number >= self.rig.stale_periods:
            self._fault_due = "no good sample for too long"
        self._require_contacts(now_ns)
        if self._jog is not None and now_ns >= self._jog_end_ns:
            self._stop_due = self._stop_due or "the time of the jog is over"

    def given_frame(
        self, identifier: int, data: bytes, is_extended: bool, is_remote: bool, is_error: bool, now_ns: int
    ) -> None:
        """Prepare for ``receive``."""
        self._begin("frame", now_ns)
        if is_error:
            self._fault_due = "bus-off" if identifier & BUS_OFF else None
        elif is_extended or is_remote:
            return
        elif identifier == wire.SAMPLE:
            self._sample, self._sample_problem = data, self._find_sample_problem(data, now_ns)
        elif identifier in self._heartbeat_ns:
            if len(data) == 1:
                self._heartbeat_ns[identifier] = now_ns
                if data[0] != wire.OPERATIONAL:
                    self._fault_due = f"heartbeat 0x{identifier:03X} is not operational"
        elif identifier in (wire.ADC_EMERGENCY, wire.DAC_EMERGENCY):
            if len(data) == 8 and data[:2] != b"\0\0":
                self._fault_due = f"emergency 0x{identifier:03X}"
        elif identifier in wire.OF_THE_GATEWAY or identifier in wire.COMMANDS_TO_BOARDS:
            self._fault_due = f"foreign frame 0x{identifier:03X}"
        elif identifier == wire.INPUTS:
            for contact in (self._stop, self._enable):
                if contact is not None:
                    contact.take(data, now_ns)
            self._require_contacts(now_ns)
        elif identifier == wire.READ_BACK and self._read_back is not None:
            self._read_back.take(data)
            self._fault_due = self._read_back.problem

    def given_request(self, request: object, now_ns: int) -> None:
        """Prepare for ``operate``. ``request`` is the trigger as text, a :class:`Jog`, or anything else."""
        self._begin("request", now_ns)
        self._request = request
        self._require_contacts(now_ns)
        if request == "stop":
            self._stop_due = "an operator stops"

    def given_link_failure(self, now_ns: int) -> None:
        """Prepare for ``link_failed``."""
        self._begin("link", now_ns)
        self._fault_due = "the link has failed"

    def refused(self, data: bytes) -> None:
        """Take back the last command with this data, because the bus refused it."""
        for place in reversed(range(1, len(self._commands))):
            if self._commands[place].data == data:
                del self._commands[place]
                return

    # After a call

    def returned(self, output: Any, now_ns: int) -> None:
        """Check what the call returned. Raises BrokenRule."""
        before = self.follower.state
        log = output.log
        if log:
            self._follow_log(log, before)
        state = self.follower.state
        commands = self._check_frames(output.frames, before, now_ns)
        if self._fault_due is not None and before in _MOTION and not self._has_faulted:
            raise BrokenRule("fault", f"state {state} after: {self._fault_due}")
        if self._stop_due is not None and state == "running":
            raise BrokenRule("stop", f"state running after: {self._stop_due}")
        has_left = before == "running" and state != "running"
        if (has_left or self._has_faulted) and commands[-1:] != [self._centre]:
            raise BrokenRule("centre", f"{before} -> {state} without a command that centres the valves")
        if output.cycle is not None:
            self._check_cycle(output.cycle, before, commands)
        if self._kind == "deadline":
            self._check_deadline(state, commands, [frame.id for frame in output.frames])
        elif self._kind == "request" and not (output.reply is not None and output.reply.text):
            raise BrokenRule("life cycle", "a request without a reply")
        if isinstance(self._request, Jog) and output.reply.accepted:
            self._take_jog(self._request, now_ns)

    def _begin(self, kind: str, now_ns: int) -> None:
        self._kind = kind
        self._request = self._fault_due = self._stop_due = self._sample = None
        self._sample_problem = "the call is no sample"
        self._has_faulted = self._has_sync = False
        self._before = self._commands[-1].counts

    def _require_contacts(self, now_ns: int) -> None:
        if self._stop is not None and not self._stop.is_closed(now_ns):
            self._fault_due = "the emergency stop is open"
        if self._enable is not None and not self._enable.is_closed(now_ns):
            is_needed = self._jog is not None or self.rig.excited is not None
            self._stop_due = "the enable switch is open" if is_needed else None

    def _find_sample_problem(self, data: bytes, now_ns: int) -> str:
        """Return why a sample must not be used, or an empty text. The gateway may have further reasons."""
        if len(data) != self._sample_length:
            return f"{len(data)} bytes"
        if self._sync_ns is None or now_ns - self._sync_ns > PERIOD_NS:
            return "no SYNC of the last period is unanswered"
        counts = wire.counts_of(data)
        for axis in self.rig.axes:
            volts = counts[axis.channel - 1] * wire.COUNT_V
            if not axis.sensor_v[0] <= volts <= axis.sensor_v[1]:
                return f"{volts} V"
        if not self.rig.adc_protected:
            return ""
        if not wire.is_intact(wire.SAMPLE, data, self.rig.wire_version):
            return "checksum"
        before = self._sample_counter
        if before is not None and not 0 < (wire.counter_of(data) - before) % 256 < 128:
            return f"counter {wire.counter_of(data)} after {before}"
        return ""

    def _follow_log(self, log: Sequence[Any], before: str) -> None:
        names = {Jog: "jog", Arm: "arm"}
        request = names.get(type(self._request), self._request)
        texts = [entry.text for entry in log if entry.source == "life cycle"]
        changes = self.follower.take(texts, request if isinstance(request, str) else None)
        self._has_faulted = "fault" in changes.causes
        if self._has_faulted != any(entry.severity == FATAL for entry in log):
            raise BrokenRule("fault", f"severities do not fit the changes {changes.causes}")
        if "arm" in changes.causes and isinstance(self._request, Arm) and not self._request.may_arm:
            raise BrokenRule("life cycle", "armed in spite of a failed check")
        if "boards up" in changes.causes and self._sample_problem:
            raise BrokenRule("answer", f"ready without a good sample: {self._sample_problem}")
        if "start" in changes.causes:
            self._is_first_sample = True
            self._sample_counter = None
            self._jog = self._request if changes.is_jog and isinstance(self._request, Jog) else None
        elif changes.causes:
            self._jog = self._sample_counter = None

    def _check_frames(self, frames: Sequence[Any], before: str, now_ns: int) -> list[tuple[int, int, int]]:
        """Check all frames, and return the commands among them."""
        commands = []
        for identifier, data, is_extended, is_remote, is_error in frames:
            if is_extended or is_remote or is_error:
                raise BrokenRule("frame", f"0x{identifier:X} is no standard data frame")
            if identifier == wire.COMMAND:
                commands.append(self._check_command(data, before, now_ns))
            elif identifier == wire.SYNC:
                self._check_sync(data, now_ns)
            elif identifier == wire.GATEWAY_HEARTBEAT:
                is_good = data == bytes((wire.OPERATIONAL,)) and self._kind == "deadline"
            elif identifier == wire.NMT:
                is_good = data in (b"\x01\x10", b"\x01\x20")
            else:
                is_good = identifier in (0x610, 0x620) and len(data) == 8 and data[0] == 0x40
            if identifier not in (wire.COMMAND, wire.SYNC) and not is_good:
                raise BrokenRule("frame", f"0x{identifier:03X} {data.hex()} in a call {self._kind}")
        return commands

    def _check_sync(self, data: bytes, now_ns: int) -> None:
        if data or self._kind != "deadline" or self._has_sync:
            raise BrokenRule("SYNC", f"SYNC with {data.hex()!r} in a call {self._kind}")
        self._sync_ns = now_ns
        self._has_sync = True
        if self._read_back is not None:
            self._read_back.sync(self._commands[-1].counts)
            self._fault_due = self._fault_due or self._read_back.problem

    def _check_command(self, data: bytes, before: str, now_ns: int) -> tuple[int, int, int]:
        if len(data) != self._command_length:
            raise BrokenRule("frame", f"command with {len(data)} bytes")
        if self.rig.dac_protected:
            is_counted = wire.counter_of(data) == self._command_counter & 0xFF
            if not (is_counted and wire.is_intact(wire.COMMAND, data, self.rig.wire_version)):
                raise BrokenRule("frame", f"command {data.hex()}, counter should be {self._command_counter}")
        self._command_counter += 1
        counts, last = wire.counts_of(data), self._commands[-1]
        is_running = before == "running" and self.follower.state == "running"
        if counts != self._centre:
            self._check_open(counts, last, is_running, now_ns)
        is_rest = not (is_running and self._sample is not None)
        self._commands = [*self._commands[-7:], Sent(counts, now_ns, is_rest, data)]
        return counts

    def _check_open(self, counts: tuple[int, int, int], last: Sent, is_running: bool, now_ns: int) -> None:
        """Check a command that does not centre all valves."""
        self.open_commands += 1
        if not is_running:
            raise BrokenRule("centre", f"{counts} counts in state {self.follower.state}")
        if self._sample_problem:
            raise BrokenRule("answer", f"{counts} counts: {self._sample_problem}")
        if self._stop is not None and not self._stop.is_closed(now_ns):
            raise BrokenRule("answer", f"{counts} counts with an open emergency stop")
        rest = list(counts)
        elapsed_ns = PERIOD_NS if last.is_rest else min(now_ns - last.now_ns, PERIOD_NS)
        for axis in self.rig.axes:
            place = axis.valve_channel - 1
            count, rest[place] = counts[place], wire.CENTRE_COUNTS
            if not axis.valve_v[0] <= count * wire.COUNT_V <= axis.valve_v[1]:
                raise BrokenRule("magnitude", f"{axis.name}: {count * wire.COUNT_V} V")
            if self._jog is not None and self._jog.axis != axis.name:
                if count != self._centre[place]:
                    raise BrokenRule(
                        "centre", f"{axis.name}: {count} counts while {self._jog.axis} is jogged"
                    )
                continue
            step_v = abs(count - last.counts[place]) * wire.COUNT_V
            # Both commands are rounded to a count.
            if step_v > axis.max_rate_v_s * elapsed_ns / 1e9 + wire.COUNT_V + ROUNDING:
                raise BrokenRule("rate", f"{axis.name}: {step_v} V in {elapsed_ns} ns")
            offset_v = abs(count - self._centre[place]) * wire.COUNT_V
            if self._jog is not None and offset_v > axis.jog_max_v + wire.COUNT_V:
                raise BrokenRule("magnitude", f"{axis.name}: {offset_v} V in a jog")
        if rest != [wire.CENTRE_COUNTS] * wire.CHANNELS:
            raise BrokenRule("magnitude", f"channel without an axis: {counts} counts")

    def _check_deadline(
        self, state: str, commands: Sequence[tuple[int, ...]], identifiers: Sequence[int]
    ) -> None:
        if self._has_sync:
            self._silent_periods = 0
        elif not self._is_very_late:
            self._silent_periods += 1
        may_be_silent = state == self._state_at_deadline and state != "fault"
        if self._silent_periods > MAX_SILENT_PERIODS or not (self._has_sync or may_be_silent):
            raise BrokenRule("SYNC", f"{self._silent_periods} periods without SYNC in state {state}")
        self._state_at_deadline = state
        if state != "running" and self._before != self._centre:
            is_first = (
                identifiers.index(wire.COMMAND) < identifiers.index(wire.SYNC) if self._has_sync else False
            )
            if not is_first:
                raise BrokenRule("SYNC", f"open valves are not centred before SYNC: {identifiers}")
        if (state == "running") != (not commands):
            raise BrokenRule("centre", f"{len(commands)} commands at a deadline in state {state}")

    def _check_cycle(self, cycle: Any, before: str, commands: Sequence[tuple[int, ...]]) -> None:
        if not cycle.fresh:
            return
        state = self.follower.state
        if self._sample is None or self._sample_problem:
            raise BrokenRule("answer", f"a sample was taken as fresh: {self._sample_problem}")
        if STATES[cycle.state] != state:
            raise BrokenRule("life cycle", f"the cycle says {cycle.state!r} in state {state}")
        self._sync_ns = None
        self._fresh_number = self._number
        # In other states, the gateway may forget the counter, because the board may have restarted.
        is_counted = self.rig.adc_protected and state == "running"
        self._sample_counter = wire.counter_of(self._sample) if is_counted else None
        counts = wire.counts_of(self._sample)
        for axis, signals in zip(self.rig.axes, cycle.axes, strict=True):
            self._check_signals(axis, signals, counts[axis.channel - 1], state)
        if before != "running":
            return
        if state == "running" and len(commands) != 1:
            raise BrokenRule("answer", f"{len(commands)} commands in answer to a sample")
        self._check_motions(cycle.axes, counts, state, commands)

    def _check_signals(self, axis: Axis, signals: Any, counts: int, state: str) -> None:
        r, y, error, output_v, command_v, potentiometer_v, _ = signals
        if not all(map(math.isfinite, (r, y, error, command_v, potentiometer_v))):
            raise BrokenRule("number", f"{axis.name}: {signals}")
        if not math.isfinite(output_v) and state != "fault":
            raise BrokenRule("number", f"{axis.name}: {output_v} V in state {state}")
        # After a failure of one axis, the axes after it keep the signals of the sample before.
        is_of_sample = potentiometer_v == counts * wire.COUNT_V and abs(y - axis.position(counts)) <= ROUNDING
        if not is_of_sample and state != "fault":
            raise BrokenRule("number", f"{axis.name}: position {y}, {potentiometer_v} V of {counts} counts")

    def _check_motions(
        self, signals: Sequence[Any], counts: Sequence[int], state: str, commands: Sequence[tuple[int, ...]]
    ) -> None:
        for axis, motion, of_axis in zip(self.rig.axes, self._motions, signals, strict=True):
            if self._jog is not None and axis.name != self._jog.axis:
                continue
            if self._is_first_sample:
                motion.begin()
            y = axis.position(counts[axis.channel - 1])
            is_followed = self._jog is None and axis.name != self.rig.excited
            error = of_axis.setpoint - y if is_followed else 0.0
            violation = motion.violation(self._deadline_ns, y, error)
            if violation is None and state == "running":
                offset_v = of_axis.command_v - axis.centre_v
                if abs(of_axis.command_v / wire.COUNT_V - commands[0][axis.valve_channel - 1]) > 0.5 + 1e-6:
                    raise BrokenRule("number", f"{axis.name}: {of_axis.command_v} V, {commands[0]} counts")
                violation = motion.standstill(self._deadline_ns, y, offset_v)
            if violation is not None and state == "running":
                raise BrokenRule("fault", f"{axis.name}: state running after: {violation}")
        self._is_first_sample = False

    def _take_jog(self, jog: Jog, now_ns: int) -> None:
        axis = next(axis for axis in self.rig.axes if axis.name == jog.axis)
        is_moved = self._jog is not None and self._jog.axis == jog.axis
        is_allowed = abs(jog.offset_v) <= axis.jog_max_v and 0.0 < jog.duration_s <= axis.jog_max_s
        is_held = self._enable is None or self._enable.is_closed(now_ns)
        if not (is_allowed and is_moved and is_held and self.follower.state == "running"):
            raise BrokenRule("life cycle", f"{jog} was accepted, state {self.follower.state}, {self._jog}")
        self._jog = jog
        self._jog_end_ns = now_ns + round(jog.duration_s * 1e9)


def _centre_counts(axes: Sequence[Axis]) -> tuple[int, int, int]:
    counts = [wire.CENTRE_COUNTS] * wire.CHANNELS
    for axis in axes:
        counts[axis.valve_channel - 1] = round(axis.centre_v / wire.COUNT_V)
    first, second, third = counts
    return first, second, third
