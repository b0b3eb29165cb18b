"""Places inside a document: a list of keys and indices from the top, its dotted form, the value there."""

from __future__ import annotations

from typing import Any, TypeAlias

Steps: TypeAlias = list[str | int]
"""Keys of tables and indices of lists, from the top of a document to a value."""


def dotted(steps: Steps) -> str:
    """Return a place as people write it, such as ``axes.vertical.valve`` or ``law.num[2]``."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps).lstrip(".")


def value_at(plain: Any, steps: Steps) -> Any:
    """Return the value at a place; None where the document has none."""
    for step in steps:
        if isinstance(plain, dict):
            plain = plain.get(step)
        elif isinstance(plain, list) and isinstance(step, int) and step < len(plain):
            plain = plain[step]
        else:
            return None
    return plain


def with_value(plain: Any, steps: Steps, value: Any) -> Any:
    """Return a copy of a document with another value at a place that exists. Other parts are shared."""
    if not steps:
        return value
    changed = plain.copy()
    changed[steps[0]] = with_value(plain[steps[0]], steps[1:], value)
    return changed
