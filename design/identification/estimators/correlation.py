"""Correlations of signals of which some samples are missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from design.mathematics.polynomials import Array, Flags


class Pair(NamedTuple):
    """Two signals (m,) over the same time, and which samples of each are known."""

    first: Array
    second: Array
    first_known: Flags
    second_known: Flags


def correlation(pairs: Sequence[Pair], lags: int) -> tuple[Array, Array]:
    """Return the sums of first(t) second(t + τ) for τ = 0 … lags, and the number of terms of each.

    Unknown samples must be 0.
    """
    sums, counts = np.zeros(lags + 1), np.zeros(lags + 1)
    for first, second, first_known, second_known in pairs:
        reach = min(lags, len(first) - 1)
        sums[: reach + 1] += _products(first, second, reach)
        if first_known.all() and second_known.all():
            counts[: reach + 1] += len(first) - np.arange(reach + 1)
        else:
            counts[: reach + 1] += np.rint(
                _products(first_known.astype(float), second_known.astype(float), reach)
            )
    return sums, counts


def autocorrelation(signals: Sequence[Array], lags: int) -> tuple[Array, int]:
    """Return the autocorrelation (lags + 1,), 1 at lag 0, and the number of samples.

    Missing samples are exactly 0.
    """
    known = [signal != 0.0 for signal in signals]
    sums, counts = correlation([Pair(e, e, k, k) for e, k in zip(signals, known, strict=True)], lags)
    samples = int(counts[0])
    if not sums[0] > 0.0:
        return np.eye(1, lags + 1)[0], samples
    # Divided by the number of samples, not of terms, as is usual, so that the sequence is positive definite.
    complete = max(sum(len(signal) for signal in signals), 1)
    spans = np.array([sum(max(len(signal) - lag, 0) for signal in signals) for lag in range(lags + 1)])
    filled = np.where(counts > 0.0, sums / np.maximum(counts, 1.0), 0.0) * spans / complete
    return filled / filled[0], samples


def _products(first: Array, second: Array, lags: int) -> Array:
    """Return the sums of first(t) second(t + τ) for τ = 0 … lags, from blocks, so that memory stays small."""
    if lags < 64:
        return np.array([first[: len(first) - lag] @ second[lag:] for lag in range(lags + 1)])
    size = next_fast_len(len(first) + lags, real=True)
    return np.asarray(irfft(np.conj(rfft(first, size)) * rfft(second, size), size)[: lags + 1])
