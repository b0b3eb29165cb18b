"""Least squares in which most unknowns matter to one stretch or one experiment only.

The unknowns are, in this order, those of a stretch (its initial state), those of an experiment (offset,
drift) and those that all data share. An orthogonal triangularisation of each stretch separates its own
unknowns from what it says about the others; the remainders are stacked and triangularised again, by
experiment and then as a whole. The result is exact, and no matrix is larger than one stretch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from design.identification.least_squares import solved, triangle
from design.mathematics.polynomials import Array


class Layout(NamedTuple):
    """Number of unknowns of a stretch, of an experiment, and shared by all data."""

    local: int
    common: int
    shared: int


class Reduced(NamedTuple):
    """Triangular factors: rows of the unknowns of each stretch, of each experiment, and the shared rest."""

    layout: Layout
    local: list[Array]
    common: dict[int, Array]
    shared: Array
    """Upper triangle (p, p) over the shared columns. Its last column is the output's."""

    def common_values(self, experiment: int, shared: Array) -> Array:
        """Return the offset and drift (c,) of an experiment, for values (p,) of the shared columns."""
        rows = self.common[experiment]
        return solved(rows[:, : self.layout.common], -rows[:, self.layout.common :] @ shared)

    def local_values(self, stretch: int, common: Array, shared: Array) -> Array:
        """Return the initial state (n,) of a stretch, for values of the other columns."""
        rows, n = self.local[stretch], self.layout.local
        right = rows[:, n : n + self.layout.common] @ common + rows[:, n + self.layout.common :] @ shared
        return solved(rows[:, :n], -right)


def reduce(columns: Sequence[Array], experiments: Sequence[int], layout: Layout) -> Reduced:
    """Triangularise the columns (local + common + shared, m) of each stretch.

    ``experiments`` names the experiment of each stretch.
    """
    n, c = layout.local, layout.common
    local: list[Array] = []
    below_local: dict[int, list[Array]] = {}
    for block, experiment in zip(columns, experiments, strict=True):
        R = triangle(block)
        local.append(R[:n])
        below_local.setdefault(experiment, []).append(R[n:, n:])
    common: dict[int, Array] = {}
    rest: list[Array] = []
    for experiment, parts in below_local.items():
        R = parts[0] if len(parts) == 1 else triangle(np.concatenate(parts).T)
        common[experiment] = R[:c]
        rest.append(R[c:, c:])
    return Reduced(
        layout, local, common, _square(rest[0] if len(rest) == 1 else triangle(np.concatenate(rest).T))
    )


def projected(columns: Sequence[Array], experiments: Sequence[int], reduced: Reduced) -> list[Array]:
    """Return the shared columns (p - 1, m) of each stretch without what the other unknowns explain of them.

    The last shared column, the output's, is left out.
    """
    n, c = reduced.layout.local, reduced.layout.common
    unit = np.eye(reduced.layout.shared)[:, :-1]
    found = []
    for i, (block, experiment) in enumerate(zip(columns, experiments, strict=True)):
        common = reduced.common_values(experiment, unit)
        local = reduced.local_values(i, common, unit)
        found.append(block[n + c : -1] + local.T @ block[:n] + common.T @ block[n : n + c])
    return found


def _square(R: Array) -> Array:
    """Return R with rows of zeros below, where fewer rows than columns remained."""
    missing = R.shape[1] - len(R)
    return np.concatenate([R, np.zeros((missing, R.shape[1]))]) if missing > 0 else R
