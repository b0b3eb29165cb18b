"""A plant with an independent linear model for each axis: eq. (15) of the paper, or identified models.

A model relates deviations. Its input is the valve's offset from ``centre_v`` in volts. Its output is the
displacement of the axis, in the axis' unit, from the middle of its potentiometer's range, where the plant
starts at rest. The response is exact while the valves hold their voltages, dead time included.

A linear model has no end stops. The position may leave the potentiometer's range; the potentiometer's voltage
does not: it stays between 0 and 10 V. An integrating or unstable model therefore comes back only when its
input brings it back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from firmware_sim.plants.held_response import response_of
from firmware_sim.plants.linear_model import EQUATION_15, LinearModel
from hil.core.errors import SimulationError
from hil.core.rig import AxisSettings, Rig

MAX_DISPLACEMENT: Final = 1e6
"""Limit of a displacement, in the axis' unit. A position beyond it has diverged."""


class LinearPlant:
    """Axes of a rig with a linear model each; a ``firmware_sim.plants.plant.Plant``.

    ``models`` maps an axis to its model. Other axes of the rig are not simulated, and their channels read 0
    V. Without ``models`` every axis of the rig has eq. (15), in m or rad per volt.

    Raises ValueError for a model that cannot be simulated.
    """

    def __init__(self, rig: Rig, models: Mapping[str, LinearModel] | None = None) -> None:
        models = dict.fromkeys(rig.axes, EQUATION_15) if models is None else models
        self._axes = {
            name: _Axis(name, rig.axes[name], model, rig.loop.period_ns) for name, model in models.items()
        }

    def position(self, axis: str) -> float:
        """Return the position of an axis in its unit. It is not limited to the potentiometer's range."""
        return self._axes[axis].middle + self._axes[axis].response.output

    def advance(self, duration_ns: int, valve_v: Sequence[float]) -> None:
        """Hold the valve voltages (V, by channel) for ``duration_ns``.

        Raises SimulationError if an axis diverges.
        """
        for axis in self._axes.values():
            response = axis.response
            response.advance(duration_ns, valve_v[axis.valve_channel] - axis.valve_centre_v)
            if not -MAX_DISPLACEMENT < response.output < MAX_DISPLACEMENT:
                raise SimulationError(
                    f"the linear model of axis {axis.name} diverged: displacement {response.output:.3g} "
                    f"{axis.unit}, limit {MAX_DISPLACEMENT:g} {axis.unit}. A linear model has no end stops: "
                    "the model or the control loop is unstable"
                )

    def potentiometer_v(self) -> Sequence[float]:
        """Return the potentiometers' voltages now (V, by channel), 0 to 10 V."""
        volts = [0.0, 0.0, 0.0]
        for axis in self._axes.values():
            reading = axis.potentiometer.volts(axis.middle + axis.response.output)
            volts[axis.potentiometer_channel] = min(max(reading, 0.0), 10.0)
        return volts


class _Axis:
    """The model of one axis, and how the boards are connected to it."""

    __slots__ = (
        "middle",
        "name",
        "potentiometer",
        "potentiometer_channel",
        "response",
        "unit",
        "valve_centre_v",
        "valve_channel",
    )

    def __init__(self, name: str, settings: AxisSettings, model: LinearModel, period_ns: int) -> None:
        self.name = name
        self.unit = settings.unit
        self.response = response_of(model, period_ns)
        self.valve_channel = settings.valve.channel - 1
        self.valve_centre_v = settings.valve.centre_v
        self.potentiometer = settings.potentiometer
        self.potentiometer_channel = settings.potentiometer.channel - 1
        self.middle = settings.potentiometer.position(5.0)
        """Position at the middle of the potentiometer's range."""
