"""The mutants of a module: one small change each.

===============  ====================================================================================
operator         change
===============  ====================================================================================
``comparison``   ``<`` becomes ``<=`` or ``>=``, ``==`` becomes ``!=``, ``in`` becomes ``not in``, …
``arithmetic``   ``+`` and ``-``, ``*`` and ``/``, ``&`` and ``|``, ``<<`` and ``>>`` are exchanged
``boolean``      ``and`` and ``or`` are exchanged, ``not`` is left out, True and False are exchanged
``condition``    the condition of an ``if`` is always True, or always False
``constant``     a number is one more, or one less; a text of a table is another
``statement``    a call, an assignment to an attribute, ``raise`` or ``continue`` is left out
``return``       ``return value`` becomes ``return None``
``element``      an element of a list, tuple, set or dict is left out
===============  ====================================================================================

Annotations, docstrings and the texts of messages are left alone.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Callable, Iterator
from copy import deepcopy
from typing import NamedTuple

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitOr,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
DISPLAYS = (ast.Tuple, ast.List, ast.Set)
MAX_SNIPPET = 70


class Mutant(NamedTuple):
    """One change of one module."""

    key: str
    """Name that does not depend on line numbers: path, function, operator, text before and after."""
    path: str
    function: str
    """Qualified name of the function around the change; empty for the level of the module or of a class."""
    line: int
    site: int
    """Number of the change among all changes of the module."""


class Change(NamedTuple):
    """A place in a tree, and what to do there."""

    operator: str
    node: ast.AST
    """Node before the change, for its line and its text."""
    function: str
    before: str
    after: str
    apply: Callable[[], None]


def mutants_of(source: str, path: str) -> list[Mutant]:
    """Return all mutants of a module."""
    numbers: Counter[str] = Counter()
    mutants = []
    for site, change in enumerate(_changes(ast.parse(source))):
        words = f"{change.before} -> {change.after}"
        name = f"{path}::{change.function or '<module>'}::{change.operator}::{words}"
        numbers[name] += 1
        key = name if numbers[name] == 1 else f"{name} ({numbers[name]})"
        line = getattr(change.node, "lineno", 0)
        mutants.append(Mutant(key, path, change.function, line, site))
    return mutants


def mutated(source: str, mutant: Mutant) -> str:
    """Return the source of a module with one change."""
    return ast.unparse(mutated_tree(source, mutant))


def mutated_tree(source: str, mutant: Mutant) -> ast.Module:
    """Return the syntax tree of a module with one change."""
    tree = ast.parse(source)
    for site, change in enumerate(_changes(tree)):
        if site == mutant.site:
            change.apply()
            break
    return ast.fix_missing_locations(tree)


def _changes(tree: ast.Module) -> Iterator[Change]:
    return _Walk().changes(tree, "")


class _Walk:
    """A walk over a tree that yields its changes in a fixed order."""

    def changes(self, node: ast.AST, function: str) -> Iterator[Change]:
        if isinstance(node, ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Assert):
            return
        if isinstance(node, ast.keyword) and node.arg == "strict":
            return  # zip's check of lengths, which never fails here
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "bases", "type_comment", "pattern"):
                continue
            if isinstance(value, list):
                for place, child in enumerate(value):
                    if isinstance(child, ast.AST):
                        yield from self._child(node, name, place, child, function)
            elif isinstance(value, ast.AST):
                yield from self._child(node, name, None, value, function)

    def _child(
        self, parent: ast.AST, name: str, place: int | None, child: ast.AST, function: str
    ) -> Iterator[Change]:
        def replace(new: ast.AST) -> Callable[[], None]:
            if place is None:
                return lambda: setattr(parent, name, new)
            return lambda: getattr(parent, name).__setitem__(place, new)

        for operator, new in _replacements(parent, name, child):
            before, after = _snippet(child), _snippet(new)
            if operator == "constant" and isinstance(parent, ast.BinOp | ast.Compare | ast.Assign | ast.Call):
                replace(new)()
                after = _snippet(parent)
                replace(child)()
                before = _snippet(parent)
            yield Change(operator, child, function, before, after, replace(new))
        if isinstance(child, DISPLAYS) and _is_value(parent, name, child):
            for number, element in enumerate(child.elts):
                yield Change(
                    "element", element, function, _snippet(element), "", lambda n=number: child.elts.pop(n)
                )
        if isinstance(child, ast.Dict):
            for number, key in enumerate(child.keys):
                text = _snippet(key) if key is not None else "**"
                yield Change("element", child.values[number], function, text, "", _remove_key(child, number))
        inner = function
        if isinstance(child, ast.FunctionDef | ast.ClassDef):
            is_local = isinstance(parent, ast.FunctionDef)
            inner = f"{function}{'.<locals>' * is_local}.{child.name}" if function else child.name
        yield from self.changes(child, inner)


def _remove_key(node: ast.Dict, number: int) -> Callable[[], None]:
    def remove() -> None:
        del node.keys[number], node.values[number]

    return remove


def _is_value(parent: ast.AST, name: str, node: ast.expr) -> bool:
    """Return whether a display is a value with at least two elements, not a target or part of a type."""
    is_load = isinstance(getattr(node, "ctx", ast.Load()), ast.Load)
    is_type = isinstance(parent, ast.Subscript) and name == "slice"
    is_slots = isinstance(parent, ast.Assign) and ast.unparse(parent.targets[0]) == "__slots__"
    return is_load and not is_type and not is_slots and len(node.elts) > 1  # type: ignore[attr-defined]


def _replacements(parent: ast.AST, name: str, node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield the operator and the node that replaces ``node``, for each change."""
    match node:
        case ast.Compare():
            yield from _comparisons(node)
        case ast.BinOp(op=op) if type(op) in ARITHMETIC and not _is_type(node):
            yield "arithmetic", _with(node, op=ARITHMETIC[type(op)]())
        case ast.AugAssign(op=op) if type(op) in ARITHMETIC:
            yield "arithmetic", _with(node, op=ARITHMETIC[type(op)]())
            yield "statement", ast.Pass()
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield "boolean" if isinstance(node.op, ast.Not) else "arithmetic", operand
        case ast.BoolOp(op=op):
            yield "boolean", _with(node, op=ast.Or() if isinstance(op, ast.And) else ast.And())
        case ast.Constant(value=value):
            for constant in _constants(parent, name, value):
                yield "constant", ast.Constant(constant)
        case ast.Expr(value=ast.Call()) | ast.Raise() | ast.Continue() | ast.Delete():
            yield "statement", ast.Pass()
        case ast.Assign(targets=[target]) if not _is_name(target):
            yield "statement", ast.Pass()
        case ast.Return(value=value) if value is not None and not _is_none(value):
            yield "return", ast.Return(ast.Constant(None))
    if name == "test" and isinstance(parent, ast.If | ast.IfExp):
        for always in (True, False):
            yield "condition", ast.Constant(always)


def _comparisons(node: ast.Compare) -> Iterator[tuple[str, ast.AST]]:
    for place, op in enumerate(node.ops):
        for other in COMPARISONS[type(op)]:
            changed = deepcopy(node)
            changed.ops[place] = other()
            yield "comparison", changed


def _constants(parent: ast.AST, name: str, value: object) -> tuple[object, ...]:
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, int | float):
        return (value + 1, value - 1)
    is_of_table = isinstance(parent, ast.Dict | ast.Tuple | ast.List | ast.Set)
    return (f"{value}?",) if isinstance(value, str) and is_of_table else ()


def _with(node: ast.AST, **fields: ast.AST) -> ast.AST:
    changed = deepcopy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _is_type(node: ast.BinOp) -> bool:
    """Return whether a node is a union of types such as ``int | None``."""
    return isinstance(node.op, ast.BitOr) and any(
        isinstance(part, ast.Name | ast.Constant) and ast.unparse(part)[:1].isupper()
        for part in (node.left, node.right)
    )


def _is_name(target: ast.expr) -> bool:
    return isinstance(target, ast.Name | ast.Tuple)


def _is_none(value: ast.expr) -> bool:
    return isinstance(value, ast.Constant) and value.value is None


def _snippet(node: ast.AST) -> str:
    text = "pass" if isinstance(node, ast.Pass) else " ".join(ast.unparse(node).split())
    return text if len(text) <= MAX_SNIPPET else f"{text[: MAX_SNIPPET - 1]}…"
