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

from design.identification.estimators.stacking import stacked
from design.identification.least_squares import solved, solved_each, triangle, triangles
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

    def local_values(self, common: Sequence[Array], shared: Array) -> Array:
        """Return the initial state (s, n) of each stretch, for values of the other columns.

        ``common`` (c,) is the offset and drift of the experiment of each stretch. With values of p columns,
        ``common`` (c, p) and ``shared`` (k, p), the result is (s, n, p).
        """
        n, c = self.layout.local, self.layout.common
        rows, others = np.stack(self.local), np.stack(common)
        if shared.ndim == 1:
            right = rows[:, :, n : n + c] @ others[..., None] + (rows[:, :, n + c :] @ shared)[..., None]
            return solved_each(rows[:, :, :n], -right)[..., 0]
        right = rows[:, :, n : n + c] @ others + rows[:, :, n + c :] @ shared
        return solved_each(rows[:, :, :n], -right)


def reduce(columns: Sequence[Array], experiments: Sequence[int], layout: Layout) -> Reduced:
    """Triangularise the columns (local + common + shared, m) of each stretch.

    ``experiments`` names the experiment of each stretch.
    """
    n, c = layout.local, layout.common
    triangular = {
        place: R
        for places, blocks in stacked(columns)
        for place, R in zip(places, triangles(blocks), strict=True)
    }
    local: list[Array] = []
    below_local: dict[int, list[Array]] = {}
    for place, experiment in enumerate(experiments):
        R = triangular[place]
        local.append(_with_rows(R[:n], n))
        below_local.setdefault(experiment, []).append(R[n:, n:])
    common: dict[int, Array] = {}
    rest: list[Array] = []
    for experiment, parts in below_local.items():
        R = parts[0] if len(parts) == 1 else triangle(np.concatenate(parts).T)
        common[experiment] = R[:c]
        rest.append(R[c:, c:])
    shared = rest[0] if len(rest) == 1 else triangle(np.concatenate(rest).T)
    return Reduced(layout, local, common, _with_rows(shared, shared.shape[1]))


def projected(columns: Sequence[Array], experiments: Sequence[int], reduced: Reduced) -> list[Array]:
    """Return the shared columns (p - 1, m) of each stretch without what the other unknowns explain of them.

    The last shared column, the output's, is left out.
    """
    n, c = reduced.layout.local, reduced.layout.common
    unit = np.eye(reduced.layout.shared)[:, :-1]
    values = {experiment: reduced.common_values(experiment, unit) for experiment in set(experiments)}
    found = []
    local = reduced.local_values([values[experiment] for experiment in experiments], unit)
    for block, experiment, state in zip(columns, experiments, local, strict=True):
        common = values[experiment]
        found.append(block[n + c : -1] + state.T @ block[:n] + common.T @ block[n : n + c])
    return found


def _with_rows(R: Array, count: int) -> Array:
    """Return R with rows of zeros below, so that it has ``count`` of them."""
    missing = count - len(R)
    return np.concatenate([R, np.zeros((missing, R.shape[1]))]) if missing > 0 else R
