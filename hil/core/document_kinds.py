"""Recognise what kind of file a document is, so that a file in the wrong place can be named.

A kind is known by its ``format`` key (JSON) or by top-level keys that no other kind has (TOML).
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple


class FileKind(NamedTuple):
    """One kind of file: how messages name it, how it is recognised, and the command that takes it."""

    name: str
    """The name with its article, such as ``a rig file``."""
    syntax: str
    """``TOML`` or ``JSON``."""
    marks: frozenset[str]
    """Top-level keys that only this kind has."""
    taken_by: str
    format: str | None = None
    """Value of the top-level key ``format``; None for kinds without that key."""


FILE_KINDS = (
    FileKind("a rig file", "TOML", frozenset({"bus", "gateway", "adc", "dac"}), "hil run --rig FILE"),
    FileKind(
        "a design file",
        "TOML",
        frozenset({"specifications", "weight", "controller", "search", "further_plants", "axis_unit"}),
        "hil design PLANT --design FILE",
    ),
    FileKind(
        "a scenario",
        "TOML",
        frozenset({"title", "duration_s", "setpoints", "controllers", "figure_axes", "events"}),
        "hil run --scenario FILE",
    ),
    FileKind("an arm file", "TOML", frozenset({"step_s", "body", "supply"}), "hil run --arm FILE"),
    FileKind(
        "a controller file", "JSON", frozenset({"law"}), "hil run --controller AXIS=FILE", "hil-controller"
    ),
    FileKind("a plant file", "JSON", frozenset({"num", "den"}), "hil design FILE", "hil-plant"),
)


def kind_of(plain: Any) -> FileKind | None:
    """Return the kind of file that a document is; None where it has the marks of none or of several."""
    if not isinstance(plain, dict):
        return None
    for kind in FILE_KINDS:
        if kind.format is not None and plain.get("format") == kind.format:
            return kind
    marked = [kind for kind in FILE_KINDS if not kind.marks.isdisjoint(plain)]
    return marked[0] if len(marked) == 1 else None


def kind_with_keys(keys: Collection[str]) -> FileKind | None:
    """Return the kind of file whose top level may have these keys."""
    return next((kind for kind in FILE_KINDS if kind.marks.issubset(keys)), None)


def wrong_kind(plain: Any, keys: Collection[str]) -> str | None:
    """Return a sentence that names the kind of a document, where a file of another kind was expected.

    ``keys`` are the top-level keys of the expected kind. None where the kind is right or not known.
    """
    found, expected = kind_of(plain), kind_with_keys(keys)
    if found is None or expected is None or found is expected:
        return None
    return f"this is {found.name}, not {expected.name}; `{found.taken_by}` takes it"
