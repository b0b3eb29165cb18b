"""The independent SISO loops: potentiometer volts in, limited valve commands out, once a good sample.

Each axis has its setpoint, its control law and its potentiometer's scaling; nothing crosses between them.
What leaves goes through ``limits`` alone. Which sample is good, and in which state a law may act, is the
gateway's to decide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from hil.core.control_law import ControlLaw
from hil.core.frames import Frame
from hil.core.output import AxisSignals
from hil.core.rig import Rig
from hil.core.setpoints import Setpoint
from hil.core.valve_commands import ValveCommands


class AxisLoop:
    """One loop."""

    __slots__ = ("law", "name", "position", "setpoint", "signals")

    def __init__(self, rig: Rig, name: str, law: ControlLaw, setpoint: Setpoint) -> None:
        axis = rig.axes[name]
        self.name = name
        self.law = law
        self.setpoint = setpoint.at
        self.position = axis.potentiometer.position
        self.signals = AxisSignals(math.nan, math.nan, math.nan, 0.0, axis.valve.centre_v, math.nan)


class AxisLoops:
    """All loops of a rig, in its order. ``laws`` and ``setpoints`` are by axis name."""

    def __init__(self, rig: Rig, laws: Mapping[str, ControlLaw], setpoints: Mapping[str, Setpoint]) -> None:
        self._axes = tuple(AxisLoop(rig, name, laws[name], setpoints[name]) for name in rig.axes)
        self._valves = ValveCommands(
            [axis.valve for axis in rig.axes.values()], rig.loop.period_s, rig.dac.protected
        )
        self._period_s = rig.loop.period_s
        self._began_ns: int | None = None
        self._commanded_ns: int | None = None

    @property
    def signals(self) -> tuple[AxisSignals, ...]:
        """What every axis last read and asked for."""
        return tuple([axis.signals for axis in self._axes])

    def begin_anew(self) -> None:
        """Let t = 0 be the next controlled period; every law takes over there without a bump."""
        self._began_ns = self._commanded_ns = None

    def control(self, volts: Sequence[float], deadline_ns: int, now_ns: int) -> AxisLoop | None:
        """Run every law on its sample (V, in the rig's order), which came ``now_ns``, and limit its output.

        ``deadline_ns`` is that of the period; setpoints are read at its time since the first controlled one.
        Returns the axis whose output is not finite, if there is one: then nothing may leave but the centre.
        """
        is_first = self._began_ns is None
        if self._began_ns is None:
            self._began_ns = deadline_ns
        t = (deadline_ns - self._began_ns) / 1e9
        elapsed_s = self._period_s if self._commanded_ns is None else (now_ns - self._commanded_ns) / 1e9
        self._valves.pace(elapsed_s)
        self._commanded_ns = now_ns
        for index, (axis, measured) in enumerate(zip(self._axes, volts, strict=True)):
            r, y = axis.setpoint(t), axis.position(measured)
            if is_first:
                axis.law.initialise(r, y, 0.0)
            u = axis.law.output(r, y)
            is_finite = math.isfinite(u)
            if is_finite:
                axis.law.advance(self._valves.command(index, u))
            axis.signals = AxisSignals(r, y, r - y, u, self._valves.volts[index], measured)
            if not is_finite:
                return axis
        return None

    def observe(self, volts: Sequence[float]) -> None:
        """Read a sample that no law acts on: the setpoint is where the axis is."""
        for axis, measured, command_v in zip(self._axes, volts, self._valves.volts, strict=True):
            y = axis.position(measured)
            axis.signals = AxisSignals(y, y, 0.0, 0.0, command_v, measured)

    def command(self) -> Frame:
        """The frame that carries what the loops ask for, limited."""
        return self._valves.frame()

    def centre(self) -> Frame:
        """Centre every valve at once; returns the command that does."""
        self._valves.centre()
        for axis, centre_v in zip(self._axes, self._valves.volts, strict=True):
            axis.signals = axis.signals._replace(command_v=centre_v)
        return self._valves.frame()
