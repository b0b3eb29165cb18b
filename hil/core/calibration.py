"""Calibrate an axis: potentiometer from two known positions, valve centre and dead band from small motions.

Voltages are in V, positions in the axis' unit. This module decides what a measurement is good for; it moves
nothing and reads no bus.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

from hil.core.errors import HilError
from hil.core.rig import MAX_WIRE_V, Rig

MIN_SAMPLES: Final = 20
"""Number of samples from which a voltage at rest is computed at least."""
MAX_DRIFT_V: Final = 0.03
"""Largest change of the mean voltage between both halves of a measurement at rest, in V."""
MAX_NOISE_V: Final = 0.05
"""Largest standard deviation of a measurement at rest, in V."""
MIN_SPAN_V: Final = 1.0
"""Smallest distance of the voltages at both ends, in V. A smaller one wastes the converter's resolution."""
MAX_OTHER_SHARE: Final = 0.5
"""Largest motion of another channel, as a share of the calibrated channel's."""
MARGIN_SHARE: Final = 0.02
"""Distance of ``min_v`` and ``max_v`` from the voltages at the ends, as a share of their distance."""
SMALLEST_MIN_V: Final = 0.05
"""Voltage under which a broken wire cannot be told from a position."""
MIN_SPEED_SHARE_S: Final = 0.01
"""Smallest speed that counts as motion, in ranges of the axis per second."""


class CalibrationError(HilError):
    """A measurement makes no sense. The message says why, and what to do."""


class RestingVolts(NamedTuple):
    """Voltages of all channels while nothing moves."""

    mean_v: tuple[float, ...]
    noise_v: tuple[float, ...]
    """Standard deviation of each channel."""


class End(NamedTuple):
    """A position that the user has measured, and the voltages there."""

    y: float
    volts: RestingVolts


class PotentiometerValues(NamedTuple):
    """Values for ``[axes.NAME.potentiometer]`` of the rig file."""

    y_at_0v: float
    y_at_10v: float
    min_v: float
    max_v: float


class ValveValues(NamedTuple):
    """Result of a search for the centre of a valve."""

    centre_v: float
    """Voltage at which the axis stands still."""
    dead_band_v: float
    """Width of the range of voltages in which the axis stands still."""


def resting_volts(samples: Sequence[tuple[float, ...]], channel: int, axis: str) -> RestingVolts:
    """Return the mean voltages of all channels, from samples that were taken at rest.

    ``channel`` (1 to 3) belongs to ``axis``. Raises CalibrationError if its samples are too few or too noisy,
    or if the axis moves.
    """
    if len(samples) < MIN_SAMPLES:
        raise CalibrationError(
            f"{axis}: {len(samples)} samples arrived, at least {MIN_SAMPLES} are needed: is SYNC on the bus, "
            "and is the ADC board operational? See `hil monitor`"
        )
    columns = list(zip(*samples, strict=True))
    means = tuple(math.fsum(column) / len(column) for column in columns)
    noise = tuple(
        math.sqrt(math.fsum((v - mean) ** 2 for v in column) / len(column))
        for column, mean in zip(columns, means, strict=True)
    )
    own = columns[channel - 1]
    half = len(own) // 2
    drift_v = math.fsum(own[-half:]) / half - math.fsum(own[:half]) / half
    if abs(drift_v) > MAX_DRIFT_V:
        raise CalibrationError(
            f"{axis}: the potentiometer moves by {drift_v:+.3f} V during the measurement, limit "
            f"{MAX_DRIFT_V:g} V: hold the axis still and repeat"
        )
    if noise[channel - 1] > MAX_NOISE_V:
        raise CalibrationError(
            f"{axis}: the potentiometer's noise is {noise[channel - 1]:.3f} V, limit {MAX_NOISE_V:g} V: "
            "check its cable and its supply"
        )
    return RestingVolts(means, noise)


def potentiometer_values(rig: Rig, axis: str, low: End, high: End) -> PotentiometerValues:
    """Return the scaling from two ends. Raises CalibrationError if they make no sense."""
    settings = rig.axes[axis]
    place = settings.potentiometer.channel - 1
    if not low.y < high.y:
        raise CalibrationError(
            f"{axis}: the lower end is at {low.y:g} {settings.unit} and the upper end at {high.y:g} "
            f"{settings.unit}: --low must be less than --high"
        )
    low_v, high_v = low.volts.mean_v[place], high.volts.mean_v[place]
    span_v = high_v - low_v
    _check_other_channels(rig, axis, low, high, abs(span_v))
    if abs(span_v) < MIN_SPAN_V:
        raise CalibrationError(
            f"{axis}: the ends are {low_v:.3f} V and {high_v:.3f} V, {abs(span_v):.3f} V apart, at least "
            f"{MIN_SPAN_V:g} V are needed: did the axis move from end to end, and is its potentiometer on "
            f"channel {place + 1} (rig: axes.{axis}.potentiometer.channel)?"
        )
    slope = (high.y - low.y) / span_v
    y_at_0v = low.y - slope * low_v
    margin_v = MARGIN_SHARE * abs(span_v)
    min_v = max(min(low_v, high_v) - margin_v, SMALLEST_MIN_V)
    max_v = min(max(low_v, high_v) + margin_v, math.floor(MAX_WIRE_V * 1e3) / 1e3)
    if min_v > min(low_v, high_v):
        raise CalibrationError(
            f"{axis}: the voltage at an end is {min(low_v, high_v):.3f} V, less than {SMALLEST_MIN_V:g} V: a "
            "broken wire would look like this position; mount the potentiometer so that its end is not used"
        )
    return PotentiometerValues(y_at_0v, y_at_0v + 10.0 * slope, math.floor(min_v * 1e3) / 1e3, max_v)


def check_middle(axis: str, channel: int, low: End, high: End, middle: RestingVolts) -> None:
    """Check a position between the ends. Raises CalibrationError if its voltage is not between theirs."""
    place = channel - 1
    first, last = sorted((low.volts.mean_v[place], high.volts.mean_v[place]))
    middle_v = middle.mean_v[place]
    if not first < middle_v < last:
        raise CalibrationError(
            f"{axis}: between the ends the potentiometer has {middle_v:.3f} V, which is not between "
            f"{first:.3f} V and {last:.3f} V: it turns through its gap, or the axis moved the wrong way; "
            "mount it again and repeat"
        )


def _check_other_channels(rig: Rig, axis: str, low: End, high: End, span_v: float) -> None:
    for name, other in rig.axes.items():
        place = other.potentiometer.channel - 1
        moved_v = abs(high.volts.mean_v[place] - low.volts.mean_v[place])
        if name != axis and moved_v > max(MAX_OTHER_SHARE * span_v, MIN_SPAN_V):
            raise CalibrationError(
                f"{axis}: the potentiometer of {name} (channel {place + 1}) moved by {moved_v:.3f} V and "
                f"that of {axis} by {span_v:.3f} V: another axis was moved, or the channels are exchanged "
                "(rig: axes.NAME.potentiometer.channel)"
            )


def valve_values(rig: Rig, axis: str, speed_at: Callable[[float], float], step_v: float) -> ValveValues:
    """Find the valve's centre and dead band.

    ``speed_at(offset_v)`` moves the axis for a short time with the valve ``offset_v`` from the rig file's
    centre, and returns the speed in the axis' unit per s. Offsets grow by ``step_v``, with alternating signs,
    so that the axis stays where it is. The threshold of motion is ``MIN_SPEED_SHARE_S``. Raises
    CalibrationError if the axis does not move, or moves the wrong way.
    """
    settings = rig.axes[axis]
    min_speed = MIN_SPEED_SHARE_S * (settings.max_y - settings.min_y)
    max_v = settings.operator_limits.jog_max_v
    speeds: dict[float, float] = {}
    for number in range(1, math.floor(max_v / step_v + 1e-9) + 1):
        for offset_v in (number * step_v, -number * step_v):
            speeds[offset_v] = speed_at(offset_v)
        up, down = speeds[number * step_v], speeds[-number * step_v]
        if up < -2 * min_speed and down > 2 * min_speed:
            raise CalibrationError(
                f"{axis}: with {number * step_v:+.3f} V the position falls by {-up:.4g} {settings.unit}/s, "
                f"and with {-number * step_v:+.3f} V it rises: it moves the wrong way; exchange the hoses of "
                "the cylinder, or calibrate the potentiometer with the ends exchanged"
            )
        if up >= 2 * min_speed and down <= -2 * min_speed:
            break
    else:
        raise CalibrationError(
            f"{axis}: the axis does not move both ways with the valve up to {max_v:g} V from its centre "
            f"(rig: axes.{axis}.operator.jog_max_v): is the supply on, and is the valve on channel "
            f"{settings.valve.channel} (rig: axes.{axis}.valve.channel)?"
        )
    opens_up_v = _crossing(speeds, min_speed)
    opens_down_v = _crossing(speeds, -min_speed)
    centre_v = settings.valve.centre_v + 0.5 * (opens_up_v + opens_down_v)
    return ValveValues(centre_v, max(opens_up_v - opens_down_v, 0.0))


def _crossing(speeds: Mapping[float, float], level: float) -> float:
    """Return the offset at which the speed passes ``level``, by interpolation between measured offsets."""
    points = sorted(speeds.items())
    if level > 0:
        last = max(place for place, (_, speed) in enumerate(points) if speed < level)
        first = last + 1
    else:
        first = min(place for place, (_, speed) in enumerate(points) if speed > level)
        last, first = first - 1, first
    (left_v, left), (right_v, right) = points[last], points[first]
    return left_v + (level - left) / (right - left) * (right_v - left_v)
