"""TOML and JSON documents become typed, frozen objects here, and nowhere else.

A document is a ``msgspec.Struct`` with ``frozen=True, forbid_unknown_fields=True``. Errors carry the
source and the dotted path of the key: ``rig.toml: axes.vertical.valve.max_v: …``.
"""

from __future__ import annotations

import copy
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias, TypeVar

import msgspec

from hil.core.errors import DocumentError

T = TypeVar("T")
Steps: TypeAlias = list[str | int | None]
"""Keys and indices from the top of a document; None is a key of a table that is not known yet."""

DEEPEST_NESTING = 32
LARGEST_INTEGER = 2**63 - 1


class Document(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every typed document and of the tables inside it."""


def from_toml(text: str, kind: type[T], source: str) -> T:
    """Read TOML ``text`` as a ``kind``; ``source`` (a file name) goes into errors. Raises DocumentError."""
    return from_plain(_parse(tomllib.loads, text, f"{source}: not valid TOML"), kind, source)


def from_json(text: str, kind: type[T], source: str) -> T:
    """Read JSON ``text`` as a ``kind``; ``source`` (a file name) goes into errors. Raises DocumentError."""
    return from_plain(_parse(json.loads, text, f"{source}: not valid JSON"), kind, source)


def from_plain(plain: Any, kind: type[T], source: str) -> T:
    """Read nested dicts, lists and scalars as a ``kind``; every number in them must be finite.

    Raises DocumentError with path and value.
    """
    for steps, value in _scalars(plain):
        if isinstance(value, float) and not math.isfinite(value):
            raise DocumentError(f"{source}: {_dotted(steps)}: {value} is not a finite number")
        if isinstance(value, int) and abs(value) > LARGEST_INTEGER:
            raise DocumentError(f"{source}: {_dotted(steps)}: an integer beyond 64 bits")
        if len(steps) > DEEPEST_NESTING:
            raise DocumentError(f"{source}: {_dotted(steps[:3])}…: nested deeper than {DEEPEST_NESTING}")
    try:
        return msgspec.convert(plain, kind)
    except msgspec.ValidationError as error:
        raise DocumentError(f"{source}: {_located(str(error), plain, kind)}") from None


def to_json(document: object) -> str:
    """The document as indented JSON that :func:`from_json` reads back to an equal object."""
    return json.dumps(msgspec.to_builtins(document), indent=2, allow_nan=False) + "\n"


def _parse(loads: Callable[[str], Any], text: str, complaint: str) -> Any:
    try:
        return loads(text)
    except ValueError as error:
        raise DocumentError(f"{complaint}: {error}") from None
    except RecursionError:
        raise DocumentError(f"{complaint}: nested too deeply") from None


def _scalars(plain: Any) -> Iterator[tuple[Steps, Any]]:
    """All that is neither a table nor a list in ``plain``, and what is nested too deeply, with its place."""
    waiting: list[tuple[Steps, Any]] = [([], plain)]
    while waiting:
        steps, value = waiting.pop()
        if isinstance(value, dict | list) and len(steps) <= DEEPEST_NESTING:
            items = value.items() if isinstance(value, dict) else enumerate(value)
            waiting.extend(([*steps, key], item) for key, item in items)
        else:
            yield steps, value


def _located(message: str, plain: Any, kind: Any) -> str:
    """``Expected `float` <= 10.0 - at `$.valve.max_v``` becomes ``valve.max_v: 11.3: expected …``."""
    text, separator, path = message.rpartition(" - at `$")
    if not separator:
        return message[:1].lower() + message[1:]
    steps = _named_steps(_steps(path), message, plain, kind)
    if text.startswith("Invalid") and (choices := _choices(kind, steps)):
        text = f"must be {' or '.join(map(repr, choices))}"
    text = text[:1].lower() + text[1:]
    value = _at(plain, steps)
    shown = "" if isinstance(value, dict | list) or value is None else f"{value!r}: "
    return f"{_dotted(steps)}: {shown}{text}" if steps else text


def _steps(path: str) -> Steps:
    """The steps of a path as msgspec writes it after ``$``: ``.axes[...].unit``, ``.law.num[2]``."""
    return [
        key or (None if index == "..." else int(index))
        for key, index in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", path)
    ]


def _named_steps(steps: Steps, message: str, plain: Any, kind: Any) -> Steps:
    """Find which key of a table msgspec means where its path says only ``[...]``."""
    if None not in steps:
        return steps
    place = steps.index(None)
    for key in _at(plain, steps[:place]) or ():
        alone = copy.deepcopy(plain)
        table = _at(alone, steps[:place])
        for other in set(table) - {key}:
            del table[other]
        try:
            msgspec.convert(alone, kind)
        except msgspec.ValidationError as error:
            if str(error) == message:
                return _named_steps([*steps[:place], key, *steps[place + 1 :]], message, alone, kind)
    return steps[:place]


def _at(plain: Any, steps: Steps) -> Any:
    """What is in ``plain`` at ``steps``; None where there is nothing."""
    for step in steps:
        if isinstance(plain, dict):
            plain = plain.get(step)
        elif isinstance(plain, list) and isinstance(step, int) and step < len(plain):
            plain = plain[step]
        else:
            return None
    return plain


def _dotted(steps: Steps) -> str:
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps).lstrip(".")


def _choices(kind: Any, steps: Steps) -> list[object]:
    """The values that a Literal, or the tag of one of several tables, may have at ``steps``."""
    types = [msgspec.inspect.type_info(kind)]
    for step in steps:
        types = [inner for outer in types for inner in _types_at(outer, step)]
    return list(dict.fromkeys(value for literal in types for value in getattr(literal, "values", ())))


def _types_at(outer: msgspec.inspect.Type, step: str | int | None) -> list[msgspec.inspect.Type]:
    match outer:
        case msgspec.inspect.UnionType(types=types):
            return [inner for table in types for inner in _types_at(table, step)]
        case msgspec.inspect.StructType(tag_field=tag_field, tag=tag) if step == tag_field:
            return [msgspec.inspect.LiteralType((tag,))]
        case msgspec.inspect.StructType(fields=fields):
            return [field.type for field in fields if field.encode_name == step]
        case msgspec.inspect.DictType(value_type=inner) | msgspec.inspect.ListType(item_type=inner):
            return [inner]
    return []
