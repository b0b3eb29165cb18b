"""Search ranges of a design file: in which range, and on which scale, a parameter is searched."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from design.search.bounds import Parameter
from hil.core.documents import Document
from hil.core.errors import DocumentError


class SearchRange(Document, frozen=True):
    """Range in which a parameter is searched, linearly or in logarithms."""

    low: float
    high: float
    coding: Literal["logarithmic", "linear"] = "logarithmic"


def search_parameters(search_ranges: Mapping[str, SearchRange]) -> dict[str, Parameter]:
    """Return the search ranges of a design file as parameters, by name."""
    return {
        name: Parameter(name, search_range.low, search_range.high, search_range.coding)
        for name, search_range in search_ranges.items()
    }


def check_search_ranges(table: str, search_ranges: Mapping[str, SearchRange], source: str) -> None:
    """Raise DocumentError for a range without extent, or one that its coding cannot have."""
    for name, search_range in search_ranges.items():
        where = f"{source}: {table}.search_ranges.{name}"
        if not search_range.low < search_range.high:
            raise DocumentError(
                f"{where}: low {search_range.low:g} is not below high {search_range.high:g}; change one"
            )
        if search_range.coding == "logarithmic" and search_range.low <= 0.0:
            raise DocumentError(
                f"{where}: low {search_range.low:g} is not over 0, which logarithms need; raise low, "
                'or set coding = "linear"'
            )
