"""The rig file: one TOML, read once, into one frozen :class:`Rig`.

Lives here: what the loop, the boards and the axes are, and the cross-checks between them. Does not live
here: reading the disk (the shells and commands do). The commented example is ``hil/rig.toml``.
"""

from __future__ import annotations

import re
from typing import Annotated, Literal

import msgspec

from hil.core.documents import Document, from_toml
from hil.core.errors import DocumentError

VOLTS_PER_COUNT = 10.0 / 32768
"""Resolution of an analogue channel of the DBC, CiA 401's left-adjusted INTEGER16."""
HIGHEST_WIRE_V = 32767 * VOLTS_PER_COUNT
"""The most that an analogue channel of the DBC can carry."""

LONGEST_HOLD_S = 2.0
"""Valves do not hold for longer on their last command, whoever ends it: an arm goes far in that time."""
LONGEST_SILENCE_S = 10.0
"""Nor is a board without a heartbeat trusted for longer."""
CHANNELS = 3
"""Of either board."""

Periods = Annotated[int, msgspec.Meta(ge=1, le=1000)]
Channel = Annotated[int, msgspec.Meta(ge=1, le=CHANNELS)]
Volts = Annotated[float, msgspec.Meta(ge=0.0, le=10.0)]


class LoopSettings(Document, frozen=True):
    """The control loop. ``period_s`` is the sample time of every controller, in seconds."""

    period_s: Annotated[float, msgspec.Meta(ge=0.001, le=1.0)]

    @property
    def period_ns(self) -> int:
        """The period as an integer of nanoseconds: 0.0112 s is 11_200_000 ns."""
        return round(self.period_s * 1e9)


class Bus(Document, frozen=True):
    """Where the boards are: ``sim`` starts the simulated boards in a process of their own."""

    channel: str = "sim"


class GatewaySettings(Document, frozen=True):
    """The gateway as a CANopen node."""

    heartbeat_periods: Periods
    """A heartbeat is sent every so many periods."""


class AdcSettings(Document, frozen=True):
    """The potentiometer board, node 0x10."""

    protected: bool
    """TPDO1 carries counter and CRC (8 bytes); false for modules that have none (6 bytes)."""
    stale_after_periods: Periods
    """So many periods without an acceptable sample are a fault; until then the valves hold."""
    heartbeat_timeout_periods: Periods
    """So many periods without the board's heartbeat are a fault."""


class DacSettings(Document, frozen=True):
    """The valve board, node 0x20."""

    protected: bool
    """RPDO1 carries counter and CRC (8 bytes); false for modules that have none (6 bytes)."""
    apply: Literal["at sync", "at once"]
    """When a command reaches the valve: at the next SYNC (one period of delay, no jitter) or at once."""
    watchdog_periods: Periods
    """So many periods without a good command and the board centres its valves."""
    heartbeat_timeout_periods: Periods
    """So many periods without the board's heartbeat are a fault; the board watches the gateway's likewise."""


class Potentiometer(Document, frozen=True):
    """Position from voltage, linear: ``y_at_0v`` and ``y_at_10v`` in the axis' unit."""

    channel: Channel
    y_at_0v: float
    y_at_10v: float
    min_v: Volts
    """A voltage under this is a broken wire or a short, never a position."""
    max_v: Volts

    def position(self, volts: float) -> float:
        """Position in the axis' unit at ``volts``."""
        return self.y_at_0v + (self.y_at_10v - self.y_at_0v) * (volts * 0.1)

    def volts(self, position: float) -> float:
        """Voltage at a ``position`` in the axis' unit."""
        return 10.0 * (position - self.y_at_0v) / (self.y_at_10v - self.y_at_0v)


class Valve(Document, frozen=True):
    """A proportional valve. The manipulated variable u is the offset in volts from ``centre_v``."""

    channel: Channel
    centre_v: Volts
    min_v: Volts
    max_v: Volts
    max_rate_v_s: Annotated[float, msgspec.Meta(gt=0.0)]
    """Largest change of the command in volts a second."""


class AxisSettings(Document, frozen=True):
    """One independent SISO loop."""

    unit: Literal["m", "rad"]
    setpoint: str
    """Default setpoint, as ``--setpoint`` takes it (without the axis' name)."""
    controller: str
    """A controller shipped with the package (``ppid``) or a file, relative to the rig file."""
    min_y: float
    """Setpoints under this are refused; in the axis' unit."""
    max_y: float
    potentiometer: Potentiometer
    valve: Valve


class Rig(Document, frozen=True):
    """The whole rig file. Axes keep the file's order."""

    loop: LoopSettings
    gateway: GatewaySettings
    adc: AdcSettings
    dac: DacSettings
    axes: Annotated[dict[str, AxisSettings], msgspec.Meta(min_length=1)]
    bus: Bus = Bus()


def read_rig(text: str, source: str) -> Rig:
    """Read and cross-check the text of a rig file; ``source`` is its name for errors.

    Raises DocumentError naming file, key, value and limit.
    """
    rig = from_toml(text, Rig, source)
    _check_periods(rig, source)
    if len(rig.axes) > CHANNELS:
        raise DocumentError(
            f"{source}: axes: {', '.join(rig.axes)}: the boards have channels for {CHANNELS} axes, "
            f"not {len(rig.axes)}"
        )
    for name, axis in rig.axes.items():
        if re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) is None:
            raise DocumentError(
                f"{source}: axes: {name!r} is no name for an axis: a letter, then letters, digits or _ "
                "(it names files and topics)"
            )
        _check_axis(axis, f"{source}: axes.{name}")
    for part in ("potentiometer", "valve"):
        _check_channels(rig, part, source)
    return rig


def _check_periods(rig: Rig, source: str) -> None:
    if rig.dac.heartbeat_timeout_periods <= rig.gateway.heartbeat_periods:
        raise DocumentError(
            f"{source}: dac.heartbeat_timeout_periods: {rig.dac.heartbeat_timeout_periods} does not exceed "
            f"gateway.heartbeat_periods {rig.gateway.heartbeat_periods}: the board would miss every heartbeat"
        )
    if rig.dac.watchdog_periods <= rig.adc.stale_after_periods:
        raise DocumentError(
            f"{source}: dac.watchdog_periods: {rig.dac.watchdog_periods} does not exceed "
            f"adc.stale_after_periods {rig.adc.stale_after_periods}: the board would centre its valves "
            "behind the gateway's back"
        )
    for key, periods, longest_s in (
        ("adc.stale_after_periods", rig.adc.stale_after_periods, LONGEST_HOLD_S),
        ("dac.watchdog_periods", rig.dac.watchdog_periods, LONGEST_HOLD_S),
        ("adc.heartbeat_timeout_periods", rig.adc.heartbeat_timeout_periods, LONGEST_SILENCE_S),
        ("dac.heartbeat_timeout_periods", rig.dac.heartbeat_timeout_periods, LONGEST_SILENCE_S),
    ):
        if periods * rig.loop.period_s > longest_s:
            raise DocumentError(
                f"{source}: {key}: {periods} periods of {rig.loop.period_s:g} s are "
                f"{periods * rig.loop.period_s:g} s, more than {longest_s:g} s"
            )


def _check_axis(axis: AxisSettings, where: str) -> None:
    valve, pot = axis.valve, axis.potentiometer
    for part, max_v in (("valve", valve.max_v), ("potentiometer", pot.max_v)):
        if max_v > HIGHEST_WIRE_V:
            raise DocumentError(
                f"{where}.{part}.max_v: {max_v} V exceeds {HIGHEST_WIRE_V:.5f} V, the most that a frame "
                "can carry (arm.dbc)"
            )
    if not valve.min_v + VOLTS_PER_COUNT <= valve.centre_v <= valve.max_v - VOLTS_PER_COUNT:
        raise DocumentError(
            f"{where}.valve.centre_v: {valve.centre_v} V is not between min_v {valve.min_v} V and "
            f"max_v {valve.max_v} V"
        )
    if not pot.min_v < pot.max_v:
        raise DocumentError(f"{where}.potentiometer: min_v {pot.min_v} V is not under max_v {pot.max_v} V")
    if pot.y_at_0v == pot.y_at_10v:
        raise DocumentError(f"{where}.potentiometer: y_at_0v and y_at_10v are both {pot.y_at_0v}")
    if not axis.min_y < axis.max_y:
        raise DocumentError(f"{where}: min_y {axis.min_y} is not under max_y {axis.max_y}")
    for key in ("min_y", "max_y"):
        volts = pot.volts(getattr(axis, key))
        if not pot.min_v <= volts <= pot.max_v:
            raise DocumentError(
                f"{where}.{key}: {getattr(axis, key)} {axis.unit} is {volts:.3f} V at the potentiometer, "
                f"outside its {pot.min_v} to {pot.max_v} V"
            )


def _check_channels(rig: Rig, part: str, source: str) -> None:
    taken: dict[int, str] = {}
    for name, axis in rig.axes.items():
        channel = getattr(axis, part).channel
        if channel in taken:
            raise DocumentError(
                f"{source}: axes.{name}.{part}.channel: channel {channel} is taken by axes.{taken[channel]}"
            )
        taken[channel] = name
