"""The independent control loops of the axes: potentiometer voltages in, limited valve commands out.

Each axis has its own setpoint, control law and potentiometer scaling. No signal crosses from one axis to
another. Every command passes the limits of ``valve_commands``. The gateway decides which sample is used,
and in which state the control laws act.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from hil.core.control_law import ControlLaw, Matching
from hil.core.envelope import Envelope
from hil.core.excitation import samples
from hil.core.excited_loop import ExcitedLoop, Fence
from hil.core.experiment import Experiment
from hil.core.frames import Frame
from hil.core.jog import Jog, JogEnd
from hil.core.output import AxisSignals
from hil.core.phase import Phase
from hil.core.references import (
    GivenSetpoint,
    HeldPosition,
    LimitedSetpoint,
    OperatorSetpoints,
    Reference,
    present_step,
)
from hil.core.rig import Rig
from hil.core.setpoints import HOLD, Function, Setpoint
from hil.core.valve_commands import ValveCommands, command_crc


class LoopFailure(NamedTuple):
    """Reason why an axis must not go on, which is a fault."""

    axis: str
    reason: str


class AxisLoop:
    """Setpoint, control law, envelope, scaling and last signals of one axis."""

    __slots__ = ("envelope", "first_reference", "law", "name", "position", "reference", "setpoint", "signals")

    def __init__(self, rig: Rig, name: str, law: ControlLaw, setpoint: Setpoint) -> None:
        axis = rig.axes[name]
        self.name = name
        self.law = law
        self.first_reference: Reference = HeldPosition() if setpoint.text == HOLD else GivenSetpoint(setpoint)
        self.reference: Reference = self.first_reference
        self.setpoint: Function = setpoint.at
        """Setpoint r(t) since control began."""
        self.position = axis.potentiometer.position
        self.envelope = Envelope(axis.limits, name, axis.unit)
        self.signals = AxisSignals(math.nan, math.nan, math.nan, 0.0, axis.valve.centre_v, math.nan)

    @property
    def phase(self) -> Phase:
        """Phase of the experiment in which this axis is excited."""
        return Phase.NONE

    def first_setpoint(self, y: float) -> float:
        """Return the setpoint with which control begins at position ``y``."""
        return self.reference.first(y)

    def begin(self, t: float, y: float) -> None:
        """Take over without a bump, at position ``y`` and time ``t``, with the valve at its centre."""
        self.setpoint = self.reference.begin(t, y)
        self.law.initialise(self.setpoint(t), y, 0.0)

    def output(self, t: float, y: float) -> tuple[float, float]:
        """Return setpoint r, and valve voltage u relative to the valve's centre, for the sample ``y``."""
        r = self.setpoint(t)
        return r, self.law.output(r, y)

    def advance(self, u_applied: float) -> None:
        """Take the voltage that the limits let through, relative to the valve's centre."""
        self.law.advance(u_applied)


class ExcitedAxis(AxisLoop):
    """The axis that an experiment excites."""

    __slots__ = ("excited",)

    def __init__(
        self, rig: Rig, name: str, law: ControlLaw, setpoint: Setpoint, experiment: Experiment
    ) -> None:
        super().__init__(rig, name, law, setpoint)
        axis = rig.axes[name]
        fence = Fence(*axis.fence_limits)
        values = samples(experiment.signal, rig.loop.period_s).tolist()
        self.excited = ExcitedLoop(law, experiment, values, fence)

    @property
    def phase(self) -> Phase:
        """Phase of the experiment."""
        return self.excited.phase

    def first_setpoint(self, y: float) -> float:
        """Return the position ``y``, from which the experiment approaches its centre."""
        return y

    def begin(self, t: float, y: float) -> None:
        """Begin the experiment at position ``y``."""
        self.excited.begin(t, y)

    def output(self, t: float, y: float) -> tuple[float, float]:
        """Return setpoint r, and valve voltage u relative to the valve's centre, for the sample ``y``."""
        signals = self.excited.output(t, y)
        self.envelope.follows_setpoint = self.excited.follows_setpoint
        return signals

    def advance(self, u_applied: float) -> None:
        """Take the voltage that the limits let through, relative to the valve's centre."""
        self.excited.advance(u_applied)


class AxisLoops:
    """The loops of all axes, in the order of the rig file.

    ``laws`` and ``setpoints`` are given by axis name. Voltages are in volts, times in monotonic nanoseconds.
    """

    def __init__(
        self,
        rig: Rig,
        laws: Mapping[str, ControlLaw],
        setpoints: Mapping[str, Setpoint],
        experiment: Experiment | None = None,
    ) -> None:
        self._axes = tuple(
            _axis_loop(rig, name, laws[name], setpoints[name], experiment) for name in rig.axes
        )
        self._excited = next((axis.excited for axis in self._axes if isinstance(axis, ExcitedAxis)), None)
        self._valves = ValveCommands(
            [axis.valve for axis in rig.axes.values()], rig.loop.period_s, command_crc(rig)
        )
        self._operators = tuple(OperatorSetpoints(axis, rig.loop.period_s) for axis in rig.axes.values())
        self._places = {name: place for place, name in enumerate(rig.axes)}
        self._period_s = rig.loop.period_s
        self._start_ns: int | None = None
        """Deadline of the first controlled period, at which the setpoints' time is 0."""
        self._last_command_ns: int | None = None
        self._t = 0.0
        """Time of the last controlled sample in seconds since control began."""

    @property
    def signals(self) -> tuple[AxisSignals, ...]:
        """Last signals of every axis."""
        return tuple([axis.signals for axis in self._axes])

    @property
    def commanded_v(self) -> Sequence[float]:
        """Last commands in volts, in the order of the rig's axes."""
        return self._valves.volts

    @property
    def experiment(self) -> ExcitedLoop | None:
        """The loop that an experiment excites, or None if the run is no experiment."""
        return self._excited

    def restart(self) -> None:
        """Begin at t = 0 with the next controlled period. Every control law then starts without a bump."""
        self._start_ns = None
        if self._valves.are_centred:
            self._last_command_ns = None
        # Otherwise the bus has refused the command that centres the valves, and the last one still counts.

    def start_refusals(self) -> list[LoopFailure]:
        """Return why control must not begin, axis by axis: positions and first setpoints that do not fit."""
        found = (
            (axis, axis.envelope.refusal(axis.first_setpoint(y), y))
            for axis in self._axes
            for y in (axis.signals.position,)
        )
        return [LoopFailure(axis.name, reason) for axis, reason in found if reason is not None]

    def control(self, volts: Sequence[float], deadline_ns: int, now_ns: int) -> LoopFailure | None:
        """Run every control law on its sample, limit its output, and check the axis' envelope.

        ``volts`` are the potentiometer voltages, received at ``now_ns`` in the period of ``deadline_ns``. The
        setpoints are evaluated at the time from the first controlled period to this one.

        Returns None, or the first failure: an output that is not finite, or a violated envelope. No command
        but the one that centres the valves may then leave.
        """
        failure: LoopFailure | None = None
        is_first = self._start_ns is None
        if self._start_ns is None:
            self._start_ns = deadline_ns
        t = (deadline_ns - self._start_ns) / 1e9
        self._t = t
        self._valves.set_change_time(self._elapsed_s(now_ns))
        self._last_command_ns = now_ns
        for index, (axis, measured_v) in enumerate(zip(self._axes, volts, strict=True)):
            y = axis.position(measured_v)
            if is_first:
                axis.envelope.begin()
                axis.begin(t, y)
            r, u = axis.output(t, y)
            if not math.isfinite(u):
                axis.signals = AxisSignals(r, y, r - y, u, self._valves.volts[index], measured_v, axis.phase)
                return LoopFailure(axis.name, f"control law gave {u} V at setpoint {r:g}, position {y:g}")
            limited_u = self._valves.command(index, u)
            axis.advance(limited_u)
            axis.signals = AxisSignals(r, y, r - y, u, self._valves.volts[index], measured_v, axis.phase)
            violation = axis.envelope.check(t, y, r - y, limited_u)
            if violation is not None and failure is None:
                failure = LoopFailure(axis.name, violation)
        return failure

    def is_excited(self, name: str) -> bool:
        """Return whether an experiment excites this axis."""
        return isinstance(self._axes[self._places[name]], ExcitedAxis)

    def position_refusal(self, name: str) -> str | None:
        """Return why the position of an axis does not allow it to move, or None."""
        axis = self._axes[self._places[name]]
        y = axis.signals.position
        return axis.envelope.refusal(y, y)

    @property
    def have_begun(self) -> bool:
        """True if a sample has been controlled since the last restart."""
        return self._start_ns is not None

    def change_setpoint(self, name: str, setpoint: Setpoint, is_running: bool) -> None:
        """Replace the setpoint of an axis. It is approached within the limits of the rig file.

        A controlled axis begins at once, from its present setpoint and its speed. Another one begins from its
        position when control begins.
        """
        place = self._places[name]
        axis = self._axes[place]
        reference = self._operators[place].reference(setpoint)
        if is_running and self.have_begun:
            step = present_step(axis.setpoint, self._t, self._period_s)
            axis.setpoint = reference.take_over(axis.signals.setpoint, step)
        axis.reference = reference

    def forget_setpoints(self) -> None:
        """Return to the setpoints with which the gateway was started, and forget those of operators."""
        for axis in self._axes:
            axis.reference = axis.first_reference

    def requested_setpoints(self) -> Iterator[tuple[str, str]]:
        """Yield axis and text of each setpoint that an operator has asked for since the last stop."""
        for axis in self._axes:
            if isinstance(axis.reference, LimitedSetpoint):
                yield axis.name, axis.reference.text

    def change_law(self, name: str, law: ControlLaw, is_running: bool) -> Matching | None:
        """Replace the control law of an axis.

        On a controlled axis, the law's output is matched to the last command that the limits let through.
        The law has then taken the last sample, and acts from the next one on. Returns what remains of a
        bump, or None for an axis that is not controlled.
        """
        place = self._places[name]
        axis = self._axes[place]
        axis.law = law
        if not is_running or not self.have_begun:
            return None
        applied_v = self._valves.offset_v(place)
        matching = law.match(axis.signals.setpoint, axis.signals.position, applied_v)
        law.advance(applied_v)
        return matching

    def jog(
        self, motion: Jog, volts: Sequence[float], deadline_ns: int, now_ns: int
    ) -> JogEnd | LoopFailure | None:
        """Command one axis to the voltage of a jog and centre the other valves.

        The arguments are those of :meth:`control`. Returns None, the reason for which the jog ends, or a
        failure as :meth:`control` does. Unless it is None, only the centring command may then leave.
        """
        is_first = self._start_ns is None
        if self._start_ns is None:
            self._start_ns = deadline_ns
        t = (deadline_ns - self._start_ns) / 1e9
        self._valves.set_change_time(self._elapsed_s(now_ns))
        self._last_command_ns = now_ns
        place = self._places[motion.axis]
        self._valves.centre_others(place)  # The bus may have refused the command that centred them.
        self.observe(volts)
        axis, y = self._axes[place], self._axes[place].signals.position
        if is_first:
            axis.envelope.begin()
            motion.begin(y)
        limited_u = self._valves.command(place, motion.offset_v)
        axis.signals = axis.signals._replace(output_v=motion.offset_v, command_v=self._valves.volts[place])
        violation = axis.envelope.check(t, y, 0.0, limited_u)
        return LoopFailure(axis.name, violation) if violation is not None else motion.check(y)

    def observe(self, volts: Sequence[float]) -> None:
        """Read a sample without control: each axis' setpoint follows its position."""
        for axis, measured_v, command_v in zip(self._axes, volts, self._valves.volts, strict=True):
            y = axis.position(measured_v)
            axis.signals = AxisSignals(y, y, 0.0, 0.0, command_v, measured_v)

    def command(self) -> Frame:
        """Return the frame with the limited commands of all axes."""
        return self._valves.frame()

    @property
    def are_centred(self) -> bool:
        """True if the last command that the bus took centres every valve."""
        return self._valves.are_centred

    def centre(self) -> Frame:
        """Centre every valve at once, and return the frame that does so."""
        self._valves.centre()
        for axis, centre_v in zip(self._axes, self._valves.volts, strict=True):
            axis.signals = axis.signals._replace(command_v=centre_v)
        return self._valves.frame()

    def command_refused(self, frame: Frame) -> None:
        """Take back a command that the bus refused: the rate limits start from the last one that it took."""
        self._valves.refused(frame)

    def _elapsed_s(self, now_ns: int) -> float:
        """Return the time since the last controlled sample; one period before the second one."""
        if self._last_command_ns is None:
            return self._period_s
        return (now_ns - self._last_command_ns) / 1e9


def _axis_loop(
    rig: Rig, name: str, law: ControlLaw, setpoint: Setpoint, experiment: Experiment | None
) -> AxisLoop:
    if experiment is not None and experiment.axis == name:
        return ExcitedAxis(rig, name, law, setpoint, experiment)
    return AxisLoop(rig, name, law, setpoint)
