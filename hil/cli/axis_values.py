"""Arguments of the form ``AXIS=VALUE``."""

from __future__ import annotations

from hil.core.errors import DocumentError


def by_axis(option: str, given: list[str], example: str) -> dict[str, str]:
    """Split ``AXIS=VALUE`` texts. ``option`` is empty for arguments without one. Raises DocumentError."""
    prefix = f"{option} " if option else ""
    pairs: dict[str, str] = {}
    for place, text in enumerate(given):
        name, equals, value = text.partition("=")
        if not equals or not name or not value:
            after = given[place + 1 : place + 2]
            raise DocumentError(f"{prefix}{_incomplete(text, after, prefix, example)}")
        if name in pairs:
            raise DocumentError(f"{prefix}{name} is given twice, as {pairs[name]!r} and as {value!r}")
        pairs[name] = value
    return pairs


def _incomplete(text: str, after: list[str], prefix: str, example: str) -> str:
    """Return what ``text`` lacks. ``after`` has the next argument, if there is one: it may be the value."""
    name, equals, value = text.partition("=")
    if after and "=" not in after[0] and not value:
        return f"{text!r} and {after[0]!r} belong together; write {prefix}{name}={after[0]}"
    axis, _, example_value = example.partition("=")
    if not name or (not equals and not name.isidentifier()):
        missing = value if equals else text
        return f"{text!r}: the axis is missing; write {prefix}{axis}={missing or example_value}"
    if not equals:  # an axis or a name of a controller
        return f"{text!r}: the axis or the value is missing; write {prefix}{example}"
    return f"{text!r}: the value is missing; write {prefix}{name}={example_value}"
