"""Insert a counter at the beginning of every branch of ``hil.core`` when its modules are imported.

The counters guide the fuzzer, and say which test reaches which branch. They cost far less than a trace
function, and need no package: Python 3.11 has no ``sys.monitoring``. An ``if`` without ``else`` gets one, so
that both ways count.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType
from typing import NamedTuple, TypeVar

PACKAGE = "hil.core"
MAX_BRANCHES = 8192
_NAME = "__branches__"


Block = TypeVar("Block", ast.For, ast.While, ast.ExceptHandler, ast.match_case)


class Branch(NamedTuple):
    """Lines of a branch. A line may lie in several branches, one within the other."""

    path: str
    first_line: int
    last_line: int


branches = bytearray(MAX_BRANCHES)
"""One byte a branch: 1 if it was taken since :func:`take_branches` was called last."""
known: list[Branch] = []
"""The branches of all modules imported so far, by number."""
sources: dict[str, bytes] = {}
"""Sources by path that are compiled in place of the files: those of mutants."""


def take_branches() -> int:
    """Return the branches taken since the last call, each as one bit of an integer, and begin anew."""
    taken = int.from_bytes(branches, "little")
    branches[:] = bytes(MAX_BRANCHES)
    return taken


def is_in(taken: int, number: int) -> bool:
    """Return whether a branch is among those that :func:`take_branches` returned."""
    return bool(taken >> 8 * number & 1)


def innermost(path: str, line: int) -> int | None:
    """Return the number of the smallest branch that has this line, or None for code outside functions."""
    around = [
        (branch.last_line - branch.first_line, number)
        for number, branch in enumerate(known)
        if branch.path == path and branch.first_line <= line <= branch.last_line
    ]
    return min(around)[1] if around else None


def install() -> None:
    """Count the branches of modules that are imported from now on."""
    loaded = [name for name in sys.modules if name.startswith(PACKAGE + ".")]
    if loaded:
        raise RuntimeError(f"{loaded[0]} has been imported already; install the counters before")
    sys.meta_path.insert(0, _Finder())


def with_counters(tree: ast.Module, path: str) -> ast.Module:
    """Return the module with a counter in each branch. The tree is changed."""
    _Counters(path).visit(tree)
    imported = ast.parse(f"from support.branch_counters import branches as {_NAME}").body
    head = sum(isinstance(node, ast.Expr) or _is_future(node) for node in tree.body[:2])
    tree.body[head:head] = imported
    return ast.fix_missing_locations(tree)


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: object = None
    ) -> ModuleSpec | None:
        if not fullname.startswith(PACKAGE + "."):
            return None
        spec = PathFinder.find_spec(fullname, path)
        if spec is not None and isinstance(spec.loader, SourceFileLoader) and spec.origin is not None:
            spec.loader = _Loader(fullname, spec.origin)
        return spec


class _Loader(SourceFileLoader):
    def get_code(self, fullname: str) -> CodeType:
        """Compile the module with counters, without the cache of compiled files."""
        path = self.get_filename(fullname)
        source = sources.get(path) or self.get_data(path)
        return compile(with_counters(ast.parse(source, path), path), path, "exec", dont_inherit=True)


def _is_future(node: ast.stmt) -> bool:
    return isinstance(node, ast.ImportFrom) and node.module == "__future__"


class _Counters(ast.NodeTransformer):
    def __init__(self, path: str) -> None:
        self._path = path

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        self.generic_visit(node)
        has_docstring = ast.get_docstring(node, clean=False) is not None
        node.body.insert(1 if has_docstring else 0, self._counter(node.lineno, node.end_lineno))
        return node

    def visit_If(self, node: ast.If) -> ast.If:
        self.generic_visit(node)
        is_followed_by_elif = len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If)
        if not is_followed_by_elif:
            node.orelse.insert(0, self._counter_of(node.orelse))
        node.body.insert(0, self._counter_of(node.body))
        return node

    def visit_For(self, node: ast.For) -> ast.For:
        return self._visit_block(node)

    def visit_While(self, node: ast.While) -> ast.While:
        return self._visit_block(node)

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> ast.ExceptHandler:
        return self._visit_block(node)

    def visit_match_case(self, node: ast.match_case) -> ast.match_case:
        return self._visit_block(node)

    def _visit_block(self, node: Block) -> Block:
        self.generic_visit(node)
        node.body.insert(0, self._counter_of(node.body))
        return node

    def _counter_of(self, body: Sequence[ast.stmt]) -> ast.stmt:
        lines = [
            line for node in body if node.end_lineno is not None for line in (node.lineno, node.end_lineno)
        ]
        return self._counter(min(lines, default=0), max(lines, default=-1))

    def _counter(self, first_line: int, last_line: int | None) -> ast.stmt:
        known.append(Branch(self._path, first_line, last_line or first_line))
        assert len(known) <= MAX_BRANCHES
        return ast.parse(f"{_NAME}[{len(known) - 1}] = 1").body[0]
