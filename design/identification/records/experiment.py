"""Records of an experiment as the estimators take them: evenly sampled, with gaps that are masked.

Sample k of the output is read at the time k T, and the input u[k] acts from k T to (k + 1) T (zero-order
hold). A value that is not known is NaN. The estimators leave it out; they never fill it in.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from design.errors import DesignError
from design.mathematics.polynomials import Array, Flags

LARGEST_VALUE = 1e50
"""Largest modulus of a sample."""


class Names(NamedTuple):
    """Names and units of the two signals, for messages and axis labels."""

    u: str = "u"
    y: str = "y"
    u_unit: str = "V"
    y_unit: str = "m"


UNNAMED = Names()
"""Names and units of the signals if none are given."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """One evenly sampled record. The arrays (N,) are copies of what was given, and are read-only."""

    u: Array
    """Input at the actuator. NaN where it is not known."""
    y: Array
    """Output. NaN where no sample exists."""
    sample_time_s: float
    weights: Array = field(default_factory=lambda: np.zeros(0))
    """Weight of each squared output error, 0 where a sample must not count. Empty means 1 everywhere."""
    name: str = "record"
    names: Names = UNNAMED
    transport_delay_samples: int = 0
    """Whole periods between a recorded input and its action at the actuator, as the rig causes them."""

    def __post_init__(self) -> None:
        u, y = _column(self.u, self.name, self.names.u), _column(self.y, self.name, self.names.y)
        if len(u) != len(y):
            raise DesignError(
                f"{self.name}: {self.names.u} has {len(u)} samples and {self.names.y} has {len(y)}; both "
                "need one value for each period"
            )
        period = _period(self.sample_time_s, self.name)
        if self.transport_delay_samples < 0:
            raise DesignError(
                f"{self.name}: transport delay {self.transport_delay_samples} samples; it cannot be negative"
            )
        weights = np.array(self.weights, dtype=float)
        if weights.size == 0:
            weights = np.ones(len(y))
        if weights.shape != y.shape or not np.isfinite(weights).all() or (weights < 0.0).any():
            raise DesignError(f"{self.name}: weights must be {len(y)} finite numbers that are not negative")
        weights[~np.isfinite(y)] = 0.0
        for key, values in (("u", u), ("y", y), ("weights", weights)):
            values.flags.writeable = False
            object.__setattr__(self, key, values)
        object.__setattr__(self, "sample_time_s", period)

    def __len__(self) -> int:
        return len(self.y)

    @property
    def time_s(self) -> Array:
        """Times (N,) of the samples in s, from 0."""
        return np.asarray(np.arange(len(self)) * self.sample_time_s, dtype=float)

    @property
    def observed(self) -> Flags:
        """Samples (N,) whose output counts in a fit."""
        return self.weights > 0.0

    def part(self, start: int, stop: int, name: str | None = None) -> Experiment:
        """Return the samples ``start`` to ``stop`` as an experiment of its own."""
        span = slice(start, stop)
        return replace(
            self, u=self.u[span], y=self.y[span], weights=self.weights[span], name=name or self.name
        )

    def masked(self, without: ArrayLike) -> Experiment:
        """Return the record with the samples ``without`` (N,) marked as not counting."""
        return replace(self, weights=np.where(np.asarray(without, dtype=bool), 0.0, self.weights))

    def interrupted(self, at: ArrayLike) -> Experiment:
        """Return the record with an interruption at samples (N,), after which the state is unknown.

        For times at which no linear model holds, such as those at an end stop.
        """
        flags = np.asarray(at, dtype=bool)
        return replace(self, u=np.where(flags, np.nan, self.u), weights=np.where(flags, 0.0, self.weights))

    def at_the_actuator(self) -> Experiment:
        """Return the record with the transport delay removed: u[k] acts in period k.

        Its first inputs are unknown.
        """
        delay = self.transport_delay_samples
        if not delay:
            return self
        u = np.full(len(self), np.nan)
        u[delay:] = self.u[: max(len(self) - delay, 0)]
        return replace(self, u=u, transport_delay_samples=0)


def _period(value: object, record: str) -> float:
    """Return the sample time in s. Raises DesignError."""
    try:
        period = float(value)  # type: ignore[arg-type]  # whatever it is, float() says so
    except (TypeError, ValueError):
        raise DesignError(
            f"{record}: sample time {value!r} is not a number; give a number of seconds"
        ) from None
    if not (np.isfinite(period) and period > 0.0):
        raise DesignError(f"{record}: sample time {value} s; it must be positive, in seconds")
    return period


def _column(values: ArrayLike, record: str, signal: str) -> Array:
    """Return a copy as floats, NaN for everything that is not finite. Raises DesignError."""
    try:
        if np.iscomplexobj(values):
            raise TypeError
        column = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise DesignError(f"{record}: {signal} must be an array of real numbers") from None
    if column.ndim == 2 and 1 in column.shape:
        column = column.reshape(-1)
    if column.ndim != 1:
        raise DesignError(f"{record}: {signal} has shape {column.shape}; one column of numbers is needed")
    column[~np.isfinite(column)] = np.nan
    largest = float(np.nanmax(np.abs(column), initial=0.0))
    if largest > LARGEST_VALUE:
        raise DesignError(
            f"{record}: {signal} reaches {largest:.3g}; values over {LARGEST_VALUE:g} are not measurements"
        )
    return column


class Stretch(NamedTuple):
    """Consecutive samples of one experiment over which the input is known; arrays (m,)."""

    experiment: int
    start: int
    """Index of its first sample in the experiment."""
    u: Array
    y: Array
    """Output, 0 where it does not count."""
    root_weight: Array
    """Square root of the weight, 0 where the output does not count."""

    def __len__(self) -> int:
        return len(self.u)


def stretches(experiments: Sequence[Experiment], skipped: int = 0) -> list[Stretch]:
    """Return the stretches of all experiments that have an output sample which counts.

    The first ``skipped`` samples of a stretch do not count, since they depend on unknown earlier inputs.
    """
    found = []
    for index, experiment in enumerate(experiments):
        for first, last in runs(np.isfinite(experiment.u)):
            weights = experiment.weights[first:last].copy()
            weights[:skipped] = 0.0
            counts = np.flatnonzero(weights)
            if not len(counts):
                continue
            last = first + int(counts[-1]) + 1
            weights = weights[: last - first]
            y = np.where(weights > 0.0, experiment.y[first:last], 0.0)
            found.append(Stretch(index, first, experiment.u[first:last], y, np.sqrt(weights)))
    return found


def runs(flags: Flags) -> Iterator[tuple[int, int]]:
    """Return the start and end (exclusive) of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    for first, last in edges.reshape(-1, 2):
        yield int(first), int(last)
