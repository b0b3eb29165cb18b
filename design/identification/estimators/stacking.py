"""Signals of many lengths, stacked with others of similar length, so that a call handles many at once.

A record with many gaps has many short stretches. One call for each of them costs far more than the
arithmetic. Signals of similar length are therefore padded with zeros to one length, and stacked into one
array. A long signal stays alone, and is not copied.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from design.identification.models.difference_basis import differences
from design.mathematics.polynomials import Array

ALONE_FROM = 1024
"""Length from which a signal is not stacked with others."""
MIN_LENGTH = 32
"""Length to which the shortest signals are padded."""


class Stack(NamedTuple):
    """Signals of similar length, padded with zeros."""

    places: tuple[int, ...]
    """Place of each signal in the list that was stacked."""
    signals: Array
    """The signals (s, ..., m)."""


def stacked(signals: Sequence[Array]) -> Iterator[Stack]:
    """Yield signals (..., m), which differ in m alone, in stacks of similar length."""
    sizes = [_padded_length(signal.shape[-1]) for signal in signals]
    order = sorted(range(len(signals)), key=sizes.__getitem__)
    for size, members in groupby(order, key=sizes.__getitem__):
        places = tuple(members)
        if size >= ALONE_FROM or len(places) == 1:
            yield from (Stack((place,), signals[place][None]) for place in places)
            continue
        stack = np.zeros((len(places), *signals[places[0]].shape[:-1], size))
        for row, place in zip(stack, places, strict=True):
            row[..., : signals[place].shape[-1]] = signals[place]
        yield Stack(places, stack)


def filtered_differences(signals: Sequence[Array], f: Array, count: int, lag: int) -> list[Array]:
    """Return the differences (count, m) of each signal (m,) behind the filter 1/f.

    ``count`` and ``lag`` are those of :func:`differences`.
    """
    found: dict[int, Array] = {}
    for places, stack in stacked(signals):
        blocks = differences(lfilter([1.0], f, stack, axis=-1), count, lag)
        for place, block in zip(places, blocks, strict=True):
            found[place] = block[:, : len(signals[place])]
    return [found[place] for place in range(len(signals))]


def _padded_length(length: int) -> int:
    """Return the power of two to which a signal is padded, or the length of one that stays alone."""
    return length if length >= ALONE_FROM else max(MIN_LENGTH, 1 << (length - 1).bit_length())
