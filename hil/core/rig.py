"""The rig file: one TOML document, read once into one frozen :class:`Rig`.

This module has the settings of loop, boards and axes, and the checks between them. Shells and commands read
the disk. The commented example is ``hil/shipped/rig.toml``.
"""

from __future__ import annotations

import re
from typing import Annotated, Literal

import msgspec

from hil.core.documents import Document, from_plain, parse_toml
from hil.core.envelope_settings import AxisRange, EnvelopeSettings, Limits, check_settings, limits_of
from hil.core.errors import DocumentError
from hil.core.input_settings import InputSettings, check_inputs
from hil.core.operator_settings import (
    OperatorLimits,
    OperatorSettings,
    check_operator_settings,
    operator_limits,
)
from hil.core.replaced_keys import refuse_replaced_keys

VOLTS_PER_COUNT = 10.0 / 32768
"""Resolution of an analogue channel of the DBC: CiA 401, left-adjusted INTEGER16."""
MAX_WIRE_V = 32767 * VOLTS_PER_COUNT
"""Largest voltage that an analogue channel of the DBC can carry."""

MAX_RATE_V_S = 10_000.0
"""Largest rate limit of a valve in volts per second: the whole range within the shortest period, 1 ms."""
MAX_HOLD_S = 2.0
"""Longest time for which the valves may hold their last command without a new one."""
MAX_HEARTBEAT_TIMEOUT_S = 10.0
"""Longest time for which a board without a heartbeat may count as present."""
POLL_BEFORE_DEADLINE_S = 0.0002
"""Default time of polling before a deadline, in seconds. Most wake-ups with SCHED_FIFO are late by less."""
MAX_POLL_S = 0.0005
"""Longest time for which the loop may poll before a deadline, in seconds: half of the shortest period."""
POLL_FOR_SAMPLE_S = 0.001
"""Default time of polling for the answer to SYNC, in seconds. The boards on a CAN bus answer earlier."""
MAX_POLL_FOR_SAMPLE_S = 0.005
"""Longest time for which the loop may poll for the answer to SYNC, in seconds."""
CHANNELS = 3
"""Analogue channels of each board."""

Right = Literal["SCHED_FIFO", "memory lock"]
"""Right that a rig may require of the machine. Without it, a loop can be late by many periods."""
REAL_ARM_RIGHTS: tuple[Right, ...] = ("SCHED_FIFO", "memory lock")
"""Rights that a real arm requires if the rig file does not say otherwise."""
Periods = Annotated[int, msgspec.Meta(ge=1, le=1000)]
Timeout = Annotated[float, msgspec.Meta(ge=0.001, le=MAX_HEARTBEAT_TIMEOUT_S)]
Channel = Annotated[int, msgspec.Meta(ge=1, le=CHANNELS)]
Volts = Annotated[float, msgspec.Meta(ge=0.0, le=10.0)]
BitRate = Annotated[int, msgspec.Meta(ge=10_000, le=1_000_000)]
Position = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]


class LoopSettings(Document, frozen=True):
    """The control loop. ``period_s`` is the sample time of every controller, in seconds."""

    period_s: Annotated[float, msgspec.Meta(ge=0.001, le=1.0)]
    poll_before_deadline_s: Annotated[float, msgspec.Meta(ge=0.0, le=MAX_POLL_S)] = POLL_BEFORE_DEADLINE_S
    """Time in seconds for which the loop polls before each deadline instead of sleeping; 0 turns it off.

    It then wakes up by so much earlier. The loop polls only with SCHED_FIFO and more than one processor.
    """

    poll_for_sample_s: Annotated[float, msgspec.Meta(ge=0.0, le=MAX_POLL_FOR_SAMPLE_S)] = POLL_FOR_SAMPLE_S
    """Longest time in seconds for which the loop polls after SYNC in state running; 0 turns it off.

    After a quarter of the period the loop sleeps in any case.
    """

    required_rights: list[Right] | None = None
    """Rights of the loop without which the gateway does not arm.

    None: ``REAL_ARM_RIGHTS`` on a bus that may lead to a real arm, and none on a simulated one.
    """

    @property
    def period_ns(self) -> int:
        """Period in nanoseconds: 0.0112 s is 11_200_000 ns."""
        return nanoseconds(self.period_s)


class Bus(Document, frozen=True):
    """The bus of the boards. ``sim`` starts simulated boards in a process of their own."""

    channel: str = "sim"
    wire_version: Literal[1, 2] = 1
    """Version of the protected frames. In version 2, their CRC covers the frame's identifier too.

    A rig file without this key is older than version 2, so the default is 1. Modules without counter and CRC
    (``protected = false``) send the same frames in both versions.
    """
    bit_rate: BitRate | None = None
    """Bit rate in bit/s. Simulated time then has a bus model, in which frames take time and wait.

    A serial adapter (slcan) is set to it. The interface of any other real bus has a bit rate of its own.
    None: frames in simulated time arrive at once, and a serial adapter is set to 500 kbit/s.
    """


class GatewaySettings(Document, frozen=True):
    """The gateway as a CANopen node, 0x01."""

    heartbeat_interval_s: Annotated[float, msgspec.Meta(ge=0.001, le=1.0)]
    """Time between two heartbeats of the gateway in seconds. It is rounded to whole periods."""


class AdcSettings(Document, frozen=True):
    """The potentiometer board, node 0x10."""

    protected: bool
    """True if TPDO1 carries counter and CRC (8 bytes), false for modules that have none (6 bytes)."""
    stale_after_periods: Periods
    """Number of consecutive periods without an accepted sample that is a fault; the valves hold before."""
    heartbeat_timeout_s: Timeout
    """Time in seconds without a heartbeat of the board after which it counts as lost."""


class DacSettings(Document, frozen=True):
    """The valve board, node 0x20."""

    protected: bool
    """True if RPDO1 carries counter and CRC (8 bytes), false for modules that have none (6 bytes)."""
    apply: Literal["at sync", "at once"]
    """Instant at which a command reaches the valve: at the next SYNC (one period of delay), or at once."""
    watchdog_timeout_s: Timeout
    """Time in seconds without an accepted command after which the board centres its valves."""
    heartbeat_timeout_s: Timeout
    """Time in seconds without a heartbeat after which board and gateway count each other as lost."""
    read_back: bool = False
    """True if the board answers each SYNC with TPDO1: the voltages on its pins, laid out like RPDO1."""
    read_back_tolerance_v: Annotated[float, msgspec.Meta(ge=0.005, le=5.0)] = 0.05
    """Largest difference in volts between a command and the voltage that the board reads back."""
    read_back_periods: Periods = 3
    """Number of consecutive periods with a larger difference that is a fault."""


class Potentiometer(Document, frozen=True):
    """Linear map from voltage to position. ``y_at_0v`` and ``y_at_10v`` are in the axis' unit."""

    channel: Channel
    y_at_0v: Position
    y_at_10v: Position
    min_v: Volts
    """Smallest voltage of a position. A smaller one means a broken wire or a short circuit."""
    max_v: Volts
    """Largest voltage of a position. A larger one means a broken wire or a short circuit."""

    def position(self, volts: float) -> float:
        """Return the position in the axis' unit at ``volts``."""
        return self.y_at_0v + (self.y_at_10v - self.y_at_0v) * (volts * 0.1)

    def volts(self, position: float) -> float:
        """Return the voltage at a ``position`` in the axis' unit."""
        return 10.0 * (position - self.y_at_0v) / (self.y_at_10v - self.y_at_0v)


class Valve(Document, frozen=True):
    """A proportional valve. The manipulated variable u is the offset of its voltage from ``centre_v``."""

    channel: Channel
    centre_v: Volts
    min_v: Volts
    max_v: Volts
    max_rate_v_s: Annotated[float, msgspec.Meta(gt=0.0, le=MAX_RATE_V_S)]
    """Largest rate of change of the command in volts per second."""


class AxisSettings(Document, frozen=True):
    """One axis: an independent loop with one input and one output."""

    unit: Literal["m", "rad"]
    setpoint: str
    """Default setpoint, written as for ``--setpoint``, without the axis' name."""
    controller: str
    """Name of a shipped controller (``ppid``), or a file relative to the rig file."""
    min_y: Position
    """Smallest setpoint that is accepted, in the axis' unit."""
    max_y: Position
    """Largest setpoint that is accepted, in the axis' unit."""
    potentiometer: Potentiometer
    valve: Valve
    fence_min_y: float | None = None
    """Travel fence: an excited axis under this position goes back under its controller.

    The default is a tenth of the range above ``min_y``.
    """
    fence_max_y: float | None = None
    """Travel fence: the same above this position. The default is a tenth of the range under ``max_y``."""
    envelope: EnvelopeSettings = EnvelopeSettings()
    """What the axis may do in state running."""
    operator: OperatorSettings = OperatorSettings()
    """What an operator may ask of the axis while the gateway runs."""

    @property
    def range(self) -> AxisRange:
        """Ranges of positions and of the valve, from which the envelope's defaults are derived."""
        pot, valve = self.potentiometer, self.valve
        sensor = sorted((pot.position(pot.min_v), pot.position(pot.max_v)))
        opening_v = min(valve.max_v - valve.centre_v, valve.centre_v - valve.min_v)
        return AxisRange(self.min_y, self.max_y, sensor[0], sensor[1], opening_v)

    @property
    def limits(self) -> Limits:
        """Limits of the envelope, with the defaults of what the rig file does not give."""
        return limits_of(self.envelope, self.range)

    @property
    def operator_limits(self) -> OperatorLimits:
        """Limits of an operator's requests, with the defaults of what the rig file does not give."""
        return operator_limits(self.operator, self.limits, self.range)

    @property
    def fence_limits(self) -> tuple[float, float]:
        """Lowest and highest position within the travel fence, in the axis' unit."""
        margin = 0.1 * (self.max_y - self.min_y)
        low = self.min_y + margin if self.fence_min_y is None else self.fence_min_y
        high = self.max_y - margin if self.fence_max_y is None else self.fence_max_y
        return low, high


class Rig(Document, frozen=True):
    """The whole rig file. Axes keep the order of the file."""

    loop: LoopSettings
    gateway: GatewaySettings
    adc: AdcSettings
    dac: DacSettings
    axes: Annotated[dict[str, AxisSettings], msgspec.Meta(min_length=1)]
    bus: Bus = Bus()
    calibration: str | None = None
    """Axis whose limits are wide because it is being calibrated. Controllers cannot start."""
    emergency_stop: InputSettings | None = None
    """Contact without which nothing arms, and whose opening is a fault; None if the rig has none."""
    enable: InputSettings | None = None
    """Contact that an operator holds closed while an axis is jogged or excited; None if the rig has none."""

    @property
    def inputs(self) -> dict[str, InputSettings]:
        """The digital inputs of the rig, by the name of their table."""
        named = (("emergency_stop", self.emergency_stop), ("enable", self.enable))
        return {name: settings for name, settings in named if settings is not None}

    @property
    def heartbeat_periods(self) -> int:
        """Periods between two heartbeats of the gateway: the whole number nearest to its interval."""
        return max(round(self.gateway.heartbeat_interval_s / self.loop.period_s), 1)


def nanoseconds(seconds: float) -> int:
    """Return a time of a rig file as an integer of nanoseconds."""
    return round(seconds * 1e9)


def read_rig(text: str, source: str) -> Rig:
    """Read and check the text of a rig file. ``source`` is its name for errors.

    Raises DocumentError naming file, key, value and limit.
    """
    plain = parse_toml(text, source, Rig)
    refuse_replaced_keys(plain, source)
    rig = from_plain(plain, Rig, source)
    _check_times(rig, source)
    check_inputs(rig.inputs, source)
    if len(rig.axes) > CHANNELS:
        raise DocumentError(
            f"{source}: axes: {', '.join(rig.axes)}: the boards have channels for {CHANNELS} axes, "
            f"not {len(rig.axes)}"
        )
    if rig.calibration is not None and rig.calibration not in rig.axes:
        raise DocumentError(
            f"{source}: calibration: {rig.calibration!r} is not an axis of this rig: {', '.join(rig.axes)}"
        )
    for name, axis in rig.axes.items():
        if re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) is None:
            raise DocumentError(
                f"{source}: axes: {name!r} cannot be the name of an axis, because it names files and topics; "
                "use a letter, then letters, digits or _"
            )
        where = f"{source}: axes.{name}"
        _check_axis(axis, where)
        check_settings(axis.envelope, axis.range, rig.loop.period_s, axis.unit, f"{where}.envelope")
        check_operator_settings(axis.operator, axis.limits, axis.range, axis.unit, f"{where}.operator")
    for part in ("potentiometer", "valve"):
        _check_channels(rig, part, source)
    return rig


def _check_times(rig: Rig, source: str) -> None:
    """Check that no time-out ends before what it waits for, or too late for an arm that nobody controls."""
    period_s, adc, dac = rig.loop.period_s, rig.adc, rig.dac
    heartbeat_s = rig.heartbeat_periods * period_s
    if dac.heartbeat_timeout_s <= heartbeat_s:
        raise DocumentError(
            f"{source}: dac.heartbeat_timeout_s: {dac.heartbeat_timeout_s:g} s does not exceed the "
            f"{heartbeat_s:g} s between heartbeats of the gateway (gateway.heartbeat_interval_s in whole "
            "periods): the board would count the gateway as lost"
        )
    hold_s = adc.stale_after_periods * period_s
    if hold_s > MAX_HOLD_S:
        raise DocumentError(
            f"{source}: adc.stale_after_periods: {adc.stale_after_periods} periods of {period_s:g} s are "
            f"{hold_s:g} s, more than the limit {MAX_HOLD_S:g} s"
        )
    if dac.watchdog_timeout_s > MAX_HOLD_S:
        raise DocumentError(
            f"{source}: dac.watchdog_timeout_s: {dac.watchdog_timeout_s:g} s is more than the limit "
            f"{MAX_HOLD_S:g} s"
        )
    if nanoseconds(dac.watchdog_timeout_s) <= adc.stale_after_periods * rig.loop.period_ns:
        raise DocumentError(
            f"{source}: dac.watchdog_timeout_s: {dac.watchdog_timeout_s:g} s does not exceed the "
            f"{hold_s:g} s of adc.stale_after_periods ({adc.stale_after_periods} periods of {period_s:g} s): "
            "the board would centre its valves while the gateway takes them to hold"
        )


def _check_axis(axis: AxisSettings, where: str) -> None:
    valve, pot = axis.valve, axis.potentiometer
    for part, max_v in (("valve", valve.max_v), ("potentiometer", pot.max_v)):
        if max_v > MAX_WIRE_V:
            raise DocumentError(
                f"{where}.{part}.max_v: {max_v} V exceeds {MAX_WIRE_V:.5f} V, the largest voltage that a "
                "frame can carry (arm.dbc)"
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
    low, high = axis.fence_limits
    if not axis.min_y <= low < high <= axis.max_y:
        raise DocumentError(
            f"{where}: fence_min_y {low:g} and fence_max_y {high:g} {axis.unit} must lie in this order "
            f"between min_y {axis.min_y:g} and max_y {axis.max_y:g} {axis.unit}"
        )
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
