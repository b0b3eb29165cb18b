"""Orders side by side: information criteria on the fitted data, and the fit on other data."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import product

import numpy as np

from design.errors import DesignError
from design.identification.analysis.comparison import compare, overall_fit
from design.identification.estimators.estimate import Estimate
from design.identification.estimators.fit import fit
from design.identification.models.structures import (
    Armax,
    Arx,
    BoxJenkins,
    ContinuousPoles,
    OutputError,
    Structure,
)
from design.identification.records.experiment import Experiment

MAX_CONTINUOUS_ORDER = 4
"""Largest number of real poles and poles of pairs, together, that a search tries."""


class Criterion(StrEnum):
    """By what a structure is chosen."""

    AIC = "aic"
    BIC = "bic"
    VALIDATION = "fit on validation data"


@dataclass(frozen=True, eq=False)
class Row:
    """One structure of a search."""

    structure: Structure
    estimate: Estimate | None
    """None where the data cannot determine the structure."""
    fit_percent: float
    """Free-running fit on the validation data."""
    reason: str = ""
    """Why there is no estimate."""

    @property
    def aic(self) -> float:
        """Akaike's criterion. A smaller value is better."""
        return np.inf if self.estimate is None else self.estimate.aic

    @property
    def bic(self) -> float:
        """Schwarz's criterion. A smaller value is better."""
        return np.inf if self.estimate is None else self.estimate.bic


@dataclass(frozen=True, eq=False)
class OrderTable:
    """All structures of a search, in the order in which they were given."""

    rows: tuple[Row, ...]

    def best(self, criterion: Criterion = Criterion.BIC) -> Row:
        """Return the best structure by a criterion. Raises DesignError where none has a model."""
        usable = [row for row in self.rows if row.estimate is not None]
        if not usable:
            raise DesignError(
                "no structure of the search has a model: " + "; ".join({row.reason for row in self.rows})
            )
        match criterion:
            case Criterion.AIC:
                return min(usable, key=lambda row: row.aic)
            case Criterion.BIC:
                return min(usable, key=lambda row: row.bic)
            case Criterion.VALIDATION:
                return max(usable, key=lambda row: row.fit_percent)


def output_error_orders(
    nb: Iterable[int] = (1, 2, 3), nf: Iterable[int] = (1, 2, 3, 4), nk: Iterable[int] = (1, 2, 3)
) -> list[Structure]:
    """Return every output-error structure with these orders whose B is not longer than its F."""
    delays, lengths = tuple(nk), tuple(nb)
    return [OutputError(b, f, k) for f in nf for b in lengths for k in delays if b <= max(f, 1)]


def orders_of_kind(structure: Structure) -> list[Structure]:
    """Return the usual orders of the kind of a structure, in which C and D of BJ have one order.

    A continuous structure keeps its integrators and its largest dead time.
    """
    match structure:
        case OutputError():
            return output_error_orders()
        case Arx():
            return [Arx(a, b, k) for a, b, k in product(range(1, 7), (1, 2, 3), (1, 2, 3)) if b <= a]
        case Armax():
            orders = product((1, 2, 3, 4), (1, 2), (1, 2, 3), (1, 2))
            return [Armax(a, b, c, k) for a, b, c, k in orders if b <= a]
        case BoxJenkins():
            orders = product((1, 2, 3, 4), (1, 2), (1, 2), (1, 2))
            return [BoxJenkins(b, c, c, f, k) for f, b, c, k in orders if b <= f]
        case ContinuousPoles():
            return [
                replace(structure, real=real, pairs=pairs, zeros=zeros)
                for real, pairs, zeros in product(
                    (0, 1), (0, 1, 2), (0, 1, 2)
                )  # a pair may be two real poles
                if 0 < real + 2 * pairs <= MAX_CONTINUOUS_ORDER
                and zeros < real + 2 * pairs + structure.integrators
            ]


def search_orders(
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment],
    structures: Iterable[Structure],
    *,
    drift: bool = False,
) -> OrderTable:
    """Fit every structure, and compare each with the validation data in a free-running simulation."""
    rows = []
    for structure in structures:
        try:
            estimate = fit(experiments, structure, drift=drift)
        except DesignError as reason:
            rows.append(Row(structure, None, -np.inf, str(reason)))
            continue
        fit_percent = overall_fit(
            [compare(estimate.discrete, experiment, drift=drift) for experiment in validation]
        )
        rows.append(Row(structure, estimate, fit_percent))
    return OrderTable(tuple(rows))
