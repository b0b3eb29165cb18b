"""Insert a counter at the beginning of every branch of ``hil.core`` when its modules are imported.

The counters guide the fuzzer. They cost far less than a trace function, and need no package: Python 3.11 has
no ``sys.monitoring``. An ``if`` without ``else`` gets one, so that both ways count.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType

PACKAGE = "hil.core"
_NAME = "__fuzz_branches__"
MAX_BRANCHES = 8192

branches = bytearray(MAX_BRANCHES)
"""One byte a branch: 1 if it was taken since :func:`take_branches` was called last."""
_used = 0


def take_branches() -> int:
    """Return the branches taken since the last call as the bits of an integer, and begin anew."""
    taken = int.from_bytes(branches, "little")
    branches[:] = bytes(MAX_BRANCHES)
    return taken


def number_of_branches() -> int:
    """Return the number of branches of all modules imported so far."""
    return _used


def install() -> None:
    """Count the branches of modules that are imported from now on."""
    loaded = [name for name in sys.modules if name.startswith(PACKAGE + ".")]
    if loaded:
        raise RuntimeError(f"{loaded[0]} has been imported already; install the counters before")
    sys.meta_path.insert(0, _Finder())


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
        tree = with_counters(ast.parse(self.get_data(path), path))
        return compile(tree, path, "exec", dont_inherit=True)


def with_counters(tree: ast.Module) -> ast.Module:
    """Return the module with a counter in each branch. The tree is changed."""
    _Counters().visit(tree)
    imported = ast.parse(f"from fuzz.branch_counters import branches as {_NAME}").body
    head = sum(isinstance(node, ast.Expr) or _is_future(node) for node in tree.body[:2])
    tree.body[head:head] = imported
    return ast.fix_missing_locations(tree)


def _is_future(node: ast.stmt) -> bool:
    return isinstance(node, ast.ImportFrom) and node.module == "__future__"


class _Counters(ast.NodeTransformer):
    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        self.generic_visit(node)
        has_docstring = ast.get_docstring(node, clean=False) is not None
        node.body.insert(1 if has_docstring else 0, _counter())
        return node

    def visit_If(self, node: ast.If) -> ast.If:
        self.generic_visit(node)
        node.body.insert(0, _counter())
        if not (len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If)):
            node.orelse.insert(0, _counter())
        return node

    def visit_For(self, node: ast.For) -> ast.For:
        self.generic_visit(node)
        node.body.insert(0, _counter())
        return node

    def visit_While(self, node: ast.While) -> ast.While:
        self.generic_visit(node)
        node.body.insert(0, _counter())
        return node

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> ast.ExceptHandler:
        self.generic_visit(node)
        node.body.insert(0, _counter())
        return node

    def visit_match_case(self, node: ast.match_case) -> ast.match_case:
        self.generic_visit(node)
        node.body.insert(0, _counter())
        return node


def _counter() -> ast.stmt:
    global _used
    _used += 1
    assert _used < MAX_BRANCHES
    return ast.parse(f"{_NAME}[{_used}] = 1").body[0]
