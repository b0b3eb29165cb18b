"""Turn TOML and JSON documents into typed, frozen objects. No other module does.

A document is a ``msgspec.Struct`` with ``frozen=True, forbid_unknown_fields=True``. Every error carries the
name of the file and the dotted path of the key: ``rig.toml: axes.vertical.valve.max_v is 11.3, but …``.
A document is refused if a key is given twice, if a number is not finite, or if it exceeds the limits below.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, TypeVar

import msgspec

from hil.core.document_keys import key_problems
from hil.core.document_kinds import kind_with_keys, wrong_kind
from hil.core.document_paths import Steps, dotted
from hil.core.document_words import validation_problem
from hil.core.errors import DocumentError

T = TypeVar("T")

_COMMENTED_HEADING = re.compile(r"#\s*(\[[\w.]+\])")

MAX_NESTING = 32
"""Tables and lists inside one another."""
MAX_ENTRIES = 10_000
"""Entries of one list or keys of one table, unless the type of the document allows more."""
MAX_INTEGER = 2**63 - 1
"""Largest magnitude of an integer."""
_LONG_DOTTED_KEY = re.compile(rf"(?<![\w\"'-])(?:[\w\"'-]++[ \t]*+\.[ \t]*+){{{MAX_NESTING + 1}}}")
"""A dotted key that nests too deeply. tomllib takes quadratic time for it."""


class Document(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every typed document and of the tables inside it."""

    max_entries: ClassVar[int] = MAX_ENTRIES
    """Largest number of entries of any list or table in a document of this type."""


def from_toml(text: str, kind: type[T], source: str) -> T:
    """Read TOML ``text`` as a ``kind``. ``source`` (a file name) goes into errors. Raises DocumentError."""
    return from_plain(parse_toml(text, source, kind), kind, source)


def from_json(text: str, kind: type[T], source: str) -> T:
    """Read JSON ``text`` as a ``kind``. ``source`` (a file name) goes into errors. Raises DocumentError."""
    return from_plain(_parse("JSON", text, kind, source), kind, source)


def parse_toml(text: str, source: str, kind: type) -> dict[str, Any]:
    """Parse TOML ``text`` that will be read as a ``kind``, without any check of its content.

    Raises DocumentError.
    """
    plain: dict[str, Any] = _parse("TOML", text, kind, source)
    return plain


def from_plain(plain: Any, kind: type[T], source: str) -> T:
    """Read nested dicts, lists and scalars as a ``kind``.

    Raises DocumentError. Its text has one line for each unknown key and for each table with missing keys, or
    else names the first value that is not allowed.
    """
    _check_limits(plain, source, getattr(kind, "max_entries", MAX_ENTRIES))
    try:
        return msgspec.convert(plain, kind)
    except msgspec.ValidationError as error:
        other_kind = wrong_kind(plain, _top_level_keys(kind))
        problems = [other_kind] if other_kind else key_problems(plain, kind)
        problems = problems or [validation_problem(str(error), plain, kind)]
        raise DocumentError("\n".join(f"{source}: {problem}" for problem in problems)) from None


def to_json(document: object) -> str:
    """Return the document as indented JSON, which :func:`from_json` reads back to an equal object."""
    return json.dumps(msgspec.to_builtins(document), indent=2, allow_nan=False) + "\n"


class _RepeatedKeyTable(dict[str, Any]):
    """A JSON table with a key that is given twice. Its place in the document is found after parsing."""

    repeated: tuple[str, Any, Any]
    """The key, its first and its second value."""


def _table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) == len(pairs):
        return table
    seen: dict[str, Any] = {}
    marked = _RepeatedKeyTable(table)
    for key, value in reversed(pairs):
        if key in seen:
            marked.repeated = (key, value, seen[key])
        seen[key] = value
    return marked


def _load_toml(text: str) -> Any:
    too_deep = _LONG_DOTTED_KEY.search(text)
    if too_deep:
        line = text.count("\n", 0, too_deep.start()) + 1
        raise ValueError(f"a dotted key has more than {MAX_NESTING} parts (line {line})")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(_with_line(str(error), text)) from None


def _load_json(text: str) -> Any:
    return json.loads(text, object_pairs_hook=_table)


_LOADERS: dict[str, Callable[[str], Any]] = {"TOML": _load_toml, "JSON": _load_json}


def _parse(syntax: str, text: str, kind: type, source: str) -> Any:
    try:
        plain = _LOADERS[syntax](text)
    except (ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        other_kind = _kind_in_other_syntax(syntax, text, kind)
        raise DocumentError(f"{source}: {other_kind or f'not valid {syntax}: {reason}'}") from None
    return plain


def _kind_in_other_syntax(syntax: str, text: str, kind: type) -> str | None:
    """Return what is said of a file of another kind, which is written in the other syntax."""
    try:
        plain = _LOADERS["JSON" if syntax == "TOML" else "TOML"](text)
    except (ValueError, RecursionError):
        return None
    expected = kind_with_keys(_top_level_keys(kind))
    said = wrong_kind(plain, _top_level_keys(kind))
    if (
        said is None
        and expected is not None
        and isinstance(plain, dict)
        and not expected.marks.isdisjoint(plain)
    ):
        return f"{expected.name} is written in {syntax}; this one is not"
    return said


def _with_line(message: str, text: str) -> str:
    """Return a message of tomllib with the text of the line that it means."""
    message = message.replace("Cannot overwrite a value", "a key or table is given twice")
    message = re.sub(r"Cannot declare \(.*\) twice", "a table is given twice", message)
    place = re.search(r"line (\d+)", message)
    if place is None:
        return message
    lines = text.splitlines()[: int(place[1])]
    comment = _commented_table(lines) if "twice" in message else ""
    hint = f"; is the line {comment} above it still a comment?" if comment else ""
    return f"{message}: {lines[-1].strip()[:80]}{hint}"


def _commented_table(lines: list[str]) -> str:
    """Return the heading of a table that is a comment, if it is the last heading before the last line."""
    for line in reversed(lines[:-1]):
        if line.startswith("["):
            return ""
        if heading := _COMMENTED_HEADING.match(line):
            return heading[1]
    return ""


def _check_limits(plain: Any, source: str, max_entries: int) -> None:
    """Refuse repeated keys, numbers that are not finite, long lists and deep nesting."""
    for steps, value in _values(plain):
        problem = _limit_problem(value, len(steps), max_entries)
        if problem:
            place = f"{dotted(steps[:3])}…" if len(steps) > MAX_NESTING else dotted(steps)
            raise DocumentError(f"{source}: {place}{': ' if place else ''}{problem}")


def _limit_problem(value: Any, depth: int, max_entries: int) -> str | None:
    match value:
        case _ if depth > MAX_NESTING:
            return f"nested deeper than {MAX_NESTING}"
        case _RepeatedKeyTable(repeated=(key, first, second)):
            return f"key {key} is given twice, as {_short(first)} and as {_short(second)}; remove one"
        case dict() | list() if len(value) > max_entries:
            return f"{len(value)} entries, more than {max_entries}"
        case float() if not math.isfinite(value):
            return f"{value} is not a finite number"
        case int() if abs(value) > MAX_INTEGER:
            return "an integer of more than 64 bits"
    return None


def _short(value: Any) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 60 else f"{text[:60]}…"


def _values(plain: Any) -> Iterator[tuple[Steps, Any]]:
    """Yield every value with its place, in the document's order. Too deep nesting is yielded, not entered."""
    waiting: list[tuple[Steps, Any]] = [([], plain)]
    while waiting:
        steps, value = waiting.pop()
        yield steps, value
        if isinstance(value, dict | list) and len(steps) <= MAX_NESTING:
            items = list(value.items() if isinstance(value, dict) else enumerate(value))
            waiting.extend(([*steps, key], item) for key, item in reversed(items))


def _top_level_keys(kind: type) -> tuple[str, ...]:
    return tuple(getattr(kind, "__struct_fields__", ()))
