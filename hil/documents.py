"""TOML and JSON documents become typed, frozen objects here, and nowhere else.

A document is a ``msgspec.Struct`` with ``frozen=True, forbid_unknown_fields=True``. Errors carry the
source and the dotted path of the key: ``rig.toml: axes[0].valve.max_v: …``.
"""

from __future__ import annotations

import json
import re
import tomllib
from typing import Any, TypeVar

import msgspec

from hil.errors import DocumentError

T = TypeVar("T")


class Document(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every typed document and of the tables inside it."""


def from_toml(text: str, kind: type[T], source: str) -> T:
    """Read TOML ``text`` as a ``kind``; ``source`` (a file name) goes into errors. Raises DocumentError."""
    try:
        plain = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise DocumentError(f"{source}: not valid TOML: {error}") from None
    return from_plain(plain, kind, source)


def from_json(text: str, kind: type[T], source: str) -> T:
    """Read JSON ``text`` as a ``kind``; ``source`` (a file name) goes into errors. Raises DocumentError."""
    try:
        plain = json.loads(text, parse_constant=_refuse_constant)
    except ValueError as error:
        raise DocumentError(f"{source}: not valid JSON: {error}") from None
    return from_plain(plain, kind, source)


def from_plain(plain: Any, kind: type[T], source: str) -> T:
    """Read nested dicts, lists and scalars as a ``kind``. Raises DocumentError with path and value."""
    try:
        return msgspec.convert(plain, kind)
    except msgspec.ValidationError as error:
        raise DocumentError(f"{source}: {_located(str(error), plain, kind)}") from None


def to_json(document: object) -> str:
    """The document as indented JSON that :func:`from_json` reads back to an equal object."""
    return json.dumps(msgspec.to_builtins(document), indent=2, allow_nan=False) + "\n"


def _located(message: str, plain: Any, kind: Any) -> str:
    """``Expected `float` <= 10.0 - at `$.valve.max_v``` becomes ``valve.max_v: 11.3: expected …``."""
    text, separator, path = message.rpartition(" - at `$")
    if not separator:
        return message
    text = text[:1].lower() + text[1:]
    steps = _named_steps(re.findall(r"[^.\[\]`]+|\.\.\.", path), message, plain, kind)
    value: Any = plain
    for step in steps:
        value = value[int(step)] if isinstance(value, list) else value.get(step)
    dotted = "".join(f"[{step}]" if step.isdigit() else f".{step}" for step in steps).lstrip(".")
    shown = "" if isinstance(value, dict | list) or value is None else f"{value!r}: "
    return f"{dotted}: {shown}{text}" if dotted else text


def _named_steps(steps: list[str], message: str, plain: Any, kind: Any) -> list[str]:
    """Find which key of a table msgspec means where its path says only ``[...]``."""
    if "..." not in steps:
        return steps
    place = steps.index("...")
    for key in _at(plain, steps[:place]):
        alone = json.loads(json.dumps(plain, default=str))
        table = _at(alone, steps[:place])
        for other in set(table) - {key}:
            del table[other]
        try:
            msgspec.convert(alone, kind)
        except msgspec.ValidationError as error:
            if str(error) == message:
                return _named_steps([*steps[:place], key, *steps[place + 1 :]], message, alone, kind)
    return steps[:place]


def _at(value: Any, steps: list[str]) -> Any:
    for step in steps:
        value = value[int(step)] if isinstance(value, list) else value[step]
    return value


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a JSON number")
