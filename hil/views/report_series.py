"""Reduces the signals of a run to what a page can hold: the smallest and the largest value in each time slot.

A page has the same number of slots whatever the length of the run, so that its size is bounded. A run that is
short enough has one slot for each period, and loses nothing. Values are 16-bit numbers between the smallest
and the largest value of the series.
"""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

MAX_SLOTS = 20_000
"""Largest number of time slots. An hour then has five slots a second."""
_STEPS = 65_534
"""Number of steps between the smallest and the largest value."""
_EMPTY = 65_535
"""Code of a slot without a value."""


@dataclass(frozen=True)
class Slots:
    """Time slots of equal length; slot i begins at ``start_s + i length_s``."""

    start_s: float
    length_s: float
    count: int

    @staticmethod
    def over(start_s: float, end_s: float, period_s: float, max_slots: int = MAX_SLOTS) -> Slots:
        """Return slots for a range of time, of one period each if there are not more than ``max_slots``."""
        span_s = max(end_s - start_s, period_s)
        count = min(math.ceil(span_s / period_s) + 1, max_slots)
        length_s = period_s if count < max_slots else span_s / (count - 1)
        return Slots(start_s - length_s / 2, length_s, count)

    def of(self, time_s: npt.NDArray[np.float64]) -> npt.NDArray[np.int32]:
        """Return the slot of each instant; instants outside belong to the first or the last one."""
        exact = time_s - self.start_s
        exact /= self.length_s
        np.clip(exact, 0.0, self.count - 1.0, out=exact)
        return exact.astype(np.int32)


class SlotSeries:
    """The smallest and the largest value of a signal in each slot, collected from consecutive parts."""

    def __init__(self, slots: Slots) -> None:
        self.slots = slots
        self._smallest, self._largest = np.full(slots.count, np.nan), np.full(slots.count, np.nan)

    def add(self, time_s: npt.NDArray[np.float64], values: npt.NDArray[Any]) -> None:
        """Take the values at ``time_s`` (n,), which must ascend. Values that are not finite are left out."""
        values = np.asarray(values, np.float64)
        known = np.isfinite(values)
        if not known.all():
            time_s, values = time_s[known], values[known]
        if len(values) == 0:
            return
        slot = self.slots.of(time_s)
        first = np.concatenate([[0], np.flatnonzero(slot[1:] != slot[:-1]) + 1])
        places = slot[first]
        self._smallest[places] = np.fmin(self._smallest[places], np.minimum.reduceat(values, first))
        self._largest[places] = np.fmax(self._largest[places], np.maximum.reduceat(values, first))

    def encoded(self) -> dict[str, Any]:
        """Return the series for the page: ``low``, ``high`` and the base64 of the slots' extreme values.

        ``max`` is None where every slot has one value.
        """
        smallest, largest = self._smallest, self._largest
        is_empty = bool(np.isnan(smallest).all())
        low, high = (0.0, 0.0) if is_empty else (float(np.nanmin(smallest)), float(np.nanmax(largest)))
        is_single = np.array_equal(smallest, largest, equal_nan=True)
        return {
            "low": low,
            "high": high,
            "min": _base64(smallest, low, high),
            "max": None if is_single else _base64(largest, low, high),
        }


def encode(slots: Slots, time_s: npt.NDArray[np.float64], values: npt.NDArray[Any]) -> dict[str, Any]:
    """Return a series whose values (n,) are known at once, as :meth:`SlotSeries.encoded` does."""
    series = SlotSeries(slots)
    series.add(time_s, values)
    return series.encoded()


def extremes(
    time_s: npt.NDArray[np.float64], values: npt.NDArray[np.float64], max_slots: int = MAX_SLOTS
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return a curve of at most two points for each of ``max_slots`` slots: the extreme values in it.

    A curve (n,) that is short enough is returned as it is. ``time_s`` must ascend.
    """
    if len(values) <= 2 * max_slots:
        return time_s, values
    slots = Slots.over(float(time_s[0]), float(time_s[-1]), 1e-9, max_slots)
    first = np.flatnonzero(np.diff(slots.of(time_s), prepend=-1))
    pairs = np.stack([np.fmin.reduceat(values, first), np.fmax.reduceat(values, first)], axis=1)
    return np.repeat(time_s[first], 2), pairs.ravel()


def decode(series: dict[str, Any], which: str = "min") -> npt.NDArray[np.float64]:
    """Return the values of a series, as the script of the page does; NaN where a slot has none."""
    codes = np.frombuffer(base64.b64decode(series[which] or series["min"]), "<u2")
    values = series["low"] + codes * ((series["high"] - series["low"]) / _STEPS)
    return np.where(codes == _EMPTY, np.nan, values)


def _base64(values: npt.NDArray[np.float64], low: float, high: float) -> str:
    scale = _STEPS / (high - low) if high > low else 0.0
    known = np.isfinite(values)
    codes = np.full(len(values), _EMPTY, "<u2")
    codes[known] = np.round((values[known] - low) * scale)
    return base64.b64encode(codes.tobytes()).decode("ascii")
