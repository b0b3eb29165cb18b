"""Axes of a chart: from values to pixels, and the places and labels of the ticks."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_WIDEST_RATIO_WITH_MINOR_LABELS = 10.0**1.6
"""Largest ratio of the ends of a logarithmic axis on which 2 and 5 are labelled besides 1."""


@dataclass(frozen=True)
class Axis:
    """A labelled axis. An end that is None is taken from the curves."""

    label: str
    logarithmic: bool = False
    low: float | None = None
    high: float | None = None
    tick: float | None = None
    """Distance between ticks on a linear axis; None chooses a round number."""


@dataclass(frozen=True)
class Tick:
    """A place on an axis and its label. Minor ticks have an empty label."""

    value: float
    label: str


@dataclass(frozen=True)
class Scale:
    """The map from the values of an axis to pixels of the drawing."""

    low: float
    high: float
    logarithmic: bool
    start: float
    """Pixel of ``low``."""
    length: float
    """Pixels from ``low`` to ``high``; negative for a vertical axis, whose pixels count downwards."""
    tick: float | None

    def pixels(self, values: Array | float) -> Array:
        """Convert values to pixels; the result has the shape of ``values``."""
        with np.errstate(all="ignore"):
            position = self._position(np.asarray(values, dtype=float))
        low, high = (float(self._position(np.asarray(end))) for end in (self.low, self.high))
        return np.asarray(self.start + self.length * (position - low) / (high - low))

    def ticks(self) -> list[Tick]:
        """Return the ticks between both ends."""
        if self.logarithmic:
            return _logarithmic_ticks(self.low, self.high)
        return _linear_ticks(self.low, self.high, self.tick)

    def _position(self, values: Array) -> Array:
        return np.log10(values) if self.logarithmic else values


def make_scale(axis: Axis, data: Iterable[Array], start: float, length: float, margin: float) -> Scale:
    """Fit a scale to an axis and its data.

    ``margin`` is the free share of the span that is added at each end which the axis leaves open.
    """
    values = np.concatenate([np.asarray(values, dtype=float) for values in data])
    values = values[np.isfinite(values) & ((values > 0.0) if axis.logarithmic else True)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (1.0, 10.0)
    if axis.logarithmic:
        span = max(math.log10(high / low), 0.1)
        low, high = low / 10 ** (margin * span), high * 10 ** (margin * span)
    else:
        span = (high - low) or 1.0
        low, high = low - margin * span, high + margin * span
    low = low if axis.low is None else axis.low
    high = high if axis.high is None else axis.high
    if not low < high:
        high = low * 1.1 if low > 0.0 else low + 1.0
    return Scale(low, high, axis.logarithmic, start, length, axis.tick)


def _linear_ticks(low: float, high: float, distance: float | None) -> list[Tick]:
    if distance is None:
        rough = (high - low) / 5.5
        unit = 10.0 ** math.floor(math.log10(rough))
        distance = next(m * unit for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * unit >= rough)
    while (high - low) / distance > 10:
        distance *= 2.0
    first = math.ceil(low / distance - 1e-9)
    last = math.floor(high / distance + 1e-9)
    return [Tick(k * distance, f"{k * distance:.10g}".replace("-", "−")) for k in range(first, last + 1)]


def _logarithmic_ticks(low: float, high: float) -> list[Tick]:
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    decades_per_label = max(1, -(-(last - first) // 8))
    labelled = (1, 2, 5) if high / low < _WIDEST_RATIO_WITH_MINOR_LABELS else (1,)
    multiples = range(1, 10) if last - first <= 6 else (1,)
    ticks = []
    for decade in range(first, last + 1):
        for multiple in multiples:
            value = multiple * 10.0**decade
            if low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
                has_label = multiple in labelled and decade % decades_per_label == 0
                ticks.append(Tick(value, _power_of_ten(multiple, decade) if has_label else ""))
    return ticks


def _power_of_ten(multiple: int, decade: int) -> str:
    if -3 <= decade <= 3:
        return f"{multiple * 10.0**decade:g}"
    return ("" if multiple == 1 else f"{multiple}·") + "10" + str(decade).translate(_SUPERSCRIPTS)
