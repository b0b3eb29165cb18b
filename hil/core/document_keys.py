"""Compare the keys of a document with those of its type, and report all differences at once.

msgspec stops at the first unknown or missing key. A person who writes a file wants the whole list, the valid
keys, and the one that was probably meant.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from msgspec import inspect

from hil.core.document_paths import Steps, dotted
from hil.core.suggestions import nearest

_MAX_PROBLEMS = 20
"""Problems that one message lists; a file with more of them is hardly of this kind."""


def key_problems(plain: Any, kind: Any) -> list[str]:
    """Return one sentence for each unknown key and for each table with missing keys."""
    problems: list[str] = []
    for problem in _problems(plain, inspect.type_info(kind), []):
        if len(problems) == _MAX_PROBLEMS:
            return [*problems, "and more"]
        problems.append(problem)
    return problems


def choices(kind: Any, steps: Steps) -> list[object]:
    """Return the values that a Literal, or the tag of one of several tables, may have at ``steps``."""
    types: list[inspect.Type] = [inspect.type_info(kind)]
    for step in steps:
        types = [inner for outer in types for inner in _types_at(outer, step)]
    return list(dict.fromkeys(value for literal in types for value in getattr(literal, "values", ())))


def _problems(plain: Any, kind: inspect.Type, steps: Steps) -> Iterator[str]:
    struct = _struct_of(plain, kind)
    if struct is not None and isinstance(plain, dict):
        yield from _table_problems(plain, struct, steps)
        types = {field.encode_name: field.type for field in struct.fields}
        for key, value in plain.items():
            if key in types:
                yield from _problems(value, types[key], [*steps, key])
    elif isinstance(kind, inspect.UnionType) and isinstance(plain, dict):
        yield from _tag_problem(plain, kind, steps)
    elif isinstance(kind, inspect.DictType) and isinstance(plain, dict):
        for key, value in plain.items():
            yield from _problems(value, kind.value_type, [*steps, key])
    elif isinstance(kind, inspect.ListType | inspect.VarTupleType) and isinstance(plain, list):
        for index, value in enumerate(plain):
            yield from _problems(value, kind.item_type, [*steps, index])


def _struct_of(plain: Any, kind: inspect.Type) -> inspect.StructType | None:
    """Return the table type that ``plain`` is read as; the tag decides between several."""
    if isinstance(kind, inspect.StructType):
        return kind
    if not isinstance(kind, inspect.UnionType) or not isinstance(plain, dict):
        return None
    structs = [member for member in kind.types if isinstance(member, inspect.StructType)]
    if len(structs) == 1:
        return structs[0]
    return next((struct for struct in structs if plain.get(struct.tag_field) == struct.tag), None)


def _tag_problem(plain: dict[str, Any], union: inspect.UnionType, steps: Steps) -> Iterator[str]:
    """Report that the key is missing which says of several tables which one this is."""
    tags = {struct.tag: struct.tag_field for struct in union.types if isinstance(struct, inspect.StructType)}
    key = next(iter(tags.values()), None)
    if key is not None and key not in plain:
        yield f"{_place(steps)}missing key {key}, which must be {' or '.join(map(repr, tags))}"


def _table_problems(plain: dict[str, Any], struct: inspect.StructType, steps: Steps) -> Iterator[str]:
    valid = [field.encode_name for field in struct.fields]
    if struct.tag_field is not None:
        valid = [struct.tag_field, *valid]
    required = [field.encode_name for field in struct.fields if field.required]
    missing = [key for key in required if key not in plain]
    place = _place(steps)
    for key in plain:
        if key not in valid:
            meant = nearest(str(key), valid)
            if meant in missing:
                missing.remove(meant)  # one mistake, one sentence
            table = _table_with(str(key), struct)
            if table is not None:
                where = dotted([*steps, table])
                yield (
                    f"{place}unknown key {_shown(key)}; it belongs under [{where}]: is the line [{where}] "
                    "still a comment?"
                )
                continue
            hint = f"; did you mean {meant}?" if meant else "."
            yield f"{place}unknown key {_shown(key)}{hint} Valid keys: {', '.join(valid)}"
    if missing:
        yield f"{place}missing {'key' if len(missing) == 1 else 'keys'} {', '.join(missing)}"


def _table_with(key: str, struct: inspect.StructType) -> str | None:
    """Return the name of an optional table inside ``struct`` that has ``key``, or None."""
    for field in struct.fields:
        inner = field.type
        if isinstance(inner, inspect.UnionType):
            inner = next((one for one in inner.types if isinstance(one, inspect.StructType)), inner)
        if field.required or not isinstance(inner, inspect.StructType):
            continue
        if any(inside.encode_name == key for inside in inner.fields):
            return field.encode_name
    return None


def _place(steps: Steps) -> str:
    return f"{dotted(steps)}: " if steps else ""


def _shown(key: object) -> str:
    text = str(key)
    return text if text.replace("_", "").replace("-", "").isalnum() else repr(text[:100])


def _types_at(outer: inspect.Type, step: str | int) -> list[inspect.Type]:
    match outer:
        case inspect.UnionType(types=types):
            return [inner for table in types for inner in _types_at(table, step)]
        case inspect.StructType(tag_field=tag_field, tag=tag) if step == tag_field:
            return [inspect.LiteralType((tag,))]
        case inspect.StructType(fields=fields):
            return [field.type for field in fields if field.encode_name == step]
        case (
            inspect.DictType(value_type=inner)
            | inspect.ListType(item_type=inner)
            | inspect.VarTupleType(item_type=inner)
        ):
            return [inner]
    return []
