"""The rigs that are fuzzed. Each one is described here once: as facts for the checker, and as a rig file."""

from __future__ import annotations

from dataclasses import dataclass, field

from fuzz import wire

PERIOD_NS = 11_200_000
HEARTBEAT_TIMEOUT_NS = 302_400_000
CONTACT_TIMEOUT_NS = 50_000_000
STOP_MASK, ENABLE_MASK = 1, 2
READ_BACK_TOLERANCE_V = 0.05
READ_BACK_PERIODS = 3
SPEED_SAMPLES = 4
"""Number of samples back to which the distance is measured for the speed."""
STILL_SHARE = 0.002
"""Share of the range of an axis within which a position stands still."""


@dataclass(frozen=True)
class Axis:
    """Facts about one axis. Positions are in the axis' unit."""

    name: str
    channel: int
    """Channel of the potentiometer, from 1."""
    valve_channel: int
    """Channel of the valve, from 1."""
    y_at_0v: float = -0.165
    y_at_10v: float = 0.165
    unit: str = "m"
    setpoint_range: tuple[float, float] = (-0.15, 0.15)
    sensor_v: tuple[float, float] = (0.1, 9.9)
    centre_v: float = 5.0
    valve_v: tuple[float, float] = (0.0, 9.9996)
    max_rate_v_s: float = 400.0
    soft_ends: tuple[float, float] = (-0.16, 0.16)
    max_speed: float = 1.8
    max_error: float = 0.15
    max_error_s: float = 3.0
    max_still_s: float = 0.5
    far_open_v: float = 1.5
    jog_max_v: float = 1.0
    jog_max_s: float = 0.5

    def position(self, counts: int) -> float:
        """Return the position that a potentiometer shows."""
        return self.y_at_0v + (self.y_at_10v - self.y_at_0v) * counts / 32768


@dataclass(frozen=True)
class RigFacts:
    """Facts about a rig."""

    name: str
    axes: tuple[Axis, ...]
    adc_protected: bool = True
    dac_protected: bool = True
    apply: str = "at sync"
    wire_version: int = 2
    stale_periods: int = 3
    has_stop: bool = False
    has_enable: bool = False
    inputs_protected: bool = True
    read_back: bool = False
    excited: str | None = None
    """Axis that an experiment excites, or None."""
    laws: tuple[str, ...] = field(default=("pid", "steep", "no number", "filter"))
    """Control laws that are tried, by their name in ``played_rig``."""

    def document(self) -> str:
        """Return the rig file."""
        lines = [
            f"[loop]\nperiod_s = {PERIOD_NS / 1e9}",
            f'[bus]\nchannel = "sim"\nwire_version = {self.wire_version}',
            "[gateway]\nheartbeat_interval_s = 0.1",
            f"[adc]\nprotected = {_toml(self.adc_protected)}\nstale_after_periods = {self.stale_periods}",
            f"heartbeat_timeout_s = {HEARTBEAT_TIMEOUT_NS / 1e9}",
            f'[dac]\nprotected = {_toml(self.dac_protected)}\napply = "{self.apply}"',
            f"watchdog_timeout_s = 0.0896\nheartbeat_timeout_s = {HEARTBEAT_TIMEOUT_NS / 1e9}",
        ]
        if self.read_back:
            lines.append(f"read_back = true\nread_back_tolerance_v = {READ_BACK_TOLERANCE_V}")
            lines.append(f"read_back_periods = {READ_BACK_PERIODS}")
        for is_used, table, bit in ((self.has_stop, "emergency_stop", 0), (self.has_enable, "enable", 1)):
            if is_used:
                lines.append(f"[{table}]\nframe = {wire.INPUTS}\nbyte = 0\nbit = {bit}")
                lines.append(f"timeout_s = {CONTACT_TIMEOUT_NS / 1e9}")
                lines.append(f"protected = {_toml(self.inputs_protected)}")
        return "\n".join([*lines, *map(_axis_tables, self.axes)]) + "\n"


def _toml(flag: bool) -> str:
    return "true" if flag else "false"


def _axis_tables(axis: Axis) -> str:
    table = f"[axes.{axis.name}"
    return "\n".join(
        (
            f'{table}]\nunit = "{axis.unit}"\ncontroller = "ppid"\nsetpoint = "hold"',
            f"min_y = {axis.setpoint_range[0]}\nmax_y = {axis.setpoint_range[1]}",
            f"{table}.envelope]\nmin_y = {axis.soft_ends[0]}\nmax_y = {axis.soft_ends[1]}",
            f"max_speed = {axis.max_speed}\nmax_error = {axis.max_error}\nmax_error_s = {axis.max_error_s}",
            f"max_still_s = {axis.max_still_s}\nfar_open_v = {axis.far_open_v}",
            f"{table}.operator]\njog_max_v = {axis.jog_max_v}\njog_max_s = {axis.jog_max_s}",
            f"{table}.potentiometer]\nchannel = {axis.channel}",
            f"y_at_0v = {axis.y_at_0v}\ny_at_10v = {axis.y_at_10v}",
            f"min_v = {axis.sensor_v[0]}\nmax_v = {axis.sensor_v[1]}",
            f"{table}.valve]\nchannel = {axis.valve_channel}\ncentre_v = {axis.centre_v}",
            f"min_v = {axis.valve_v[0]}\nmax_v = {axis.valve_v[1]}\nmax_rate_v_s = {axis.max_rate_v_s}",
        )
    )


_VERTICAL, _HORIZONTAL = Axis("vertical", 1, 1), Axis("horizontal", 2, 2)
_ROTATION = Axis(
    "rotation",
    3,
    3,
    y_at_0v=-1.65,
    y_at_10v=1.65,
    unit="rad",
    setpoint_range=(-1.5, 1.5),
    soft_ends=(-1.65 + 0.05, 1.6),
    max_speed=18.0,
    max_error=1.5,
)
_NARROW = (
    Axis("horizontal", 2, 2, valve_v=(3.3333, 6.6667), max_rate_v_s=25.0, jog_max_s=0.1),
    Axis(
        "rotation",
        3,
        1,
        y_at_0v=1.65,
        y_at_10v=-1.65,
        unit="rad",
        setpoint_range=(-1.5, 1.5),
        soft_ends=(-1.55, 1.6),
        max_speed=18.0,
        max_error=1.0,
        centre_v=4.9,
        max_rate_v_s=100.0,
    ),
)
_STRICT = (
    Axis(
        "vertical",
        1,
        1,
        soft_ends=(-0.151, 0.152),
        max_speed=0.4,
        max_error=0.05,
        max_error_s=0.06,
        max_still_s=0.05,
        far_open_v=0.5,
        max_rate_v_s=50.0,
    ),
    Axis("horizontal", 2, 3, max_speed=0.5, max_error=0.04, max_error_s=0.1, max_rate_v_s=77.0),
)
_ALL = (_VERTICAL, _HORIZONTAL, _ROTATION)

RIGS = {
    rig.name: rig
    for rig in (
        RigFacts("plain", _ALL),
        RigFacts("narrow", _NARROW, adc_protected=False),
        RigFacts("bare", _ALL, adc_protected=False, dac_protected=False, apply="at once", stale_periods=1),
        RigFacts("strict", _STRICT, stale_periods=5, wire_version=1),
        RigFacts("stop", _ALL, has_stop=True, has_enable=True, read_back=True),
        RigFacts("stop 1", _ALL, has_stop=True, has_enable=True, read_back=True, wire_version=1),
        RigFacts(
            "bare stop", _NARROW, dac_protected=False, has_stop=True, inputs_protected=False, read_back=True
        ),
        RigFacts("experiment", _ALL, has_stop=True, has_enable=True, excited="vertical", laws=("pid",)),
    )
}
"""Every rig by its name."""
