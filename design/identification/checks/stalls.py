"""Times at which the output stands still although the model moves: friction, or an end stop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from design.identification.analysis.comparison import Comparison
from design.identification.records.experiment import Experiment
from design.mathematics.polynomials import Array

WINDOWS = (8, 12, 16, 24, 32, 48, 64, 96)
"""Lengths in samples of the windows in which motions are compared."""
FEWEST = 30
"""Number of windows with a clear motion of the model below which a length says nothing."""
_AT_EXTREME = 0.03
"""Share of the output's range that counts as its extreme."""


class Stalls(NamedTuple):
    """Share of the windows with a clear motion of the model in which the output stood still."""

    between: float
    """Away from the extremes of the output."""
    at_extremes: float


def find_stalls(comparison: Comparison) -> Stalls:
    """Compare the motions of measured and simulated output in windows of several lengths.

    The worst shares are returned.
    """
    counts = comparison.experiment.observed & np.isfinite(comparison.simulated)
    y = np.where(counts, comparison.experiment.y, np.nan)
    known = y[counts]
    if len(known) < 4 * WINDOWS[0]:
        return Stalls(0.0, 0.0)
    span = float(np.ptp(known))
    noise = max(sensor_noise(comparison.experiment), 1e-9 * span)
    worst = [0.0, 0.0]
    for length in WINDOWS:
        smooth = max(1, length // 4)
        threshold = 5.0 * noise / np.sqrt(smooth)
        windows = [_windows(signal, length, smooth) for signal in (y, comparison.simulated)]
        if not len(windows[0]):
            break
        measured, model = (np.ptp(part, axis=1) for part in windows)
        # A NaN makes both comparisons false.
        moving = (model > 2.5 * threshold) & np.isfinite(measured)
        if np.count_nonzero(moving) < FEWEST:
            continue
        stalled = moving & (measured < threshold)
        middle = windows[0].mean(axis=1)
        extreme = (middle > known.max() - _AT_EXTREME * span) | (middle < known.min() + _AT_EXTREME * span)
        for i, place in enumerate((~extreme, extreme)):
            found = np.count_nonzero(stalled & place)
            if found >= 5:
                worst[i] = max(worst[i], found / np.count_nonzero(moving))
    return Stalls(*worst)


def sensor_noise(experiment: Experiment) -> float:
    """Return the standard deviation of an output's noise, at least that of its converter's steps."""
    y = np.where(experiment.observed, experiment.y, np.nan)
    return float(max(noise_std(y), quantum(y) / np.sqrt(12.0)))


def noise_std(y: Array) -> float:
    """Return the standard deviation of the noise in y (N,), from its second differences."""
    second = np.abs(np.diff(y, 2))
    second = second[np.isfinite(second)]
    if not len(second):
        return 0.0
    return float(np.median(second) / 0.6745 / np.sqrt(6.0))


def quantum(y: Array) -> float:
    """Return the smallest change between neighbours in y (N,) that is not 0: a converter's step."""
    changes = np.abs(np.diff(y))
    changes = changes[np.isfinite(changes) & (changes > 1e-12 * np.nanmax(np.abs(y), initial=0.0))]
    return float(changes.min()) if len(changes) else 0.0


def _windows(signal: Array, length: int, smooth: int) -> Array:
    """Return the moving averages over ``smooth`` samples, cut into overlapping windows (k, length)."""
    if len(signal) < length + smooth:
        return np.zeros((0, length))
    averaged = np.lib.stride_tricks.sliding_window_view(signal, smooth).mean(axis=1)
    return np.lib.stride_tricks.sliding_window_view(averaged, length)[:: max(1, length // 4)]
