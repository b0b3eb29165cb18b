"""Search bounds: the range of each parameter, its coding, and the unit cube that searchers work in.

A searcher sees every parameter as a number from 0 to 1. :class:`SearchBounds` turns these numbers into
parameter values, linearly or in logarithms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from design.errors import DesignError
from design.mathematics.polynomials import Array, Flags

_AT_BOUND = 1e-2
"""Share of the coded search range within which a parameter counts as lying at its bound.

A searcher approaches a bound only slowly, so that the best point seldom lies exactly on it.
"""


@dataclass(frozen=True)
class Parameter:
    """A parameter to be found: its name, its search range [low, high], and how the range is coded.

    The coding is "logarithmic" (equal steps of the searcher are equal ratios; ``low`` must be over 0) or
    "linear" (equal steps are equal differences). Raises DesignError for an impossible range or coding.
    """

    name: str
    low: float
    high: float
    coding: str = "logarithmic"

    def __post_init__(self) -> None:
        if self.coding not in ("logarithmic", "linear"):
            raise DesignError(f"{self.name}: coding {self.coding!r} is neither 'logarithmic' nor 'linear'")
        search_range = f"{self.name}: search range [{self.low}, {self.high}]"
        if not self.low < self.high:
            raise DesignError(f"{search_range}: low must be below high")
        if self.coding == "logarithmic" and not self.low > 0.0:
            raise DesignError(
                f"{search_range}: a logarithmic coding needs low over 0; raise low, or use coding = 'linear'"
            )


@dataclass(frozen=True)
class SearchBounds:
    """The search ranges of several parameters, mapped onto the unit cube."""

    parameters: tuple[Parameter, ...]

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names, in the order of the cube's dimensions."""
        return tuple(parameter.name for parameter in self.parameters)

    def decode(self, unit: Array) -> Array:
        """Return the parameter values (n, p) at points (n, p) of the unit cube."""
        low, high, logarithmic = self._limits()
        linear = low + unit * (high - low)
        safe_low, safe_high = np.where(logarithmic, low, 1.0), np.where(logarithmic, high, 1.0)
        return np.where(logarithmic, safe_low * (safe_high / safe_low) ** unit, linear)

    def at_bounds(self, unit: Array) -> tuple[str, ...]:
        """Return the names of the parameters that lie at a search bound at a point (p,) of the unit cube."""
        near = np.minimum(unit, 1.0 - unit) < _AT_BOUND
        return tuple(name for name, touching in zip(self.names, near, strict=True) if touching)

    def _limits(self) -> tuple[Array, Array, Flags]:
        low = np.array([parameter.low for parameter in self.parameters])
        high = np.array([parameter.high for parameter in self.parameters])
        return low, high, np.array([parameter.coding == "logarithmic" for parameter in self.parameters])


AnyStructure = TypeVar("AnyStructure")


def with_bounds(structure: AnyStructure, bounds: Mapping[str, Parameter]) -> AnyStructure:
    """Return a copy of a structure in which the parameters named in ``bounds`` are replaced.

    A structure is any dataclass with a field ``parameters``. Raises DesignError for a name that it lacks.
    """
    if not bounds:
        return structure
    parameters: tuple[Parameter, ...] = structure.parameters  # type: ignore[attr-defined]
    unknown = set(bounds) - {parameter.name for parameter in parameters}
    if unknown:
        raise DesignError(
            f"search bounds: this structure has no parameter {', '.join(sorted(unknown))}; it has "
            + ", ".join(parameter.name for parameter in parameters)
        )
    changed = tuple(bounds.get(parameter.name, parameter) for parameter in parameters)
    return replace(structure, parameters=changed)  # type: ignore[type-var]
