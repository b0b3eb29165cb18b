"""The state of a gateway core as plain JSON values, so that a recording can begin in the middle of a run.

``state_of`` walks over the core: from the gateway through the attributes of every object whose class is
defined in ``hil.core``. It keeps each value, and fails if a value is of a kind that it does not know. So no
attribute can be forgotten. ``restore`` gives the state to a core that was built from the same documents.

Values are written as follows:

============================  =========================================================================
in JSON                       in the core
============================  =========================================================================
null, true, 1, 1.0, "text"    the same value; a float is exact, because JSON has its shortest exact digits
[...]                         a list
{"float": "nan"}              a float that is not finite
{"bytes": "00ff"}             bytes, in hexadecimal digits
{"tuple": [...]}              a tuple
{"deque": [...], "size": 4}   a deque with at most ``size`` entries (null: without limit)
{"dict": [[k, v], ...]}       a dict
{"set": [...]}                a set; ``frozenset`` in the same way
{"enum": C, "name": N}        a member of the enumeration C
{"values": [...], "of": C}    a named tuple of the class C
{"class": C, "id": 7, ...}    an object of the class C, with its ``attributes``
{"object": 7}                 the object with this id, which stands further up
============================  =========================================================================

C is the name in a module of ``hil.core``, such as ``hil.core.output.Severity``. Attributes that are documents
(rig, experiment) or methods of other objects are left out: a core that was built from the same documents has
them. No code of a state is run when it is restored, and it can only contain objects of the classes of
``hil.core``.
"""

from __future__ import annotations

import math
import types
from collections import deque
from collections.abc import Iterator
from enum import Enum
from functools import cache
from importlib import import_module
from typing import Any

import msgspec

from hil.core.errors import DocumentError

_PACKAGE = "hil.core."
_LEFT_OUT = (msgspec.Struct, types.FunctionType, types.MethodType, types.BuiltinFunctionType)
"""Types of values that are in every core that was built from the same documents."""
_PLAIN = frozenset({type(None), bool, int, str})
"""Types of values that are written as they are."""
_MISSING = object()


def state_of(core: object) -> dict[str, Any]:
    """Return the state of a core. Raises TypeError for a value of a kind that cannot be written."""
    state: dict[str, Any] = _Writer().write(core)
    return state


def restore(core: object, state: Any) -> None:
    """Give a core the state of another one that was built from the same documents.

    Raises DocumentError if it is not the state of such a core.
    """
    try:
        _Reader().read(state, core)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, ImportError) as error:
        raise DocumentError(
            f"the state of the core does not fit this program: {type(error).__name__}: {error}; read it with "
            "the pneumatic-hil that recorded it"
        ) from None


class _Writer:
    """Writes values, and numbers the objects in the order in which they are found."""

    def __init__(self) -> None:
        self._ids: dict[int, int] = {}
        self._kept: list[object] = []

    def write(self, value: Any) -> Any:
        kind: Any = type(value)
        if kind in _PLAIN:
            return value
        if kind is float:
            return value if math.isfinite(value) else {"float": repr(value)}
        if kind is tuple:
            return {"tuple": [self.write(item) for item in value]}
        if kind is list:
            return [self.write(item) for item in value]
        if isinstance(value, Enum):
            return {"enum": _name_of(kind), "name": value.name}
        if isinstance(value, tuple):
            return {"values": [self.write(item) for item in value], "of": _name_of(kind)}
        return self._write_other(value, kind)

    def _write_other(self, value: Any, kind: type) -> Any:
        if kind is bytes:
            return {"bytes": value.hex()}
        if kind is deque:
            return {"deque": [self.write(item) for item in value], "size": value.maxlen}
        if kind is dict:
            return {"dict": [[self.write(key), self.write(item)] for key, item in value.items()]}
        if kind in (set, frozenset):
            return {kind.__name__: [self.write(item) for item in sorted(value, key=repr)]}
        return self._write_object(value, kind)

    def _write_object(self, value: Any, kind: type) -> Any:
        if id(value) in self._ids:
            return {"object": self._ids[id(value)]}
        name = _name_of(kind)
        if isinstance(value, _LEFT_OUT):
            raise TypeError(f"{name}: a document or method in a list, tuple or dict cannot be left out")
        number = self._ids[id(value)] = len(self._ids)
        self._kept.append(value)
        write = self.write
        attributes = {
            # Most attributes are plain, and a call for each of them takes time from the loop.
            key: item if type(item) in _PLAIN else write(item)
            for key, item in _attributes(value)
            if not isinstance(item, _LEFT_OUT)
        }
        return {"class": name, "id": number, "attributes": attributes}


class _Reader:
    """Reads values. An object of the core that has the place and the class of a written one is kept."""

    def __init__(self) -> None:
        self._objects: dict[int, object] = {}

    def read(self, written: Any, present: Any = None) -> Any:
        """Return a written value. ``present`` is the value at the same place in the core, or None."""
        match written:
            case None | bool() | int() | float() | str():
                return written
            case list():
                return list(self._items(written, present))
            case {"class": name, "id": number, "attributes": attributes}:
                return self._read_object(name, number, attributes, present)
            case {"object": number}:
                return self._objects[number]
            case {"enum": name, "name": member}:
                return _class_of(name, Enum)[member]
            case {"values": values, "of": name}:
                return _class_of(name, tuple)(*self._items(values, present))
            case {"tuple": items}:
                return tuple(self._items(items, present))
            case {"dict": items}:
                return {(read := self.read(key)): self.read(item, _at(present, read)) for key, item in items}
            case {"deque": items, "size": size}:
                return deque(self._items(items, None), size)
            case {"set": items}:
                return set(self._items(items, None))
            case {"frozenset": items}:
                return frozenset(self._items(items, None))
            case {"bytes": digits}:
                return bytes.fromhex(digits)
            case {"float": digits}:
                return float(digits)
        raise ValueError(f"{written!r:.100} is not a value of a state")

    def _items(self, items: list[Any], present: Any) -> Iterator[Any]:
        for place, item in enumerate(items):
            yield self.read(item, _at(present, place))

    def _read_object(self, name: str, number: int, attributes: dict[str, Any], present: Any) -> object:
        kind = _class_of(name, object)
        target = present if type(present) is kind else kind.__new__(kind)
        self._objects[number] = target
        if target is present:
            known = dict(_attributes(target))
            kept = {key for key, item in known.items() if not isinstance(item, _LEFT_OUT)}
            differing = (attributes.keys() - known.keys()) | (kept - attributes.keys())
            if differing:
                raise ValueError(f"{name} differs in {', '.join(sorted(differing))}")
        for key, item in attributes.items():
            setattr(target, key, self.read(item, getattr(target, key, None)))
        return target


def _attributes(value: object) -> list[tuple[str, Any]]:
    """Return the names and values of all attributes that an object has."""
    found = []
    kind: Any = type(value)
    for name in _slots(kind):
        item = getattr(value, name, _MISSING)
        if item is not _MISSING:
            found.append((name, item))
    found.extend(getattr(value, "__dict__", {}).items())
    return found


@cache
def _slots(kind: Any) -> tuple[str, ...]:
    """Return the names of a class' slots, with those of its bases."""
    return tuple(name for base in kind.__mro__ for name in getattr(base, "__slots__", ()))


def _at(container: Any, place: Any) -> Any:
    """Return what a list, tuple or dict has at a place, or None."""
    try:
        return container[place]
    except (KeyError, IndexError, TypeError):
        return None


@cache
def _name_of(kind: Any) -> str:
    name = f"{kind.__module__}.{kind.__qualname__}"
    if not name.startswith(_PACKAGE):
        raise TypeError(f"an object of the class {name} cannot be written into the state of a core")
    return name


def _class_of(name: str, base: type) -> Any:
    """Return a class of ``hil.core`` by its name. Raises ValueError for any other name."""
    module, _, kind = name.rpartition(".")
    found = getattr(import_module(module), kind, None) if module.startswith(_PACKAGE) else None
    if not isinstance(found, type) or not issubclass(found, base) or found.__module__ != module:
        raise ValueError(f"{name} is no class of the core")
    return found
