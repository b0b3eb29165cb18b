"""Parameters to be found: boxes and codings, and the unit cube that searchers see. No control engineering."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from design.errors import DesignError
from design.mathematics.polynomials import Array, Flags

_AT_A_WALL = 1e-2
"""Of the box's width, as coded: a searcher comes near a wall only slowly."""


@dataclass(frozen=True)
class Parameter:
    """One number to be found, its box, and whether the search sees it or its logarithm."""

    name: str
    low: float
    high: float
    coding: str = "logarithmic"

    def __post_init__(self) -> None:
        if self.coding not in ("logarithmic", "linear"):
            raise DesignError(f"{self.name}: coding {self.coding!r} is neither 'logarithmic' nor 'linear'")
        if not self.low < self.high:
            raise DesignError(f"{self.name}: box [{self.low}, {self.high}]: low must be below high")
        if self.coding == "logarithmic" and not self.low > 0.0:
            raise DesignError(
                f"{self.name}: box [{self.low}, {self.high}]: a logarithmic coding needs low over 0; "
                "raise it, or use coding = 'linear'"
            )


@dataclass(frozen=True)
class Box:
    """Parameters as a unit cube: what searchers see."""

    parameters: tuple[Parameter, ...]

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names in order."""
        return tuple(parameter.name for parameter in self.parameters)

    def decode(self, unit: Array) -> Array:
        """Parameter values (n, p) from points (n, p) of the unit cube."""
        low, high, logarithmic = self._limits()
        linear = low + unit * (high - low)
        safe_low, safe_high = np.where(logarithmic, low, 1.0), np.where(logarithmic, high, 1.0)
        return np.where(logarithmic, safe_low * (safe_high / safe_low) ** unit, linear)

    def at_walls(self, unit: Array) -> tuple[str, ...]:
        """Names of the parameters that a point (p,) of the unit cube has at an end of their box."""
        near = np.minimum(unit, 1.0 - unit) < _AT_A_WALL
        return tuple(name for name, touching in zip(self.names, near, strict=True) if touching)

    def _limits(self) -> tuple[Array, Array, Flags]:
        low = np.array([parameter.low for parameter in self.parameters])
        high = np.array([parameter.high for parameter in self.parameters])
        return low, high, np.array([parameter.coding == "logarithmic" for parameter in self.parameters])


AnyStructure = TypeVar("AnyStructure")


def with_boxes(structure: AnyStructure, boxes: Mapping[str, Parameter]) -> AnyStructure:
    """The same structure with other boxes or codings for some of its parameters. Raises DesignError."""
    if not boxes:
        return structure
    parameters: tuple[Parameter, ...] = structure.parameters  # type: ignore[attr-defined]
    unknown = set(boxes) - {parameter.name for parameter in parameters}
    if unknown:
        raise DesignError(
            f"no parameter {', '.join(sorted(unknown))} in this structure; it has "
            + ", ".join(parameter.name for parameter in parameters)
        )
    changed = tuple(boxes.get(parameter.name, parameter) for parameter in parameters)
    return replace(structure, parameters=changed)  # type: ignore[type-var]
