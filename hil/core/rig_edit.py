"""Change values in the text of a rig file, and keep the user's comments and order.

The text is edited line by line. The result is read again and compared, so that a form of TOML that this
module does not know (inline tables, dotted keys) is refused instead of spoiled.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Any

from hil.core.errors import DocumentError

ORIGIN = "# calibrated "
"""Beginning of the comment that says where values come from. A table has one at most."""


def with_values(
    text: str,
    table: tuple[str, ...],
    values: Mapping[str, float],
    origin: str,
    source: str,
    heading: str = ORIGIN,
) -> str:
    """Return ``text`` with new numbers in ``table``, and a comment ``# calibrated <origin>`` above them.

    ``heading`` is another beginning of this comment.

    ``source`` names the file in errors. Raises DocumentError if the table does not stand under a header of
    its own, such as ``[axes.vertical.valve]``.
    """
    lines = text.splitlines(keepends=True)
    first, end = _body(lines, table, source)
    body = [line for line in lines[first:end] if not line.startswith(heading)]
    missing = dict(values)
    for place, line in enumerate(body):
        match = re.match(r"([ \t]*)([A-Za-z0-9_-]+)([ \t]*=[ \t]*)([^#\s]+)(.*)", line, re.DOTALL)
        if match is not None and match[2] in missing:
            body[place] = _replaced(match, missing.pop(match[2]))
    added = [f"{key} = {_number(value)}\n" for key, value in missing.items()]
    edited = "".join([*lines[:first], f"{heading}{origin}\n", *added, *body, *lines[end:]])
    _check(text, edited, table, values, source)
    return edited


def _body(lines: list[str], table: tuple[str, ...], source: str) -> tuple[int, int]:
    """Return the range of the lines that belong to ``table``."""
    header = re.compile(r"[ \t]*\[[ \t]*" + r"[ \t]*\.[ \t]*".join(map(re.escape, table)) + r"[ \t]*\]")
    for place, line in enumerate(lines):
        if header.match(line):
            if not line.endswith("\n"):
                lines[place] = line + "\n"
            first = place + 1
            later = (n for n in range(first, len(lines)) if lines[n].lstrip().startswith("["))
            return first, next(later, len(lines))
    raise DocumentError(
        f"{source}: there is no table [{'.'.join(table)}] with a header of its own, so its values cannot be "
        "changed; write them into the file by hand"
    )


def _replaced(match: re.Match[str], value: float) -> str:
    """Return a line with another value. A comment behind it stays in its column if there is room."""
    indent, key, equals, old, rest = match.groups()
    new = _number(value)
    comment = rest.lstrip(" \t")
    if comment.startswith("#"):
        blanks = len(rest) - len(comment) + len(old) - len(new)
        rest = " " * max(blanks, 1) + comment
    return f"{indent}{key}{equals}{new}{rest}"


def _number(value: float) -> str:
    """Return a number of the rig file with as many digits as the wire can resolve."""
    return repr(round(float(value), 6))


def _check(text: str, edited: str, table: tuple[str, ...], values: Mapping[str, float], source: str) -> None:
    """Check that the edit changed these values and nothing else. Raises DocumentError."""
    try:
        expected, found = tomllib.loads(text), tomllib.loads(edited)
    except tomllib.TOMLDecodeError as error:
        raise DocumentError(f"{source}: {error}") from None
    inner: dict[str, Any] = expected
    for key in table:
        inner = inner.get(key, {})
    inner.update({key: float(_number(value)) for key, value in values.items()})
    if found != expected:
        raise DocumentError(
            f"{source}: the values of [{'.'.join(table)}] are written in a form that cannot be changed "
            "safely; write them into the file by hand"
        )
