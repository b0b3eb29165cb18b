"""Arguments of the form ``AXIS=VALUE``."""

from __future__ import annotations

from hil.core.errors import DocumentError


def by_axis(option: str, given: list[str], example: str) -> dict[str, str]:
    """Split ``AXIS=VALUE`` texts. ``option`` is empty for arguments without one. Raises DocumentError."""
    prefix = f"{option} " if option else ""
    pairs: dict[str, str] = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or not name or not value:
            raise DocumentError(
                f"{prefix}{text!r}: the axis or the value is missing; write {prefix}{example}"
            )
        if name in pairs:
            raise DocumentError(f"{prefix}{name} is given twice, as {pairs[name]!r} and as {value!r}")
        pairs[name] = value
    return pairs
