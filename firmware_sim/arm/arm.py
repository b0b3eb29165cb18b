"""The simulated arm as a plant: valve voltages in, potentiometer voltages out.

This module does what happens at an instant: a command reaches a valve, an event happens, a potentiometer is
read. ``dynamics.c`` integrates the equations of motion between two instants. The arm reads no clock and does
no I/O. The same seed, calls and events give the same readings to the bit.

Sound needs time through the tube from valve to cylinder. The simulation delays the command by that time, not
the flow, so that the flow remains a function of the present pressures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from ctypes import byref, memmove
from functools import partial
from heapq import heappop, heappush
from random import Random
from typing import Final, NamedTuple

from firmware_sim.arm import native
from firmware_sim.arm.events import (
    AnyEvent,
    BrokenWire,
    EmergencyStop,
    EnableSwitch,
    FrictionFactor,
    Leak,
    Payload,
    StuckSpool,
    SupplyPressure,
    Temperature,
)
from firmware_sim.arm.parameters import (
    AXES,
    GAS_J_KG_K,
    HEAT_RATIO,
    ArmParameters,
    absolute_pa,
    kelvin,
)
from firmware_sim.arm.pins import PotentiometerOutput, ValveInput
from firmware_sim.arm.wiring import STRAIGHT, Wires
from firmware_sim.plants.plant import EMERGENCY_STOP, ENABLE_SWITCH, OnEvent
from hil.core.errors import SimulationError

REST_V: Final = (5.0, 5.0, 5.0)
"""Valve voltages while the arm settles before its time 0, and of an axis that is not wired."""
REST_NS: Final = 10_000_000_000
"""Time that the arm is given to settle before its time 0."""


_SETTLED: Final[dict[ArmParameters, tuple[bytes, bytes]]] = {}
"""Conditions and state at time 0 of the arm that was built last, by its parameters; at most one entry."""


class AxisView(NamedTuple):
    """True state of one axis, before any sensor. Position and velocity are in the axis' unit."""

    position: float
    velocity: float
    spool: float
    """Position of the valve's spool as a fraction of full travel, -1 to 1."""
    pressure_pa: tuple[float, float]
    """Absolute pressures in chambers 1 and 2."""


class ArmView(NamedTuple):
    """True state of the arm at ``time_ns`` of its own time."""

    time_ns: int
    axes: tuple[AxisView, ...]
    """The axes in the order of ``AXES``: vertical, horizontal, rotation."""
    supply_pa: float
    payload_kg: float
    supplied_kg: float
    """Mass of air that the regulator has supplied since the arm was built."""


class _ValveLine(NamedTuple):
    """One valve between the board's pin and its spool."""

    input: ValveInput
    delay_ns: int
    """Time of sound through the tube."""
    conditions: native.AxisConditions
    channel: int


class Arm:
    """The pneumatic arm, a ``firmware_sim.plants.plant.Plant``.

    ``seed`` is the seed of the potentiometers' noise. Each of ``events`` happens when the arm's time reaches
    it. ``wiring`` maps the name of an axis to its board channels. An axis that it leaves out has ``REST_V``
    on its valve, and nothing reads its potentiometer.

    Raises EnvironmentLackError if the dynamics are not compiled.
    """

    def __init__(
        self,
        parameters: ArmParameters,
        *,
        seed: int,
        events: Iterable[AnyEvent] = (),
        wiring: Mapping[str, Wires] = STRAIGHT,
    ) -> None:
        self.parameters = parameters
        self._dynamics = native.Dynamics()
        self.conditions, self.state = _initial(parameters)
        self._arguments = byref(native.pack(parameters)), byref(self.conditions), byref(self.state)
        self._axes = tuple(self.state.axis)
        self._travel = parameters.travel
        self._step_s = parameters.step_s
        random = Random(seed)
        self._potentiometers = [
            (PotentiometerOutput(axis.potentiometer, random), state, travel)
            for axis, state, travel in zip(parameters.ordered, self._axes, self._travel, strict=True)
        ]
        sound_m_s = math.sqrt(HEAT_RATIO * GAS_J_KG_K * self.conditions.air_k)
        valves = [
            _ValveLine(
                ValveInput(axis.valve), round(1e9 * axis.cylinder.tube_m / sound_m_s), conditions, channel
            )
            for channel, (axis, conditions) in enumerate(
                zip(parameters.ordered, self.conditions.axis, strict=True)
            )
        ]
        self._valves = valves
        self._outputs = [(AXES.index(name), wires.potentiometer) for name, wires in wiring.items()]
        self._agenda: list[tuple[int, int, Callable[[], None]]] = []
        self._scheduled_count = 0
        self._reading: Sequence[float] | None = None
        self.open_contacts: set[str] = set()
        """Names of the contacts beside the arm that are open (``firmware_sim.plants.plant.HasContacts``)."""
        self.on_event: OnEvent | None = None
        """Function that is given each planned event after it has happened; None: nobody is notified."""
        self._end_ns = -REST_NS
        """The arm's own time at the end of the present call of :meth:`advance`."""
        self.time_ns = -REST_NS
        """The arm's own time: 0 when the arm has settled and the simulation starts."""
        self._settle()
        self._valves = [
            valves[AXES.index(name)]._replace(channel=wires.valve) for name, wires in wiring.items()
        ]
        for event in events:
            self.schedule(event)

    def schedule(self, event: AnyEvent) -> None:
        """Schedule an event for its ``at_s``. If that time has passed, the event happens at once."""
        self._schedule(round(event.at_s * 1e9), partial(self._begin, event))

    def advance(self, duration_ns: int, valve_v: Sequence[float]) -> None:
        """Hold the valve voltages (V, by channel) for ``duration_ns`` from now.

        Raises SimulationError if a voltage is not finite, or if the simulation diverges.
        """
        for valve, delay_ns, conditions, channel in self._valves:
            volts = valve_v[channel]
            if volts != valve.held_v:
                command = partial(setattr, conditions, "spool_command", valve.spool_command(volts))
                self._schedule(self.time_ns + delay_ns, command)
        end_ns = self._end_ns = self.time_ns + duration_ns
        agenda = self._agenda
        while True:
            while agenda and agenda[0][0] <= self.time_ns:
                heappop(agenda)[2]()
            if self.time_ns == end_ns:
                break
            self._integrate(min(end_ns, agenda[0][0]) if agenda else end_ns)

    def potentiometer_v(self) -> Sequence[float]:
        """Return the potentiometers' voltages now (V, by channel), 0 to 10 V.

        A second call at the same instant returns the same readings: the noise is drawn once an instant.
        """
        if self._reading is None:
            volts = [
                potentiometer.volts(state.position_m * travel)
                for potentiometer, state, travel in self._potentiometers
            ]
            self._reading = reading = [0.0, 0.0, 0.0]
            for axis, channel in self._outputs:
                reading[channel] = volts[axis]
        return self._reading

    def view(self) -> ArmView:
        """Return the true state of the arm now."""
        state = self.state
        axes = tuple(
            AxisView(
                axis.position_m * travel,
                axis.velocity_m_s * travel,
                axis.spool,
                (axis.pressure_pa[0], axis.pressure_pa[1]),
            )
            for axis, travel in zip(self._axes, self._travel, strict=True)
        )
        return ArmView(self.time_ns, axes, state.supply_pa, self.conditions.payload_kg, state.supplied_kg)

    def abnormal_conditions(self) -> list[str]:
        """Return, in words, what differs from the arm file, except payload and supply pressure."""
        air_c, file_c = self.conditions.air_k - kelvin(0.0), self.parameters.supply.temperature_c
        texts = [f"air {air_c:.0f} °C"] if abs(air_c - file_c) > 1e-6 else []
        for name, axis, (potentiometer, _, _) in zip(
            AXES, self.conditions.axis, self._potentiometers, strict=True
        ):
            if axis.spool_free == 0.0:
                texts.append(f"{name}: spool stuck")
            if axis.friction_factor != 1.0:
                texts.append(f"{name}: friction x {axis.friction_factor:g}")
            texts += [
                f"{name}: chamber {k} leaks" for k, leak in enumerate(axis.leak_m3_s_pa, 1) if leak > 0.0
            ]
            if potentiometer.broken:
                texts.append(f"{name}: wire broken")
        return texts + [f"{name} open" for name in sorted(self.open_contacts)]

    def apply(self, event: AnyEvent) -> None:
        """Let an event happen now, whatever its ``at_s`` is."""
        match event:
            case Payload(mass_kg=mass_kg):
                self._set_payload(mass_kg)
            case SupplyPressure(gauge_kpa=gauge_kpa):
                self.conditions.regulator_pa = absolute_pa(gauge_kpa, self.parameters.supply)
            case Temperature(celsius=celsius):
                self.conditions.air_k = kelvin(celsius)
            case FrictionFactor(axis=name, factor=factor):
                self.conditions.axis[AXES.index(name)].friction_factor = factor
            case Leak(axis=name, chamber=chamber, conductance_m3_s_pa=conductance):
                self.conditions.axis[AXES.index(name)].leak_m3_s_pa[chamber - 1] = conductance
            case StuckSpool(axis=name, stuck=stuck):
                self.conditions.axis[AXES.index(name)].spool_free = 0.0 if stuck else 1.0
            case BrokenWire(axis=name, broken=broken):
                self._potentiometers[AXES.index(name)][0].broken = broken
            case EmergencyStop(button=button):
                self._set_contact(EMERGENCY_STOP, button == "pressed")
            case EnableSwitch(switch=switch):
                self._set_contact(ENABLE_SWITCH, switch == "released")
        self._reading = None

    def _begin(self, event: AnyEvent) -> None:
        """Let a planned event happen now, and report it."""
        self.apply(event)
        if self.on_event is not None:
            self.on_event(event, self._end_ns - self.time_ns)

    def _set_contact(self, name: str, is_open: bool) -> None:
        (self.open_contacts.add if is_open else self.open_contacts.discard)(name)

    def _settle(self) -> None:
        """Let the arm rest until its time 0. The result is kept for the next arm with the same parameters."""
        settled = _SETTLED.get(self.parameters)
        if settled is None:
            self.advance(REST_NS, REST_V)
            _SETTLED.clear()
            _SETTLED[self.parameters] = bytes(self.conditions), bytes(self.state)
            return
        for valve, _, _, channel in self._valves:
            valve.spool_command(REST_V[channel])
        for struct, content in zip((self.conditions, self.state), settled, strict=True):
            memmove(byref(struct), content, len(content))
        self.time_ns = 0

    def _schedule(self, due_ns: int, action: Callable[[], None]) -> None:
        self._scheduled_count += 1  # keeps the order of actions that are due at the same instant
        heappush(self._agenda, (due_ns, self._scheduled_count, action))

    def _set_payload(self, payload_kg: float) -> None:
        """Change the payload. A mass picked up was at rest and slows the arm; a mass dropped does not."""
        before = self._inertias()
        self.conditions.payload_kg = payload_kg
        for axis, old, new in zip(self.state.axis, before, self._inertias(), strict=True):
            axis.velocity_m_s *= min(old / new, 1.0)

    def _inertias(self) -> tuple[float, float, float]:
        body, payload_kg = self.parameters.body, self.conditions.payload_kg
        reach_m = body.reach_m + self.state.axis[1].position_m
        return (
            body.vertical_kg + body.horizontal_kg + payload_kg,
            body.horizontal_kg + payload_kg,
            body.base_kg_m2 + body.horizontal_kg * reach_m**2 + payload_kg * (reach_m + body.tip_m) ** 2,
        )

    def _integrate(self, until_ns: int) -> None:
        duration_s = (until_ns - self.time_ns) * 1e-9
        steps = math.ceil(duration_s / self._step_s * (1.0 - 1e-9))
        fault = self._dynamics.advance(*self._arguments, duration_s, steps)
        self.time_ns = until_ns
        self._reading = None
        if fault:
            raise SimulationError(self._divergence_text(fault))

    def _divergence_text(self, fault: int) -> str:
        when = f"the simulated arm diverged before {self.time_ns * 1e-9:.3f} s of its time"
        remedy = (
            f"step_s ({self.parameters.step_s} s) of the arm file may be too long for its stiffest part; "
            "try a shorter one"
        )
        if fault > len(AXES):
            return f"{when}: supply pressure {self.state.supply_pa:.4g} Pa. {remedy}"
        axis = self.state.axis[fault - 1]
        return (
            f"{when}: {AXES[fault - 1]} at {axis.position_m:.4g} m of its cylinder, "
            f"{axis.velocity_m_s:.4g} m/s, chambers at {axis.pressure_pa[0]:.4g} and "
            f"{axis.pressure_pa[1]:.4g} Pa. {remedy}. Or the piston reaches its end faster than stop and "
            f"cylinder.dead_volume_m3 of axes.{AXES[fault - 1]} can withstand"
        )


def _initial(parameters: ArmParameters) -> tuple[native.ArmConditions, native.ArmState]:
    """Return nominal conditions, and the state at rest at mid-stroke.

    Each chamber has the mean of supply and atmospheric pressure.
    """
    supply = parameters.supply
    pressure_pa = absolute_pa(supply.gauge_kpa, supply)
    conditions = native.ArmConditions(regulator_pa=pressure_pa, air_k=kelvin(supply.temperature_c))
    state = native.ArmState(supply_pa=pressure_pa)
    chamber_pa = 0.5 * (pressure_pa + absolute_pa(0.0, supply))
    for c, s, axis in zip(conditions.axis, state.axis, parameters.ordered, strict=True):
        c.spool_free = c.friction_factor = 1.0
        volume_m3 = axis.cylinder.dead_volume_m3 + 0.5 * axis.cylinder.stroke_m * axis.cylinder.area_m2
        for chamber in range(2):
            s.pressure_pa[chamber] = chamber_pa
            s.air_kg[chamber] = chamber_pa * volume_m3 / (GAS_J_KG_K * conditions.air_k)
    return conditions, state
