"""What an operator may ask of one axis, ``[axes.NAME.operator]`` in the rig file.

The limits apply to requests to a running gateway: changed setpoints and jogs. They do not apply to the
setpoint with which ``hil run`` starts. A key that is not given has a default.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import msgspec

from hil.core.documents import Document
from hil.core.envelope_settings import DEFAULT_SPEED_RANGES_S, AxisRange, Limits
from hil.core.errors import DocumentError

DEFAULT_SPEED_SHARE = 0.25
"""Default of ``setpoint_max_speed`` as a share of the envelope's ``max_speed``. With the envelope's default
this is 1.5 ranges per s. The simulated arm reaches 2.4, so it can follow such a setpoint."""
DEFAULT_ACCELERATION_TIME_S = 0.25
"""Time in s in which the default acceleration reaches ``setpoint_max_speed``.

It is the time constant of a loop with the paper's bandwidth of 4 rad/s. Such a loop could not follow a higher
acceleration anyway.
"""
DEFAULT_JOG_V = 1.0
"""Default of ``jog_max_v``. Eq. (15) of the paper then moves at 0.26 m/s, nearly its range in one second."""
DEFAULT_JOG_S = 0.5
"""Default of ``jog_max_s``. With 1 V the axis then moves at most about half its range."""

_ROUNDING = 1e-9

Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
JogVolts = Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]
JogTime = Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]


class OperatorSettings(Document, frozen=True):
    """The table as it is written."""

    setpoint_max_speed: Positive | None = None
    """Largest speed of a setpoint that was changed by a request, in the axis' unit per s."""
    setpoint_max_acceleration: Positive | None = None
    """Largest acceleration of such a setpoint, in the axis' unit per s^2."""
    jog_max_v: JogVolts | None = None
    """Largest offset of the valve from its centre in a jog, in V."""
    jog_max_s: JogTime | None = None
    """Longest time of one jog request, in s."""


class OperatorLimits(NamedTuple):
    """The limits that apply to an operator's requests for one axis."""

    max_speed: float
    """In the axis' unit per s."""
    max_acceleration: float
    """In the axis' unit per s^2."""
    jog_max_v: float
    jog_max_s: float


def operator_limits(settings: OperatorSettings, envelope: Limits, axis: AxisRange) -> OperatorLimits:
    """Return the limits of an axis: what is given, or the defaults."""
    given = settings.setpoint_max_speed
    speed = DEFAULT_SPEED_SHARE * _speed_limit(envelope, axis) if given is None else given
    acceleration = settings.setpoint_max_acceleration
    jog_v = min(DEFAULT_JOG_V, axis.valve_v) if settings.jog_max_v is None else settings.jog_max_v
    return OperatorLimits(
        max_speed=speed,
        max_acceleration=speed / DEFAULT_ACCELERATION_TIME_S if acceleration is None else acceleration,
        jog_max_v=jog_v,
        jog_max_s=DEFAULT_JOG_S if settings.jog_max_s is None else settings.jog_max_s,
    )


def check_operator_settings(
    settings: OperatorSettings, envelope: Limits, axis: AxisRange, unit: str, where: str
) -> None:
    """Refuse limits that contradict the envelope or the valve.

    ``where`` is the place of the table for errors. Raises DocumentError.
    """
    speed = settings.setpoint_max_speed
    if speed is not None and speed > envelope.max_speed * (1.0 + _ROUNDING):
        raise DocumentError(
            f"{where}.setpoint_max_speed: {speed:g} {unit}/s is more than the envelope's max_speed, "
            f"{envelope.max_speed:g} {unit}/s; an axis that follows such a setpoint would fault; reduce it"
        )
    if settings.jog_max_v is not None and settings.jog_max_v > axis.valve_v:
        raise DocumentError(
            f"{where}.jog_max_v: {settings.jog_max_v:g} V is more than the {axis.valve_v:g} V that the valve "
            "can be opened to both sides; reduce it"
        )


def _speed_limit(envelope: Limits, axis: AxisRange) -> float:
    """Return the envelope's speed limit, or its default if the check is disabled."""
    return envelope.max_speed if math.isfinite(envelope.max_speed) else DEFAULT_SPEED_RANGES_S * axis.span
