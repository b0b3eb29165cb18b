"""The envelope of an axis in the rig file, ``[axes.NAME.envelope]``: what the axis may do in state running.

A key that is not given has a default, which is derived from the axis' range, potentiometer and valve. A check
is switched off only by its name in ``disabled``. :class:`Limits` is the result; ``envelope`` applies it.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import msgspec

from hil.core.documents import Document
from hil.core.errors import DocumentError

SPEED_PERIODS = 4
"""Number of periods over which a speed is measured. Over one period, the 12-bit converter's steps and the
noise of the potentiometer would count as speed."""
DEFAULT_SPEED_RANGES_S = 6.0
"""Default of ``max_speed`` in ranges (``max_y`` - ``min_y``) per second. The simulated arm reaches 2.4, and
eq. (15) of the paper with a fully open valve 4.6."""
DEFAULT_ERROR_RANGES = 0.25
"""Default of ``max_error`` in ranges. A step may exceed it, but only for a part of ``max_error_s``."""
DEFAULT_STILL_S = 0.5
"""Default of ``max_still_s``."""
END_SHARE = 0.05
"""Share of the axis' range at each end in which the position may stand still with the valve far open."""
DEFAULT_FAR_OPEN_V = 3.0
"""Default of ``far_open_v``. With 2.5 V, eq. (15) only holds its position at 1.5 rad."""

Check = Literal["min_y", "max_y", "max_speed", "max_error", "max_still_s"]
"""Name of a check, which is also the key of its limit."""
Duration = Annotated[float, msgspec.Meta(gt=0.0, le=60.0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]


class EnvelopeSettings(Document, frozen=True):
    """The table as it is written. Positions and errors are in the axis' unit, speeds in this unit per s."""

    min_y: float | None = None
    """Lower soft end stop. The default is the lowest position that the potentiometer's voltages allow."""
    max_y: float | None = None
    """Upper soft end stop. The default is the highest position that the potentiometer's voltages allow."""
    max_speed: Positive | None = None
    """Largest speed, measured over ``SPEED_PERIODS`` periods."""
    max_error: Positive | None = None
    """Largest tracking error that may last longer than ``max_error_s``, and the largest one at the start."""
    max_error_s: Duration = 3.0
    """Longest time in s for which the tracking error may exceed ``max_error``."""
    max_still_s: Duration | None = None
    """Longest time in s for which the position may stand still while the valve is far open."""
    far_open_v: Positive | None = None
    """Offset from its centre in V from which on a valve is far open."""
    disabled: list[Check] = []  # noqa: RUF012  # msgspec gives each document its own list
    """Checks that are switched off."""


class Limits(NamedTuple):
    """The limits that apply. A disabled check has an infinite limit."""

    min_y: float
    max_y: float
    max_speed: float
    """In the axis' unit per s."""
    max_error: float
    max_error_s: float
    max_still_s: float
    far_open_v: float
    """In V, from the valve's centre."""
    range_y: float
    """Range of the axis' setpoints, ``max_y`` - ``min_y`` of the axis."""
    moving_min_y: float
    """Lowest position at which a still axis is suspicious. Beyond it, an end stop may hold the axis."""
    moving_max_y: float
    """Highest position at which a still axis is suspicious."""


class AxisRange(NamedTuple):
    """What the defaults are derived from. Positions are in the axis' unit, voltages in V."""

    min_y: float
    max_y: float
    sensor_min_y: float
    """Lowest position that the potentiometer's voltages allow."""
    sensor_max_y: float
    valve_v: float
    """Smaller one of the valve's two ranges about its centre."""

    @property
    def span(self) -> float:
        """Range of the axis' setpoints."""
        return self.max_y - self.min_y


def limits_of(settings: EnvelopeSettings, axis: AxisRange) -> Limits:
    """Return the limits of an axis: what is given, the defaults, and infinity for a disabled check."""

    def limit(key: Check, given: float | None, default: float, none: float = math.inf) -> float:
        return none if key in settings.disabled else default if given is None else given

    margin = END_SHARE * axis.span
    return Limits(
        min_y=limit("min_y", settings.min_y, axis.sensor_min_y, -math.inf),
        max_y=limit("max_y", settings.max_y, axis.sensor_max_y),
        max_speed=limit("max_speed", settings.max_speed, DEFAULT_SPEED_RANGES_S * axis.span),
        max_error=limit("max_error", settings.max_error, DEFAULT_ERROR_RANGES * axis.span),
        max_error_s=settings.max_error_s,
        max_still_s=limit("max_still_s", settings.max_still_s, DEFAULT_STILL_S),
        far_open_v=_given(settings.far_open_v, DEFAULT_FAR_OPEN_V),
        range_y=axis.span,
        moving_min_y=axis.min_y + margin,
        moving_max_y=axis.max_y - margin,
    )


def check_settings(
    settings: EnvelopeSettings, axis: AxisRange, period_s: float, unit: str, where: str
) -> None:
    """Refuse limits that contradict each other, and limits that nothing can exceed.

    ``where`` is the place of the table for errors. Raises DocumentError.
    """
    _check_disabled(settings, where)
    if not axis.sensor_min_y <= (low := _given(settings.min_y, axis.sensor_min_y)) <= axis.min_y:
        raise DocumentError(
            f"{where}.min_y: the soft end stop {low:g} {unit} is not between {axis.sensor_min_y:g} {unit}, "
            f"the end of the potentiometer's voltages, and the smallest setpoint, min_y {axis.min_y:g} {unit}"
        )
    if not axis.max_y <= (high := _given(settings.max_y, axis.sensor_max_y)) <= axis.sensor_max_y:
        raise DocumentError(
            f"{where}.max_y: the soft end stop {high:g} {unit} is not between the largest setpoint, max_y "
            f"{axis.max_y:g} {unit}, and {axis.sensor_max_y:g} {unit}, the end of the potentiometer's "
            "voltages"
        )
    sensor_range = axis.sensor_max_y - axis.sensor_min_y
    for key, limit, bound, per in (
        ("max_error", settings.max_error, sensor_range, ""),
        ("max_speed", settings.max_speed, sensor_range / (SPEED_PERIODS * period_s), "/s"),
    ):
        if limit is not None and limit > bound:
            raise DocumentError(
                f"{where}.{key}: {limit:g} {unit}{per} can never be exceeded, because the potentiometer "
                f'cannot show more than {bound:g} {unit}{per}; reduce it, or write disabled = ["{key}"]'
            )
    if settings.far_open_v is not None and settings.far_open_v > axis.valve_v:
        raise DocumentError(
            f"{where}.far_open_v: {settings.far_open_v:g} V is more than the {axis.valve_v:g} V that the "
            'valve can be opened to both sides; reduce it, or write disabled = ["max_still_s"]'
        )


def _check_disabled(settings: EnvelopeSettings, where: str) -> None:
    for key in settings.disabled:
        given = getattr(settings, key)
        if given is not None:
            raise DocumentError(f"{where}.disabled: {key} is disabled and given, as {given:g}; remove one")


def _given(limit: float | None, default: float) -> float:
    return default if limit is None else limit
