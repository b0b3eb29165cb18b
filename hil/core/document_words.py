"""Turn the validation errors of msgspec into sentences that name key, value and limit."""

from __future__ import annotations

import re
from typing import Any

import msgspec

from hil.core.document_keys import choices
from hil.core.document_paths import Steps, dotted, value_at, with_value

_TYPE_WORDS = {
    "bool": "true or false",
    "int": "a whole number",
    "float": "a number",
    "str": "a text",
    "object": "a table",
    "array": "a list",
    "null": "nothing",
    "date": "a date",
    "datetime": "a date with time",
    "time": "a time of day",
}
_RELATIONS = {">=": "at least", "<=": "at most", ">": "more than", "<": "less than"}
_ENTRIES = {"object": "keys", "array": "entries", "str": "characters"}
_LONGEST_SHOWN = 80
"""Characters of a text that a message repeats."""


def validation_problem(message: str, plain: Any, kind: Any) -> str:
    """Return the sentence for a ``msgspec.ValidationError`` that reading ``plain`` as ``kind`` raised."""
    text, separator, path = message.rpartition(" - at `$")
    if not separator:
        return f"the document is {_described(plain)}, but must be {_requirement(message)}"
    steps = _resolved(path, message, plain, kind)
    value = value_at(plain, steps)
    allowed = choices(kind, steps) if text.startswith("Invalid") else []
    wanted = " or ".join(map(repr, allowed)) if allowed else _requirement(text)
    if "of length" in text:
        return f"{dotted(steps)} has {len(value)} {_entries_word(text)}, but must have {wanted}"
    return f"{dotted(steps)} is {_described(value)}, but must be {wanted}"


def _requirement(text: str) -> str:
    """Return what ``Expected `float` <= 10.0`` asks for, in words."""
    match = re.match(
        r"Expected `(?P<types>[^`]+)`(?P<length> of length)?(?: (?P<relation>[<>]=?) (?P<limit>\S+))?", text
    )
    if match is None:
        return text[:1].lower() + text[1:]
    if match["relation"]:
        return f"{_RELATIONS[match['relation']]} {match['limit']}"
    names = [name for name in match["types"].split(" | ") if name != "null"]
    return " or ".join(_TYPE_WORDS.get(name, name) for name in names)


def _entries_word(text: str) -> str:
    match = re.match(r"Expected `(\w+)`", text)
    return _ENTRIES.get(match[1] if match else "", "entries")


def _described(value: Any) -> str:
    """Return a scalar as it is written; of a table or list only that it is one."""
    match value:
        case dict():
            return "a table"
        case list():
            return "a list"
        case None:
            return "null"
        case bool():
            return str(value).lower()
        case str() if len(value) > _LONGEST_SHOWN:
            return f"{value[:_LONGEST_SHOWN]!r}…"
        case str() | int() | float():
            return repr(value)
    return str(value)


def _resolved(path: str, message: str, plain: Any, kind: Any) -> Steps:
    """Return the place that msgspec writes as ``.axes[...].unit`` or ``.law.num[2]`` after ``$``.

    ``[...]`` is a key of a table that msgspec does not name: each key is tried alone.
    """
    steps: Steps = []
    for key, index in re.findall(r"\.(\w+)|\[(\d+|\.\.\.)\]", path):
        if index != "...":
            steps.append(key or int(index))
            continue
        found = _failing_key(steps, message, plain, kind)
        if found is None:
            return steps
        plain = with_value(plain, steps, {found: value_at(plain, steps)[found]})
        steps.append(found)
    return steps


def _failing_key(steps: Steps, message: str, plain: Any, kind: Any) -> str | None:
    """Return the key of the table at ``steps`` whose value alone gives the same message."""
    table = value_at(plain, steps)
    for key, value in table.items() if isinstance(table, dict) else ():
        try:
            msgspec.convert(with_value(plain, steps, {key: value}), kind)
        except msgspec.ValidationError as error:
            if str(error) == message:
                return str(key)
    return None
